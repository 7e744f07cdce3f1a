"""Materials and shaders as modules: what they refuse, what they save, and how they train alone, stacked and in company."""

import copy
import pickle

import pytest
import torch
from test_shade import sheet, three_lights
from torch import nn

import torchbrdf as tb
from torchbrdf import torch_compat

UP = torch.tensor([0.0, 0.0, 1.0])


def textured(n=6):
    g = sheet(n)
    return g.replace(uv=0.5 + 0.4 * g.position[..., :2])


def material(exponent=12.0):
    torch.manual_seed(3)
    diffuse = tb.nn.Material(tb.Lambert, albedo=tb.nn.Texture(0.2 + 0.6 * torch.rand(4, 5, 3)))
    fresnel = tb.nn.Material(tb.Dielectric, eta=tb.nn.Learned(1.4))
    return diffuse + tb.nn.Material(tb.Phong, specular=tb.nn.Learned([0.4]), exponent=tb.nn.Learned(exponent), fresnel=fresnel)


def shader(exponent=12.0):
    made = material(exponent)
    g = textured()
    return tb.nn.Shader(made, tb.plan(g, made(g), three_lights())), g


def test_a_material_makes_its_model_at_every_pixel():
    g = textured()
    brdf = material()(g)
    assert [type(t) for t in brdf.terms] == [tb.Lambert, tb.Phong]
    assert brdf.terms[0].albedo.shape == (6, 6, 3)
    assert isinstance(brdf.terms[1].fresnel, tb.Dielectric)
    torch.testing.assert_close(brdf.terms[1].exponent.detach(), torch.tensor([12.0]))


def test_numbers_are_held_constant_and_static_arguments_pass_through():
    phong = tb.nn.Material(tb.Phong, specular=0.3, exponent=[20.0], fresnel=tb.Schlick(0.04), normalization="bound")
    value = phong(textured())
    assert value.normalization == "bound"
    assert value.fresnel.f0.item() == 0.04
    assert not list(phong.parameters())
    assert set(phong.state_dict()) == {"specular.raw", "exponent.raw", "fresnel.held_f0"}
    with pytest.raises(ValueError, match=r"Phong.exponent: the field starts outside: legal range \[0, inf\)"):
        tb.nn.Material(tb.Phong, specular=0.3, exponent=-1.0)
    assert tb.nn.Material(tb.Mirror, tint=0.5, fresnel=None)(textured()).fresnel is None


def test_a_light_is_a_material_too():
    light = tb.nn.Material(tb.PointLight, position=tb.nn.Learned([0.0, 0.0, 3.0]), intensity=tb.nn.Learned([5.0]))
    g = textured()
    image = tb.shade(g, tb.Lambert(0.5), light(g))
    image.sum().backward()
    assert all(p.grad.abs().sum() > 0 for p in light.parameters())


def test_a_network_answers_as_a_parameter():
    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = nn.Linear(3, 3)

        def forward(self, g):
            return torch.sigmoid(self.layer(g.position))

    g = textured()
    made = tb.nn.Material(tb.Lambert, albedo=Net())
    tb.shade(g, made(g), three_lights()).sum().backward()
    assert all(p.grad.abs().sum() > 0 for p in made.parameters())


WRONG = {
    "unknown": (lambda: tb.nn.Material(tb.Lambert, colour=0.5), TypeError, r"Material\(Lambert\): unknown parameter \['colour'\]; did you mean albedo \(fraction .*\)\? legal are \['albedo'\]"),
    "missing": (lambda: tb.nn.Material(tb.Phong, specular=0.5), TypeError, r"Material\(Phong\): missing parameter \['exponent'\]"),
    "start": (lambda: tb.nn.Material(tb.Dielectric, eta=tb.nn.Learned(0.0)), ValueError, r"Dielectric.eta: the field starts outside: legal range \(0, inf\)"),
    "size": (lambda: tb.nn.Material(tb.Phong, specular=0.5, exponent=tb.nn.Learned([1.0, 2.0]))(None), ValueError, r"Phong.exponent: expected shape \[..., 1\], found \[2\]"),
    "not called": (lambda: tb.shade(textured(), material(), three_lights()), TypeError, r"bsdf: expected a BSDF .*found MaterialSum; call the module"),
    "light not called": (lambda: tb.shade(textured(), tb.Lambert(0.5), [tb.nn.Material(tb.PointLight, position=[0.0, 0, 1], intensity=1.0)]), TypeError, r"lights\[0\]: expected a light .*found Material; call the module"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_materials(case):
    call, error, message = WRONG[case]
    with pytest.raises(error, match=message):
        call()


def test_a_shader_is_the_plan_of_its_material():
    made, g = shader()
    lights = three_lights()
    assert torch.equal(made(g, lights), tb.shade(g, made.material(g), lights))
    assert torch.equal(made(g, lights, per_light=True), tb.shade(g, made.material(g), lights, per_light=True))
    shadows = (torch.rand(3, 6, 6, 1) > 0.5).float()
    with pytest.raises(ValueError, match="visibility: this plan was made without shadows"):
        made(g, lights, visibility=shadows)
    shadowed = tb.nn.Shader(made.material, tb.plan(g, made.material(g), lights, visibility=shadows))
    assert torch.equal(shadowed(g, lights, visibility=shadows), tb.shade(g, made.material(g), lights, visibility=shadows))


def test_every_learned_parameter_gets_a_gradient():
    made, g = shader()
    made(g, three_lights()).square().sum().backward()
    assert len(list(made.parameters())) == 4
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in made.parameters())


def test_state_dict_round_trips_exactly(tmp_path):
    made, g = shader()
    other, _ = shader(exponent=90.0)
    lights = three_lights()
    assert not torch.equal(made(g, lights), other(g, lights))
    torch.save(made.state_dict(), tmp_path / "weights.pt")
    other.load_state_dict(torch.load(tmp_path / "weights.pt", weights_only=True))
    assert torch.equal(made(g, lights), other(g, lights))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))], ids=["deepcopy", "pickle"])
def test_copies_are_equal_and_independent(copied):
    made, g = shader()
    lights = three_lights()
    before = made(g, lights).detach()
    twin = copied(made)
    assert torch.equal(twin(g, lights), before)
    with torch.no_grad():
        for p in twin.parameters():
            p.add_(0.1)
    assert torch.equal(made(g, lights), before)
    assert not torch.equal(twin(g, lights), before)


def test_functional_call_and_a_stack_of_shaders():
    made = [shader(exponent)[0] for exponent in (5.0, 20.0, 80.0)]
    g, lights = textured(), three_lights()
    weights, buffers = torch.func.stack_module_state(made)
    images = torch.vmap(lambda w, b: torch.func.functional_call(made[0], (w, b), (g, lights)))(weights, buffers)
    for k, one in enumerate(made):
        torch.testing.assert_close(images[k], one(g, lights))

    def loss(w):
        return torch.func.functional_call(made[0], w, (g, lights)).square().sum()

    gradients = torch.vmap(torch.func.grad(loss))(weights)
    for k, one in enumerate(made):
        one(g, lights).square().sum().backward()
        for name, p in one.named_parameters():
            torch.testing.assert_close(gradients[name][k], p.grad)


@pytest.mark.slow
def test_a_shader_compiles_to_one_full_graph():
    if not torch_compat.has_cpp_compiler():
        pytest.skip("there is no C++ compiler")
    torch._dynamo.reset()
    made, g = shader()
    made.material.terms[0].albedo.srgb = True
    lights = three_lights()[:1]
    compiled = tb.compile(made)
    expected = made(g, lights)
    expected.square().sum().backward()
    wanted = [p.grad.clone() for p in made.parameters()]
    made.zero_grad()
    found = compiled(g, lights)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
    found.square().sum().backward()
    for p, w in zip(made.parameters(), wanted, strict=True):
        torch.testing.assert_close(p.grad, w, rtol=1e-3, atol=1e-4 * float(w.abs().max()))  # float32, other orders of summation


def half_of_the_job(rank, rendezvous, results, compiled):
    """One of two processes: its own half of the pixels."""
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", init_method=f"file://{rendezvous}", rank=rank, world_size=2)
    made, g = shader()
    company = nn.parallel.DistributedDataParallel(tb.compile(made) if compiled else made)
    for _ in range(2):  # DDP complains in the second step of a parameter that the first left without a gradient
        company.zero_grad()
        company(g[3 * rank : 3 * rank + 3], three_lights()).square().mean().backward()
    torch.save([p.grad for p in made.parameters()], f"{results}/{rank}.pt")
    torch.distributed.destroy_process_group()


@pytest.mark.slow  # starting two processes takes longer than all of the rest
@pytest.mark.parametrize("compiled", [False, True])
def test_two_processes_find_the_gradients_of_one(tmp_path, compiled):
    torch.multiprocessing.spawn(half_of_the_job, (tmp_path / "rendezvous", tmp_path, compiled), nprocs=2)
    made, g = shader()
    made(g, three_lights()).square().mean().backward()
    for rank in (0, 1):
        for p, found in zip(made.parameters(), torch.load(tmp_path / f"{rank}.pt"), strict=True):
            torch.testing.assert_close(found, p.grad, rtol=1e-4, atol=1e-6)


def test_a_leaf_or_a_parameter_is_used_as_it_is():
    leaf, parameter = torch.tensor([0.5, 0.4], requires_grad=True), torch.nn.Parameter(torch.tensor([0.3, 0.2]))
    material = tb.nn.Material(tb.Lambert, albedo=leaf) + tb.nn.Material(tb.Mirror, tint=parameter)
    assert [id(p) for p in material.parameters()] == [id(parameter)], "a Parameter is registered, a leaf stays its owner's"
    brdf = material(None)
    (brdf.terms[0].albedo.sum() + 2 * brdf.terms[1].tint.sum()).backward()
    assert leaf.grad.tolist() == [1.0, 1.0]
    assert parameter.grad.tolist() == [2.0, 2.0]
    assert tb.nn.Material(tb.Lambert, albedo=2 * leaf)(None).albedo.requires_grad, "so is what was computed"
    with pytest.raises(ValueError, match=r"Lambert.albedo: legal range \[0, 1\], found 1.5 .*clamp or re-parametrise"):
        tb.nn.Material(tb.Lambert, albedo=torch.tensor([1.5], requires_grad=True))


@pytest.mark.parametrize(
    "field", [tb.nn.Learned, tb.nn.Constant, lambda x: tb.nn.Texture(x.reshape(1, 1, 2)), lambda x: tb.nn.PerMaterial(x.reshape(1, 2))]
)
def test_a_start_that_requires_a_gradient_is_refused(field):
    """A field holds a copy, which would leave the leaf without its gradient and without a word."""
    leaf = torch.tensor([0.5, 0.4], requires_grad=True)
    with pytest.raises(
        TypeError, match=r"expected a start, found a tensor that requires a gradient.*pass x.detach\(\), or give x itself to tb.nn.Material"
    ):
        field(leaf)
    field(leaf.detach())


def test_values_that_a_material_holds_follow_it():
    f0 = torch.nn.Parameter(torch.tensor([0.04, 0.05, 0.06]))
    for term, learned in ((tb.Schlick([0.04, 0.05, 0.06]), 0), (tb.Schlick(f0), 1)):
        material = tb.nn.Material(tb.Phong, specular=0.5, exponent=tb.nn.Learned(20.0), fresnel=term, normalization="bound")
        assert len(list(material.parameters())) == 1 + learned
        assert {k: tuple(v.shape) for k, v in material.state_dict().items()} == {
            "specular.raw": (1,),
            "exponent.raw": (1,),
            "fresnel.held_f0": (3,),
        }
        brdf = material.double()(None)
        assert brdf.fresnel.f0.dtype == torch.float64
        assert brdf.fresnel.f0.requires_grad is bool(learned)
        assert brdf.normalization == "bound"
        other = tb.nn.Material(tb.Phong, specular=0.5, exponent=tb.nn.Learned(20.0), fresnel=tb.Schlick([0.1, 0.1, 0.1]))
        other.load_state_dict(material.state_dict())
        torch.testing.assert_close(other(None).fresnel.f0, torch.tensor([0.04, 0.05, 0.06], dtype=torch.float64))
    two = tb.nn.Material(tb.TwoSided, inside=tb.Lambert(0.5) + tb.Phong(0.1, 20.0))
    assert set(two.state_dict()) == {"inside.held_terms_0_albedo", "inside.held_terms_1_specular", "inside.held_terms_1_exponent"}
    torch.testing.assert_close(two(None).evaluate(UP, UP), tb.TwoSided(tb.Lambert(0.5) + tb.Phong(0.1, 20.0)).evaluate(UP, UP))


def test_parameters_of_a_lobe_that_nobody_lights_get_gradient_0():
    """A mirror under a point light is dark; DDP waits for the gradient of its tint all the same."""
    g = tb.GBuffer(torch.zeros(4, 4, 3), UP.expand(4, 4, 3), UP.expand(4, 4, 3))
    material = tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned(0.5)) + tb.nn.Material(tb.Mirror, tint=tb.nn.Learned([0.5, 0.5, 0.5]))
    sun = tb.DirectionalLight([0.0, 0.0, 1.0], 1.0)
    shader = tb.nn.Shader(material, tb.plan(g, material(g), sun))
    image = shader(g, sun)
    image.sum().backward()
    assert [bool(p.grad.any()) for p in shader.parameters()] == [True, False]
    torch.testing.assert_close(image, tb.shade(g, tb.Lambert(0.5), sun).expand_as(image))
    compiled = torch.compile(shader, fullgraph=True, backend="aot_eager")
    shader.zero_grad()
    compiled(g, sun).sum().backward()
    assert [bool(p.grad.any()) for p in shader.parameters()] == [True, False]
