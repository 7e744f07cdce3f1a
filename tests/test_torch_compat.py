"""Private names of torch stand in one file, and each has a fallback: taken away in turn, the same comes out, or what the docstring says."""

import ast
import builtins
import shutil
import sys
import types
from pathlib import Path

import pytest
import torch
from torch.utils import _pytree as pytree

import torchbrdf as tb
from torchbrdf import torch_compat
from torchbrdf.interval import UNIT
from torchbrdf.testing.compiled import compiles
from torchbrdf.testing.subject import generator
from torchbrdf.value import COLOUR, Value, param, value

PACKAGE = Path(tb.__file__).parent


def private_names(source: str) -> list[str]:
    """What a file says of torch that begins with an underscore, and the counter of changes in place."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Attribute):
            found.append(ast.unparse(node))
    hidden = [n for n in found if n.startswith("torch.") and any(p.startswith("_") and not p.startswith("__") for p in n.split("."))]
    return hidden + [n for n in found if n.endswith("._version")]


def test_private_names_of_torch_stand_in_one_file():
    files = [f for f in PACKAGE.rglob("*.py") if f.name != "torch_compat.py"]
    assert {str(f.relative_to(PACKAGE)): names for f in files if (names := private_names(f.read_text(encoding="utf-8")))} == {}
    assert private_names((PACKAGE / "torch_compat.py").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "line", ["import torch._dynamo", "from torch.utils import _pytree as p", "torch._C._nn._parse_to(x)", "def f(t): return t._version"]
)
def test_a_private_name_is_found(line):
    assert private_names(f"import torch\n{line}\n")
    assert not private_names("import torch\nx = torch.__version__\n")


@pytest.fixture
def without(monkeypatch):
    """Takes a name away from a module of torch, as ``torch_compat`` sees it; torch itself keeps it."""
    real = builtins.__import__
    gone = []

    def guarded(name, globals=None, locals=None, fromlist=(), level=0):
        asks = (globals or {}).get("__name__") == torch_compat.__name__
        for part in (fromlist or ()) if asks else ():
            if (name, part) in gone:
                raise ImportError(f"cannot import name {part!r} from {name!r}")
        return real(name, globals, locals, fromlist, level)

    monkeypatch.setattr(builtins, "__import__", guarded)
    torch_compat.recomputing_backend.cache_clear()
    yield lambda module, name: gone.append((module, name))
    torch_compat.recomputing_backend.cache_clear()


def make_tint():
    class Tint(Value):
        """One colour."""

        colour: torch.Tensor = param(UNIT, COLOUR)

    Tint.__qualname__ = "Tint"
    return value(Tint)


def everyday(v):
    """What values do without transforms."""
    changed = [v.to(torch.float64), v.map(lambda t: 2 * t), v.detach(), v[0], v.replace(colour=torch.ones(3))]
    return [x.colour for x in changed] + [torch.tensor(v.batch_shape)]


def test_registered_values_are_nodes_with_names():
    v = make_tint()(torch.rand(2, 3))
    assert [pytree.keystr(path) for path, _ in pytree.tree_leaves_with_path(v)] == [".colour"]
    assert torch.func.vmap(lambda v: v.colour.sum())(v).shape == (2,)


def test_without_names_of_children_values_are_nodes_all_the_same(monkeypatch):
    real = pytree.register_pytree_node
    monkeypatch.setattr(pytree, "register_pytree_node", lambda cls, flatten, unflatten: real(cls, flatten, unflatten))
    v = make_tint()(torch.rand(2, 3))
    assert torch.equal(pytree.tree_leaves(v)[0], v.colour)
    assert torch.func.vmap(lambda v: v.colour.sum())(v).shape == (2,)


@pytest.mark.parametrize("part", [None, "GetAttrKey", "register_pytree_node"])
def test_without_pytrees_values_do_what_needs_no_transform(without, monkeypatch, part):
    colour = torch.rand(2, 3)
    expected = everyday(make_tint()(colour))
    if part is None:
        without("torch.utils", "_pytree")
    else:
        monkeypatch.delattr(pytree, part)
    v = make_tint()(colour)
    assert all(torch.equal(a, b) for a, b in zip(everyday(v), expected, strict=True))
    assert pytree.tree_leaves(v) == [v], "opaque, as the docstring says"


def test_without_a_budget_the_backend_is_inductor(without, monkeypatch):
    assert callable(torch_compat.recomputing_backend())
    assert torch_compat.recomputing_backend() is torch_compat.recomputing_backend(), "or torch compiles again"
    for module, part in (("torch._inductor.compile_fx", "compile_fx"), ("torch._functorch", "config")):
        torch_compat.recomputing_backend.cache_clear()
        without(module, part)
        assert torch_compat.recomputing_backend() == "inductor"


def test_without_the_private_names_a_loss_is_compiled_by_inductor_as_it_is(without):
    torch_compat.fusing_backend.cache_clear()
    assert callable(torch_compat.fusing_backend())
    assert torch_compat.fusing_backend() is torch_compat.fusing_backend(), "or torch compiles again"
    torch_compat.fusing_backend.cache_clear()
    without("torch._inductor.compile_fx", "compile_fx")
    assert torch_compat.fusing_backend() == "inductor"
    torch_compat.fusing_backend.cache_clear()


def test_the_backend_saves_nothing_and_leaves_others_their_budget(monkeypatch):
    from torch._functorch import config

    inner = types.SimpleNamespace(compile_fx=lambda graph, inputs, **_: config.activation_memory_budget)
    monkeypatch.setitem(sys.modules, "torch._inductor.compile_fx", inner)  # importing the real one takes seconds
    torch_compat.recomputing_backend.cache_clear()
    backend, before = torch_compat.recomputing_backend(True), config.activation_memory_budget
    torch_compat.recomputing_backend.cache_clear()
    assert backend(None, []) == 0.0
    assert config.activation_memory_budget == before != 0.0


@pytest.mark.parametrize("wanted", [torch_compat.LONG_FORMULAS, torch_compat.LOSSES])
def test_settings_are_for_cpus_and_those_that_torch_has(without, monkeypatch, wanted):
    from torch._inductor import config

    assert torch_compat._settings([torch.rand(2), 3], wanted) == wanted
    assert torch_compat._settings([torch.rand(2), torch.rand(2, device="meta")], wanted) == {}
    monkeypatch.setitem(wanted, "a_setting_that_is_gone", 1)
    assert all(hasattr(config, name) for name in torch_compat._settings([], wanted))
    without("torch._inductor", "config")
    assert torch_compat._settings([], wanted) == {}


def test_graphs_that_end_in_a_loss_are_not_computed_twice(monkeypatch):
    from torch._functorch import config

    budgets = []
    inner = types.SimpleNamespace(compile_fx=lambda graph, inputs, **_: budgets.append(config.activation_memory_budget) or graph.forward)
    monkeypatch.setitem(sys.modules, "torch._inductor.compile_fx", inner)
    torch_compat.recomputing_backend.cache_clear()
    pixels, always = torch_compat.recomputing_backend(), torch_compat.recomputing_backend(True)
    torch_compat.recomputing_backend.cache_clear()
    x = torch.rand(3, requires_grad=True)
    graphs = (
        lambda x: x * x,
        lambda x: (x * x).mean(),
        lambda x: (x * x, x.detach().mean()),
        lambda x: {"loss": (x * x).sum(), "image": x},
    )
    for backend in (pixels, always):
        for graph in graphs:
            torch.compile(graph, backend=backend, fullgraph=True)(x)
    saved = config.activation_memory_budget
    assert budgets == [0.0, saved, 0.0, saved] + [0.0] * 4


def test_a_budget_of_another_name_is_left_out(monkeypatch):
    def patch(**changes):
        raise AttributeError(f"no {changes}")

    torch_compat.recomputing_backend.cache_clear()
    monkeypatch.setattr(torch._functorch, "config", types.SimpleNamespace(patch=patch))
    assert torch_compat.recomputing_backend() == "inductor"
    torch_compat.recomputing_backend.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("gone", [False, True])
def test_both_backends_give_what_eager_gives(without, gone):
    if not torch_compat.has_cpp_compiler():
        pytest.skip("there is no C++ compiler")
    if gone:
        without("torch._inductor.compile_fx", "compile_fx")
    albedo, wi = torch.rand(64, 3), tb.normalize(torch.rand(64, 3))
    results = []
    for fn in (shaded, tb.compile(shaded)):
        given = albedo.clone().requires_grad_()
        out = fn(given, wi)
        out.square().sum().backward()
        results.append((out.detach(), given.grad))
    for a, b in zip(*results, strict=True):
        torch.testing.assert_close(a, b)


def shaded(albedo, wi):
    return (tb.Lambert(albedo) + tb.Phong(albedo, 5.0)).evaluate(wi, wi)


@pytest.mark.parametrize("gone", [False, True])
def test_the_compiler_is_found_by_path_and_by_name(without, monkeypatch, tmp_path, gone):
    from torch._inductor import cpp_builder

    if gone:
        without("torch._inductor.cpp_builder", "get_cpp_compiler")
    usual = {"win32": "cl", "darwin": "clang++"}.get(sys.platform, "g++")
    found = shutil.which(usual) is not None
    monkeypatch.delenv("CXX", raising=False)
    cpp_builder.cpp_compiler_search.cache_clear()
    assert torch_compat.has_cpp_compiler() is found
    cpp_builder.cpp_compiler_search.cache_clear()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert torch_compat.has_cpp_compiler() is False
    cpp_builder.cpp_compiler_search.cache_clear()


@pytest.mark.parametrize("gone", [False, True])
def test_a_model_that_does_not_compile_is_reported_as_such(without, monkeypatch, gone):
    if gone:
        without("torch._dynamo.exc", "TorchDynamoException")
    assert torch_compat.compile_error() is (RuntimeError if gone else torch._dynamo.exc.TorchDynamoException)

    def refuse(*args, **kwargs):
        def call(*inputs):
            raise torch._dynamo.exc.Unsupported("a graph break")

        return call

    monkeypatch.setattr(torch, "compile", refuse)
    found = compiles(tb.Lambert(0.5), generator(0))
    assert found.ok is False
    assert "graph break" in found.detail
