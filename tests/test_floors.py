"""Imports never point upward, and heavy packages are imported only when something needs them."""

import ast
import subprocess
import sys
from pathlib import Path

import torchbrdf

ROOT = Path(torchbrdf.__file__).parent
FLOORS = {
    **dict.fromkeys(
        (
            "numerics",
            "vector",
            "geometry",
            "constraint",
            "interval",
            "declaration",
            "kinds",
            "layout",
            "value",
            "loading",
            "stacking",
            "registry",
            "synonyms",
            "arguments",
            "parameters",
            "torch_compat",
            "compiling",
            "method",
            "training",
            "quadrature",
            "lookup",
            "sampling",
            "io",
        ),
        0,
    ),
    "optics": 1,
    **dict.fromkeys(("bsdf", "light", "scene"), 2),
    **dict.fromkeys(("effects", "planning"), 3),
    "nn": 4,
    **dict.fromkeys(("testing", "measure", "ledger"), 9),  # aside: they use the floors, nothing imports them
}
SIBLINGS = {"bsdf", "light", "scene"}  # never import one another
HEAVY = ("kornia", "trimesh", "OpenEXR", "embreex", "PIL", "safetensors", "matplotlib", "mpmath", "scipy", "tqdm")


def imports(source: str, package: tuple[str, ...]) -> set[str]:
    """First parts, below torchbrdf, of the modules that a file in ``package`` imports."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            path = (*base, *(node.module.split(".") if node.module else ()))
            paths = [path] if len(path) > 1 else [(*path, alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            paths = [tuple(alias.name.split(".")) for alias in node.names]
        else:
            continue
        found |= {p[1] for p in paths if p[0] == "torchbrdf" and len(p) > 1}
    return found


def faults(file: Path, source: str) -> list[str]:
    parts = file.relative_to(ROOT).with_suffix("").parts
    package = ("torchbrdf", *parts[:-1])
    home = parts[0]
    if home == "__init__":
        return []
    if home not in FLOORS:
        return [f"{file.name}: no floor is known for {home}; add it to FLOORS"]
    wrong = []
    for name in imports(source, package) - {home}:
        if FLOORS.get(name, 0) > FLOORS[home]:
            wrong.append(f"{'/'.join(parts)} (floor {FLOORS[home]}) imports {name} (floor {FLOORS[name]})")
        if home in SIBLINGS and name in SIBLINGS:
            wrong.append(f"{'/'.join(parts)} imports its sibling {name}")
    return wrong


def test_no_import_points_upward():
    assert [fault for file in ROOT.rglob("*.py") for fault in faults(file, file.read_text(encoding="utf-8"))] == []


def test_an_upward_import_is_found():
    assert faults(ROOT / "optics" / "x.py", "from ..bsdf.base import Bsdf\n")
    assert faults(ROOT / "numerics.py", "from . import vector, nn\n")
    assert faults(ROOT / "bsdf" / "x.py", "def f():\n    import torchbrdf.light.base\n")
    assert faults(ROOT / "effects" / "x.py", "from ..testing import check\n")
    assert not faults(ROOT / "bsdf" / "x.py", "from .. import numerics, vector\nfrom .base import Bsdf\n")


def loaded(code: str) -> set[str]:
    """Which heavy packages a fresh interpreter has loaded after running ``code``."""
    show = f"import sys; print(*[m for m in {('torch', *HEAVY)!r} if m in sys.modules])"
    return set(subprocess.run([sys.executable, "-c", f"{code}; {show}"], capture_output=True, text=True, check=True).stdout.split())


def test_importing_is_cheap():
    assert loaded("import torchbrdf") == set()
    assert loaded("import torchbrdf as tb; tb.Lambert(0.5) + tb.Phong(0.1, 5.0)") <= loaded("import torch"), "no more than torch itself"
