"""Values: what every frozen bundle of tensors can do, and what it refuses."""

import copy
import dataclasses
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch.utils import _pytree as pytree

import torchbrdf as tb
from torchbrdf import arguments
from torchbrdf.interval import NONNEGATIVE, REAL, UNIT
from torchbrdf.value import COLOUR, SCALAR, VECTOR, param, value

META = torch.device("meta")


def mixture(*batch):
    gen = torch.Generator().manual_seed(0)

    def colour():
        return torch.rand(*batch, 3, generator=gen)

    return tb.Lambert(colour()) + 0.5 * tb.Phong(colour(), 10 * torch.rand(*batch, 1, generator=gen), fresnel=tb.Schlick(colour()))


def equal(a, b):
    (xs, spec_a), (ys, spec_b) = pytree.tree_flatten(a), pytree.tree_flatten(b)
    return spec_a == spec_b and all(torch.equal(x, y) for x, y in zip(xs, ys, strict=True))


def test_numbers_become_tensors():
    p = tb.Phong([0.1, 0.2, 0.3], 10)
    assert (p.specular.dtype, p.exponent.tolist()) == (torch.float64, [10.0])
    array = torch.rand(4, 3).numpy()
    assert tb.Lambert(array).albedo.dtype == torch.float32


def test_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        tb.Lambert(0.5).albedo = torch.ones(1)


def test_to():
    colour = tb.Lambert(torch.tensor([0.1, 0.2, 0.3]))
    assert [t.dtype for v in (colour, tb.Lambert(0.5)) for _, t in v.to(torch.float16).named_tensors()] == [torch.float16] * 2
    m = mixture(4).to(torch.float64)
    assert all(t.dtype == torch.float64 for t in pytree.tree_leaves(m))
    assert mixture(4).to("meta").terms[0].albedo.device.type == "meta"
    assert mixture(4).to(device="meta", dtype=torch.float16).terms[0].albedo.dtype == torch.float16


TO = {
    "nothing": ((), {}, (None, None, False, False)),
    "a dtype": ((torch.float16,), {}, (None, torch.float16, False, False)),
    "a device": (("meta",), {}, (META, None, False, False)),
    "both": ((META, torch.float64), {}, (META, torch.float64, False, False)),
    "both, and how": (("meta", torch.float64, True), {}, (META, torch.float64, True, False)),
    "all in order": (("meta", torch.float64, False, True), {}, (META, torch.float64, False, True)),
    "a dtype, and how": ((torch.float64, True, False), {}, (None, torch.float64, True, False)),
    "a tensor": ((torch.empty(1, dtype=torch.bfloat16, device=META),), {}, (META, torch.bfloat16, False, False)),
    "names": ((), {"device": "meta", "dtype": torch.float16, "non_blocking": True}, (META, torch.float16, True, False)),
    "a copy": ((), {"copy": True}, (None, None, False, True)),
    "None": ((None, torch.float16), {"memory_format": torch.preserve_format}, (None, torch.float16, False, False)),
}


@pytest.mark.parametrize("case", TO)
def test_to_takes_what_tensors_take(case):
    args, named, expected = TO[case]
    assert arguments.placement(*args, **named) == expected
    t = torch.rand(2, 3)
    found, like = tb.Lambert(t).to(*args, **named).albedo, t.to(*args, **named)
    assert (found.device, found.dtype, found is t) == (like.device, like.dtype, like is t)


@pytest.mark.parametrize("wrong", [torch.int32, "nowhere", 0.5])
def test_to_refuses_what_tensors_refuse(wrong):
    with pytest.raises((TypeError, RuntimeError)):
        tb.Lambert(0.5).to(wrong)


def test_detach_and_replace():
    albedo = torch.rand(3, requires_grad=True)
    a = tb.Lambert(albedo)
    assert a.albedo is albedo, "a leaf stays a leaf"
    assert not a.detach().albedo.requires_grad
    assert a.replace(albedo=0.2).albedo.tolist() == [0.2]


def test_indexing():
    m = mixture(5, 4)
    assert m.batch_shape == (5, 4)
    for index in (2, slice(1, 3), (2, 3), (..., 1), (slice(None), 1), torch.tensor([0, 3]), torch.rand(5, 4) > 0.5, None):
        got = m[index]
        assert torch.equal(got.terms[0].albedo, m.terms[0].albedo[index if index != (..., 1) else (slice(None), 1)])
        assert torch.equal(got.terms[1].inner.fresnel.f0, m.terms[1].inner.fresnel.f0[index if index != (..., 1) else (slice(None), 1)])
        assert got.terms[1].factor.tolist() == [0.5], "what has no batch axes stays"
    with pytest.raises(IndexError):
        m[1, 2, 0]


def test_indexing_follows_the_common_batch():
    p = tb.Phong(torch.rand(4, 1, 3), torch.rand(5, 1))
    assert p.batch_shape == (4, 5)
    assert p[3].specular.shape == (5, 3)
    assert p[3].exponent.shape == (5, 1)


def test_repr():
    assert repr(tb.Phong([0.1, 0.2, 0.3], 10)) == "Phong(specular=[0.1, 0.2, 0.3], exponent=[10.0], normalization='modified')"
    assert repr(tb.Lambert(torch.rand(5, 3))) == "Lambert(albedo=float32[5, 3])"
    assert "meta" not in repr(tb.Lambert(torch.rand(3, device="meta")))


# Saved values


def written(path, structure, **tensors):
    """A file that holds ``structure``, whatever it is."""
    save_file(tensors, path, {"torchbrdf": json.dumps(structure)})
    return path


def reloaded(tmp_path, v):
    v.save(tmp_path / "v.safetensors")
    return tb.load_value(tmp_path / "v.safetensors")


def test_save_and_load(tmp_path):
    m = mixture(4) + tb.Mirror(0.3)
    assert equal(reloaded(tmp_path, m), m)
    with safe_open(tmp_path / "v.safetensors", "pt") as file:
        assert {"terms[0].albedo", "terms[1].inner.fresnel.f0"} < set(file.keys()), "other tools find the tensors by their paths"


@value
class Everything(tb.Value):
    """One field of every kind."""

    floats: torch.Tensor = param(REAL, VECTOR)
    integers: torch.Tensor = param(REAL, VECTOR, default=None, kind="int")
    bools: torch.Tensor = param(REAL, VECTOR, default=None, kind="bool")
    inner: tb.Value | None = None
    held: tuple = ()
    name: str = "grün \n"
    count: int = 3
    size: tuple[float, float] = (0.1, math.inf)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16])
def test_every_dtype_of_floats_is_kept(tmp_path, dtype):
    again = reloaded(tmp_path, v := Everything(torch.randn(4, 5, 3).to(dtype)))
    assert again.floats.dtype == dtype
    assert equal(again, v)


@pytest.mark.parametrize("dtype", [torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8])
def test_every_dtype_of_integers_is_kept(tmp_path, dtype):
    v = Everything(torch.zeros(0, 4, 3), torch.randint(0, 100, (4, 3), dtype=dtype), torch.rand(4, 3) > 0.5)
    again = reloaded(tmp_path, v)
    assert (again.integers.dtype, again.bools.dtype, again.floats.shape) == (dtype, torch.bool, (0, 4, 3))
    assert equal(again, v)


def test_what_holds_the_tensors_is_kept(tmp_path):
    inner = Everything([1.0, 2.0, 3.0], inner=tb.Lambert(0.5), name="", count=-(2**70))
    v = Everything(torch.full((3,), math.nan), inner=inner, held=(1, None, (True, 2.5), inner, (tb.Schlick(0.04), "x")))
    again = reloaded(tmp_path, v)
    assert repr(again) == repr(v)
    assert pytree.tree_structure(again) == pytree.tree_structure(v)


def test_a_header_whose_length_begins_like_a_pickle_is_read(tmp_path):
    """The file begins with the length of its header, and 640 is 0x0280."""
    seen = set()
    for count in range(0, 800, 4):
        v = Everything([1.0, 2.0, 3.0], name="x" * count)
        assert reloaded(tmp_path, v).name == v.name
        seen.add((tmp_path / "v.safetensors").read_bytes()[:2])
    assert seen & {b"\x80\x02", b"\x80\x03", b"\x80\x04"}


@pytest.mark.parametrize("batch", [(), (4,), (4, 5)])
def test_planar_tensors_stay_planar(tmp_path, batch):
    for v in (tb.Lambert(tb.planar(torch.rand(*batch, 3))), tb.Lambert(torch.rand(*batch, 3))):
        again = reloaded(tmp_path, v)
        assert equal(again, v)
        assert again.albedo.stride() == v.albedo.stride()


def test_strided_and_shared_tensors_are_saved_right(tmp_path):
    whole = torch.rand(6, 8, 3)
    for albedo in (whole[::2, 1::3], whole.transpose(0, 1), whole[0, :1].expand(7, 3), whole.flip(-1), whole.requires_grad_()):
        assert equal(
            reloaded(tmp_path, tb.Lambert(albedo) + tb.Lambert(whole[:1, :1])), (tb.Lambert(albedo) + tb.Lambert(whole[:1, :1])).detach()
        )


def test_a_tensor_in_two_places_is_stored_once(tmp_path):
    shared = torch.rand(1000, 3)
    again = reloaded(tmp_path, tb.Lambert(shared) + tb.Phong(shared, 5.0))
    assert (tmp_path / "v.safetensors").stat().st_size < 1.2 * shared.nbytes
    assert again.terms[0].albedo.data_ptr() == again.terms[1].specular.data_ptr()


def test_a_loaded_value_is_no_window_on_its_file(tmp_path):
    first = reloaded(tmp_path, v := tb.Lambert(torch.rand(1000, 3)))
    with (tmp_path / "v.safetensors").open("r+b") as file:
        file.seek(-4000, os.SEEK_END)
        file.write(bytes(4000))
    assert equal(first, v)
    first.save(tmp_path / "v.safetensors")  # over the file that it came from
    assert equal(tb.load_value(tmp_path / "v.safetensors"), v)


def test_load_in_a_fresh_process(tmp_path):
    """The names in a file are found although nothing has imported them yet."""
    mixture(4).save(tmp_path / "m.safetensors")
    code = f"import torchbrdf as tb; print(tb.load_value({str(tmp_path / 'm.safetensors')!r}))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.startswith("Sum(terms=(Lambert")


def test_load_refuses(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        tb.load_value(tmp_path / "absent.safetensors")
    (tmp_path / "a").write_text("hello")
    with pytest.raises(ValueError, match="a is not a saved torchbrdf value"):
        tb.load_value(tmp_path / "a")
    albedo = {"$tensor": "albedo", "planar": False}
    for structure, why in {
        "unknown": ({"value": "torchbrdf.Unknown", "fields": {}}, "found 'torchbrdf.Unknown'"),
        "list": ([1, 2], "found 'list'"),
        "a field that we lack": (
            {"value": "torchbrdf.Lambert", "fields": {"albedo": albedo, "colour": 1}},
            "does not fit this version.*'colour'",
        ),
        "a field that it lacks": ({"value": "torchbrdf.Lambert", "fields": {}}, "does not fit this version.*'albedo'"),
        "a tensor that it lacks": (
            {"value": "torchbrdf.Lambert", "fields": {"albedo": {"$tensor": "x", "planar": False}}},
            "KeyError: 'x'",
        ),
    }.values():
        with pytest.raises(ValueError, match=why):
            tb.load_value(written(tmp_path / "a", structure, albedo=torch.ones(3)))


@pytest.mark.parametrize("inside", [False, True])
def test_what_no_range_describes_is_checked_on_loading(tmp_path, inside):
    mesh = {"value": "torchbrdf.Mesh", "fields": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 3]]}}
    holder = {"value": f"{__name__}.Everything", "fields": {"floats": [1, 2, 3], "held": [1, mesh]}}
    with pytest.raises(ValueError, match=r"Mesh\.faces: legal are 0 to 2"):
        tb.load_value(written(tmp_path / "a", holder if inside else mesh))


@pytest.mark.parametrize(
    ("held", "what"),
    [
        ({"a": 1}, "Everything: a dictionary cannot be saved"),
        ((1, {2}), "found set"),
        ((torch.float32,), "found dtype"),
        ((1j,), "found complex"),
    ],
)
def test_what_is_no_plain_data_is_not_saved(tmp_path, held, what):
    with pytest.raises(TypeError, match=what):
        Everything([1.0, 2.0, 3.0], held=held).save(tmp_path / "a")
    assert not (tmp_path / "a").exists()


class Bomb:
    def __reduce__(self):
        return (print, ("code from the file ran",))


def test_load_reads_no_pickle(tmp_path, capsys):
    torch.save({"value": "torchbrdf.Lambert", "fields": {"albedo": Bomb()}}, tmp_path / "bomb.pt")
    with pytest.raises(ValueError, match=r"bomb.pt is not a saved torchbrdf value: it is a pickle"):
        tb.load_value(tmp_path / "bomb.pt")
    assert capsys.readouterr().out == ""


# Names of classes


def test_a_class_named_like_ours_is_not_taken_for_it(tmp_path):
    ours = tb.Phong(0.25, 5.0)
    ours.save(tmp_path / "ours")

    @value
    class Phong(tb.Value):
        """Has the name and the fields of ours."""

        specular: torch.Tensor = param(UNIT, COLOUR)
        exponent: torch.Tensor = param(NONNEGATIVE, SCALAR)
        fresnel: tb.Value | None = None
        normalization: str = "modified"

    Phong(0.5, 2.0).save(tmp_path / "mine")
    assert type(tb.load_value(tmp_path / "ours")) is tb.Phong
    assert type(tb.load_value(tmp_path / "mine")) is Phong
    assert equal(pytree.treespec_loads(pytree.treespec_dumps(pytree.tree_structure(ours))).unflatten(pytree.tree_leaves(ours)), ours)


MINE = """
import torchbrdf as tb
from torchbrdf.interval import UNIT
from torchbrdf.value import COLOUR, param, value

@value
class Mine(tb.Value):
    albedo: object = param(UNIT, COLOUR)

if __name__ == "__main__":
    Mine(0.25).save("mine")
"""


def test_what_a_script_saved_is_found_in_the_module_it_is_elsewhere(tmp_path):
    for name in ("train", "other"):
        (tmp_path / f"{name}.py").write_text(MINE)
    (tmp_path / "like_ours.py").write_text(MINE.replace("Mine", "Lambert").replace("mine", "like_ours"))

    def run(*arguments):
        path = {**os.environ, "PYTHONPATH": os.pathsep.join((str(Path(tb.__file__).parents[1]), str(tmp_path)))}
        return subprocess.run([sys.executable, *arguments], cwd=tmp_path, env=path, capture_output=True, text=True)

    assert run("train.py").returncode == 0
    assert run("like_ours.py").returncode == 0
    assert "found '__main__.Lambert'" in run("-c", "import torchbrdf as tb; tb.Lambert; tb.load_value('like_ours')").stderr
    load = """
import torchbrdf as tb

def load():
    try:
        v = tb.load_value("mine")
        print(type(v).__module__, v)
    except Exception as error:
        print(error)

load()
import train; load()
import other; load()
"""
    unknown, known, doubtful = run("-c", load).stdout.splitlines()
    assert "found '__main__.Mine' for a value; import the module that defines it first" in unknown
    assert known.startswith("train Mine(albedo=[0.25])")
    assert "found '__main__.Mine' for a value" in doubtful, "which of the two is not guessed"


def test_pytree():
    m = mixture(4)
    leaves, spec = pytree.tree_flatten(m)
    assert len(leaves) == 5
    assert equal(pytree.tree_unflatten(leaves, spec), m)
    assert [pytree.keystr(path) for path, _ in pytree.tree_leaves_with_path(tb.Phong(0.1, 5.0))] == [".specular", ".exponent"]
    assert equal(copy.deepcopy(m), m)


def test_transforms_see_through():
    m = mixture(4)
    wi, wo = (tb.normalize(torch.rand(4, 3) + 0.1) for _ in range(2))
    expected = m.evaluate(wi, wo)
    torch.testing.assert_close(
        torch.func.vmap(lambda m, wi, wo: m.evaluate(wi, wo), in_dims=(0, 0, 0))(m[torch.arange(4)].map(_batch(4)), wi, wo), expected
    )
    _, tangent = torch.func.jvp(lambda m: m.evaluate(wi, wo), (m,), (m.map(torch.ones_like),))
    assert tangent.shape == expected.shape
    grads = torch.func.grad(lambda m: m.evaluate(wi, wo).sum())(m)
    assert isinstance(grads, tb.Sum)
    torch.testing.assert_close(grads.terms[0].albedo, torch.full((4, 3), 1 / math.pi))
    torch.testing.assert_close(
        torch.func.vmap(lambda a: tb.Lambert(a).evaluate(wi[0], wo[0]))(m.terms[0].albedo), m.terms[0].evaluate(wi[0], wo[0])
    )


def _batch(n):
    return lambda t: t if t.dim() > 1 else t.expand(n, -1)


def test_functional_call():
    class Model(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.albedo = torch.nn.Parameter(torch.full((3,), 0.5))

        def forward(self, wi):
            return tb.Lambert(self.albedo).evaluate(wi, wi)

    up = torch.tensor([0.0, 0.0, 1.0])
    f = torch.func.functional_call(Model(), {"albedo": torch.full((3,), 0.25)}, (up,))
    torch.testing.assert_close(f * math.pi, torch.full((3,), 0.25))


WRONG = {
    "size": (lambda: tb.Phong(0.5, torch.rand(4)), ValueError, r"Phong.exponent: expected shape \[..., 1\], found \[4\]; did you mean"),
    "text": (lambda: tb.Lambert("red"), TypeError, "Lambert.albedo: expected a number, list, array or tensor, found str"),
    "ints": (lambda: tb.Lambert(torch.ones(3, dtype=torch.int64)), TypeError, "expected a tensor of floats, found torch.int64; convert"),
    "complex": (lambda: tb.Lambert(torch.ones(3, dtype=torch.complex64)), TypeError, "expected a tensor of floats, found torch.complex64"),
    "channels": (lambda: tb.Conductor([1.0] * 3, [1.0] * 4), ValueError, "different numbers of channels"),
    "batches": (lambda: tb.Phong(torch.rand(4, 3), torch.rand(5, 1)), ValueError, "batch shapes do not broadcast"),
    "exponent": (lambda: tb.validate(tb.Phong(1.0, -1.0)), ValueError, r"Phong.exponent \[1\]: legal range \[0, inf\), found -1"),
    "albedo": (
        lambda: tb.validate(tb.Lambert([0.5, 1.2, 1.3])),
        ValueError,
        r"legal range \[0, 1\], found 1.2 and 1 more \(min 0.5, max 1.3\); clamp",
    ),
    "not a number": (lambda: tb.validate(tb.Lambert(math.nan)), ValueError, "found nan"),
    "infinite": (lambda: tb.validate(tb.Phong(math.inf, 1.0)), ValueError, "found inf"),
    "nested": (
        lambda: tb.validate(tb.Mirror(1.0, tb.Dielectric(0.0))),
        ValueError,
        r"Mirror > Dielectric.eta .* legal range \(0, inf\), found 0",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input(case):
    call, error, message = WRONG[case]
    with pytest.raises(error, match=message):
        call()


def test_valid_passes():
    tb.validate(mixture(4))
    tb.validate(tb.Lambert(torch.rand(0, 3)))
    tb.validate(mixture(2).to("meta"))


@pytest.mark.parametrize("interval", [UNIT, NONNEGATIVE, REAL, tb.Interval(2.0, 5.0)], ids=str)
def test_interval(interval):
    u = torch.linspace(-6, 6, 25, dtype=torch.float64)
    x = interval.from_unconstrained(u)
    assert bool(interval.contains(x).all())
    inside = x[(x > interval.low) & (x < interval.high)]
    assert len(inside) >= 24  # all but u = 0, where the range may end
    torch.testing.assert_close(interval.from_unconstrained(interval.to_unconstrained(inside)), inside)
    drawn = interval.draw((1000,), torch.Generator().manual_seed(0))
    assert bool(interval.contains(drawn).all())
    for end in interval.extremes():
        assert bool(interval.contains(torch.tensor(end)))
        assert math.isfinite(interval.to_unconstrained(torch.tensor(end)).item()), "a start on the bound begins a little inside"


def test_interval_draws_over_decades():
    drawn = tb.Interval(0.0, typical=(1e-3, 1e3)).draw((4000,), torch.Generator().manual_seed(0))
    assert 0.4 < float((drawn < 1).double().mean()) < 0.6
