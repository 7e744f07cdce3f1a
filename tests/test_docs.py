"""What the documentation says is run: its Python blocks, what they print, its links, its names, and the doctests.

Blocks of one page run in order, in one namespace, in an empty folder, on the CPU. A fence ```output after a block is what the
block must print, `...` standing for anything. Other fences (```text, ```json, ```sh) are not run. All pages run in one process of
their own, so that the models which they define do not register themselves with the other tests.
"""

import contextlib
import doctest
import importlib
import inspect
import io
import json
import os
import pkgutil
import re
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import pytest

import torchbrdf
from torchbrdf.registry import BSDFS, FRESNEL_TERMS, registered

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")])
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```\s*$", re.MULTILINE | re.DOTALL)
LOOSELY = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def blocks(page: Path) -> list[tuple[int, str, str | None]]:
    """(first line, code, what it must print or None) of each Python block."""
    text = page.read_text()
    found = [(m.group(1), m.group(2), text[: m.start()].count("\n") + 2) for m in FENCE.finditer(text)]
    following = [*found, ("", "", 0)][1:]
    return [
        (at, code, after[1] if after[0] == "output" else None)
        for (kind, code, at), after in zip(found, following, strict=True)
        if kind == "python"
    ]


def run_page(page: Path) -> str:
    """Run the blocks of a page; what went wrong, or nothing."""
    names: dict[str, object] = {"__name__": f"docs_{page.stem}"}
    for at, code, expected in blocks(page):
        printed = io.StringIO()
        try:
            with contextlib.redirect_stdout(printed):
                exec(compile("\n" * (at - 1) + code, str(page), "exec"), names)
        except BaseException:
            return f"{page.name}, block at line {at}:\n{traceback.format_exc()}"
        if expected is not None and not doctest.OutputChecker().check_output(expected, printed.getvalue(), LOOSELY):
            return f"{page.name}, block at line {at} printed\n{printed.getvalue()}\nand the page says\n{expected}"
    return ""


def run_all() -> None:
    """Run every page in an empty folder of its own, and print the outcomes as JSON."""
    import torch

    torch.set_num_threads(1)
    sys.path.insert(0, str(ROOT / "examples"))  # docs/recover.md speaks from that folder
    outcomes = {}
    for page in PAGES:
        torch.manual_seed(0)
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            outcomes[page.name] = run_page(page)
    print(json.dumps(outcomes))


@pytest.fixture(scope="module")
def outcomes() -> dict[str, str]:
    quiet = {**os.environ, "CUDA_VISIBLE_DEVICES": "", "TQDM_DISABLE": "1", "MPLBACKEND": "Agg"}
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, env=quiet, cwd=ROOT, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("page", [p.name for p in PAGES if blocks(p)])
def test_python_blocks_run(page, outcomes):
    assert not outcomes[page], outcomes[page]


def test_the_pages_have_blocks():
    assert sum(len(blocks(p)) for p in PAGES) > 20


MODULES = [m.name for m in pkgutil.walk_packages(torchbrdf.__path__, "torchbrdf.")]


@pytest.mark.parametrize("name", [n for n in MODULES if ">>> " in inspect.getsource(importlib.import_module(n))])
def test_doctests(name):
    assert doctest.testmod(importlib.import_module(name), optionflags=LOOSELY).failed == 0


def test_every_model_has_an_example():
    files = {cls.__module__ for cls in registered(BSDFS)} - {"torchbrdf.bsdf.combine"}
    assert [f for f in files if ">>> " not in (importlib.import_module(f).__doc__ or "")] == []


def make_tables():
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module("make_tables")
    finally:
        sys.path.remove(str(ROOT / "docs"))


@pytest.mark.parametrize("page", ["models.md", "api.md"])
def test_generated_pages_are_up_to_date(page):
    assert (ROOT / "docs" / page).read_text() == make_tables().PAGES[page](), "run python docs/make_tables.py"


@pytest.mark.parametrize("cls", [*registered(BSDFS), *registered(FRESNEL_TERMS)], ids=lambda c: c.__name__)
def test_every_declared_field_is_documented(cls):
    section = (ROOT / "docs" / "models.md").read_text().split(f"### {cls.__name__}\n")[1].split("\n### ")[0]
    missing = [name for name in cls._fields if f"| `{name}` |" not in section]
    assert not missing, f"docs/models.md says nothing of {missing}: run python docs/make_tables.py"


@pytest.mark.parametrize("cls", registered(BSDFS), ids=lambda c: c.__name__)
def test_the_manual_page_of_a_model_is_complete(cls):
    """Formula, the parameters that are declared and no others, directional albedo, smoothness, and a source with its year."""
    text = inspect.cleandoc(importlib.import_module(cls.__module__).__doc__ or "") + "\n\n" + inspect.cleandoc(cls.__doc__ or "")
    assert ".. math::" in text
    assert "lbedo" in text
    assert "mooth" in text
    if cls.__module__ == "torchbrdf.bsdf.combine":
        return
    assert re.search(r"\b(1[6-9]|20)\d\d\b", text), "the source: author and year"
    tables = [make_tables().rst.table(b.split("\n")) for b in re.split(r"\n\s*\n", text) if b.startswith("====")]
    (declared,) = [t for t in tables if t[0][0] == "parameter"]
    assert [row[0] for row in declared[1:]] == list(cls._fields)


def test_links_lead_somewhere():
    broken = []
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", FENCE.sub("", page.read_text())):
            if "://" not in target and not (page.parent / target).exists():
                broken.append(f"{page.name}: {target}")
    assert not broken


def test_names_of_the_library_exist():
    """Every `tb.something` that a page speaks of is there."""
    wrong = set()
    for page in PAGES:
        for name in set(re.findall(r"\btb((?:\.[A-Za-z_]\w*)+)", page.read_text())):
            try:
                found = torchbrdf
                for part in name[1:].split("."):
                    found = getattr(found, part)
            except AttributeError:
                wrong.add(f"{page.name}: tb{name}")
    assert not wrong


def test_a_page_that_lies_is_caught(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(1 + 1)\n```\n\n```output\n3\n```\n")
    assert "printed\n2" in run_page(page)
    page.write_text("text\n\n```python\nx = 1\n1 / 0\n```\n")
    assert "line 5" in run_page(page)


if __name__ == "__main__":
    run_all()
