"""The ledger: every method keeps its claim, has a row, and a fault in it is seen. Errors, never times."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from torchbrdf import registry
from torchbrdf.ledger import cost, machine, measure, page, pictures, points, record, rows
from torchbrdf.ledger.__main__ import main, options
from torchbrdf.ledger.errors import Errors, Measured, Spread, broken, of_slopes, relative, run
from torchbrdf.method import Law, Method

LAWS = registry.laws()
DOCS = Path(__file__).resolve().parents[1] / "docs"
FEW = 300


@pytest.fixture(scope="module")
def measured() -> dict[str, Measured]:
    return {name: Measured(law, torch.float32, FEW) for name, law in LAWS.items()}


@pytest.mark.parametrize(("law", "method"), [(law.name, m.name) for law in LAWS.values() for m in law.methods])
def test_a_method_keeps_its_claim(law, method, measured):
    m = LAWS[law][method]
    assert broken(m, measured[law].errors(m.formula), LAWS[law]) == []


@pytest.mark.parametrize("law", LAWS)
def test_faults_are_seen(law, measured):
    """A value nudged; a slope cut by one input; a value that is infinite, or not a number."""
    right = LAWS[law].default

    def cut(*x):
        return right.formula(*x[:-1], x[-1].detach()) + 0.0 * x[-1]

    def spoilt(*x):
        return right.formula(*x) / (torch.arange(len(x[-1])) != 7)

    def lost(*x):
        return torch.where(torch.arange(len(x[-1])) == 7, torch.nan, right.formula(*x))

    for fault in (lambda *x: 1.001 * right.formula(*x), cut, spoilt, lost):
        faulty = dataclasses.replace(right, formula=fault)
        assert broken(faulty, measured[law].errors(fault), LAWS[law])
    assert "value wrong by inf" in broken(faulty, measured[law].errors(lost), LAWS[law])[0]


def test_an_approximation_that_claims_too_little_is_seen(measured):
    law = LAWS["dielectric"]
    modest = dataclasses.replace(law["Schlick"], claim="0.07 everywhere")
    assert broken(modest, measured["dielectric"].errors(modest.formula), law)


def test_claims_are_numbers():
    claim = {"16 ulp everywhere": (16 * 2.0**-23, True), "2e-5 of the value, s < 9": (2e-5, True), "0.07 for eta in [1, 2]": (0.07, False)}
    for words, meant in claim.items():
        assert Method("m", torch.abs, "", "", words).claimed() == meant
    with pytest.raises(ValueError, match="begin with a number"):
        Method("m", torch.abs, "", "", "accurate").claimed()


def test_errors_by_hand():
    """Of x^2, by a formula that is wrong by 1 % in its value and by half in its slope; a point at 0 counts nothing."""

    def wrong(x):
        return 0.51 * x * x + 0.5 * (x * x).detach()

    law = Law("square", {"x": (1.0, 2.0)}, lambda m, x: x * x, (Method("m", wrong, "", "", "1"),))
    x = {"x": np.array([0.0, 1.0, 2.0])}
    found, exact = run(wrong, x, torch.float64), measure_truth(law, x)
    assert relative(found, exact) == pytest.approx([0.0, 0.01, 0.01])
    assert of_slopes(found, exact) == pytest.approx([0.0, 0.98 / 2, 0.98 * 2 / 4])
    e = Spread.of(np.array([0.0, 1e-5, 2e-4, np.inf]))
    assert (e.worst, e.off) == (np.inf, 0.5)


def measure_truth(law, x):
    from torchbrdf.ledger.truth import truth

    return truth(law, x)


def test_slopes_by_directions_count_along_the_sphere(measured):
    """assume_unit differs from the truth by the slope along the direction itself, which no unit vector can follow."""
    law = LAWS["phong_lobe"]
    assert measured["phong_lobe"].errors(law["assume_unit"].formula).slope.worst < 1e-3


def test_points_are_everyday_and_numbers_of_the_dtype():
    for law in LAWS.values():
        for dtype in (torch.float32, torch.bfloat16):
            x = points.everyday(law, dtype, FEW)
            for name, (low, high) in law.inputs.items():
                assert low * 0.99 <= x[name].min() < x[name].max() <= high * 1.01
            assert all((torch.from_numpy(v).to(dtype).double().numpy() == v).all() for v in x.values())
            assert [t.shape[1:] for t in points.tensors(x, dtype, 1000)] == [v.shape[1:] for v in x.values()]
    lobe = points.everyday(LAWS["blinn_lobe"], torch.float64, FEW)
    assert min((lobe["n"] * lobe[w]).sum(1).min() for w in ("wi", "wo")) > 0.05


def test_pixels_of_spot_keep_their_angles():
    from torchbrdf.ledger import spot

    d = spot.directions(np.random.default_rng(0))
    found = np.stack([(d[a] * d[b]).sum(1) for a, b in (("n", "wi"), ("n", "wo"), ("wi", "wo"))], 1)
    assert np.abs(found - spot.cosines()).max() < 3e-5  # kept with six digits, of cosines near 1
    assert spot.cosines()[:, :2].min() > 0
    assert len(spot.cosines()) == 500


def test_every_method_is_published():
    """Run python3 run.py ledger after a method was added."""
    found = record.read(DOCS / "accuracy-cost.json")
    assert record.missing(LAWS, found) == []
    extra = Method("extra", torch.abs, "", "", "1")
    law = LAWS["dielectric"]
    more = {**LAWS, "dielectric": dataclasses.replace(law, methods=(*law.methods, extra)), "new": Law("new", {}, abs, (extra,))}
    assert record.missing(more, found) == ["dielectric, extra", "new, extra"]


def test_the_published_page_is_that_of_the_json():
    """Its words and tables; a claim that has changed since is read from the code, so the page has to be made again."""
    found = record.read(DOCS / "accuracy-cost.json")
    text = (DOCS / "accuracy-cost.md").read_text(encoding="utf-8")
    names = {}
    for law, name in re.findall(r"!\[([^:\]]*)[^\]]*\]\(images/([^)]*)\)", text):
        names.setdefault(law if law in LAWS else "", []).append(name)
    assert text == page.text(found, names)
    assert all((DOCS / "images" / name).exists() for some in names.values() for name in some)
    said = {(law, m["name"]): (m["claim"], m["call"], m["source"]) for law, r in found["laws"].items() for m in r["methods"]}
    assert said == {(law.name, m.name): (m.claim, m.call, m.source) for law in LAWS.values() for m in law.methods}


def test_the_rows_of_a_law():
    found = [row.label for row in rows.rows_of(LAWS["dielectric"])]
    assert found[:2] == ["standard, eager", "standard, compiled"]
    assert {"standard, compiled, nothing recomputed", "textbook, eager", "standard, float64, compiled", "standard, float16, eager"} <= set(
        found
    )
    assert len(found) == len(set(found))


def test_the_front():
    assert pictures.front([(2, 2), (1, 5), (3, 3), (4, 1), (2, 4)]) == [(1, 5), (2, 2), (4, 1)]


def test_the_whole_run(tmp_path, monkeypatch, capsys):
    """Costs, page, JSON and pictures, of one law; what is compiled is left as it is."""
    monkeypatch.setattr(cost, "compile_as_the_package_does", lambda fn, recompute: fn)
    monkeypatch.setattr(torch.compiler, "reset", lambda: None)  # which loads the compiler first
    asked = ["--laws", "dielectric", "--points", "50", "--pixels", "64", "--rounds", "2", "--out", str(tmp_path)]
    assert main(asked) == 0
    found = json.loads((tmp_path / "accuracy-cost.json").read_text())
    assert list(found["laws"]) == ["dielectric"]
    assert {"device", "versions", "commit", "threads"} <= found["laws"]["dielectric"]["machine"].keys()
    (row, *_) = found["laws"]["dielectric"]["rows"]
    assert row["costs"]["both"]["low"] <= row["costs"]["both"]["median"] <= row["costs"]["both"]["high"]
    assert row["costs"]["kept"] > 4, "the graph holds intermediate tensors"
    text = (tmp_path / "accuracy-cost.md").read_text()
    assert f"| {row['method']} | float32 | eager | 1.00 |" not in text.split("compile, s")[0]
    assert sorted(p.name for p in (tmp_path / "images").iterdir()) == [
        "ledger-look-dielectric.png",
        "ledger-time-dielectric.png",
        "ledger.png",
    ]
    assert "Measured on" in capsys.readouterr().out


def test_a_law_measured_again_leaves_the_others(tmp_path, capsys):
    for law in ("dielectric", "conductor"):
        assert main(["--only-errors", "--laws", law, "--points", "20" if law == "conductor" else "30", "--out", str(tmp_path)]) == 0
    found = record.read(tmp_path / "accuracy-cost.json")["laws"]
    assert {name: law["machine"]["points"] for name, law in found.items()} == {"dielectric": 30, "conductor": 20}
    text = (tmp_path / "accuracy-cost.md").read_text(encoding="utf-8")
    assert "30 points" in text
    assert "20 points" in text


def test_a_claim_that_is_not_kept_fails_the_run(monkeypatch, capsys):
    law = LAWS["conductor"]
    broken_law = dataclasses.replace(law, methods=(law.default, dataclasses.replace(law["Schlick"], claim="0.001")))
    monkeypatch.setattr(registry, "laws", lambda: {"conductor": broken_law})
    assert main(["--only-errors", "--points", "50"]) == 1
    assert "not as claimed: conductor, Schlick: value wrong by" in capsys.readouterr().out


def test_memory_kept_is_that_of_the_graph(measured):
    """exp keeps its result, 4 bytes a pixel; a product keeps its inputs, which do not count."""
    for formula, kept in ((lambda c, eta: torch.exp(c) + eta, 4.0), (lambda c, eta: c * eta, 0.0)):
        row = rows.Row("m", formula, None)
        assert cost.Contestant(row, measured["dielectric"], 1024).kept() == kept


def test_the_command_says_what_is_wrong(monkeypatch, capsys):
    with pytest.raises(SystemExit):
        options(["--rounds", "0"])
    assert "--rounds: found 0" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="found glass; there are dielectric"):
        measure.chosen(["glass"])
    monkeypatch.setattr(machine, "NEEDED", ("gmpy2", "no_such_package"))
    assert main(["--only-errors"]) == 2
    assert "no_such_package" in capsys.readouterr().err


def test_without_gmpy2_there_is_one_clear_line():
    code = "import sys; sys.modules['gmpy2'] = None; from torchbrdf.ledger.__main__ import main; sys.exit(main(['--only-errors']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "the ledger needs gmpy2, not found here; install with: pip install 'torchbrdf[bench]'" in done.stderr
    assert "Traceback" not in done.stderr


def test_errors_of_the_compiled_call_are_those_at_the_points(measured):
    """The pixels that are timed repeat the points; errors are those of each point once."""
    m = measured["dielectric"]
    law = LAWS["dielectric"]
    c = cost.Contestant(rows.Row("standard", law.default.formula, law.default), m, 4 * FEW)
    found: Errors = c.errors()
    assert found == m.errors(law.default.formula)


def test_a_law_must_stand_in_both_tables(monkeypatch):
    monkeypatch.setitem(registry.LAWS, "sheen", "bsdf.laws")
    with pytest.raises(LookupError, match="sheen"):
        registry.laws()
