"""The public names: nothing disappears, and nothing appears by accident."""

import inspect
import sys

import pytest
import torch

import torchbrdf as tb
from torchbrdf import synonyms
from torchbrdf.interval import UNIT
from torchbrdf.registry import BSDFS, DISTRIBUTIONS, FRESNEL_TERMS, registered
from torchbrdf.value import SCALAR, VALUES, param, value

PUBLIC = """
BSDFSample BlinnPhong Bsdf Camera Conductor Constraint Contribution Decision Dielectric DirectionalLight Distribution Effect
EnvironmentMap Frame Fresnel GBuffer Geometry Interval Lambert Layout Light LightKind LightSample Lobe Mesh Mirror Phong Plan PointLight
Prepared Scaled Scene Schlick Sum Surface TwoSided Value Viewer alpha_from_exponent alpha_from_roughness bilinear compile
exponent_from_alpha fresnel is_planar load_mesh load_value microfacet nn normalize param plan planar read_image reflect refract
roughness_from_alpha save_image shade stack testing validate value_and_grad visibility
""".split()  # noqa: SIM905 - a list that can be read


def test_all_is_as_written_down():
    """The models of the registry beside it: a new one is meant as it stands there, and an old one must not go."""
    assert set(PUBLIC) <= set(tb.__all__)
    assert set(tb.__all__) - set(PUBLIC) <= {*BSDFS, *FRESNEL_TERMS, *DISTRIBUTIONS}
    assert tb.__all__ == sorted(tb.__all__)


@pytest.mark.parametrize("name", PUBLIC)
def test_name_resolves(name):
    assert getattr(tb, name) is not None
    assert name in dir(tb)


def test_unknown_name():
    with pytest.raises(AttributeError, match="no attribute 'lambert'"):
        _ = tb.lambert


NAMES = {
    "Ggx": r"did you mean tb.GGX\?",
    "Disney": r"not in this version; compose it: tb.Lambert\(albedo\) \+ tb.RoughConductor",
    "Pinhole": r"did you mean tb.Camera\?",
    "Texture": r"did you mean tb.nn.Texture\?",
    "schlick": r"did you mean tb.fresnel.schlick\?",
    "ggx_d": r"did you mean tb.microfacet.ggx_d\?",
    "lambert": r"did you mean tb.Lambert\?",
    "BlinnPong": r"did you mean tb.BlinnPhong\?",
    "render": r"did you mean tb.shade\?",
}


@pytest.mark.parametrize("name", NAMES)
def test_unknown_names_say_what_may_be_meant(name):
    with pytest.raises(AttributeError, match=f"module 'torchbrdf' has no attribute '{name}'; {NAMES[name]}"):
        getattr(tb, name)


def test_unknown_names_without_a_guess():
    for name in ("zzzzzz", "__wrapped__", "_Lambert"):
        with pytest.raises(AttributeError, match=f"^module 'torchbrdf' has no attribute '{name}'$"):
            getattr(tb, name)


def test_a_traceback_guesses_once(capsys):
    with pytest.raises(AttributeError) as caught:
        _ = tb.BlinnPong
    sys.__excepthook__(caught.type, caught.value, None)  # Python's own guess stands in what it prints alone
    assert capsys.readouterr().err.count("BlinnPhong") == 1


def test_every_name_that_a_hint_gives_is_there():
    for meant in {m for m in synonyms.NAMES.values() if " " not in m}:
        assert getattr(tb, meant) is not None
    fields = {name for cls in VALUES.values() for name in cls._fields} | {"alpha"}  # that of microfacet models to come
    assert {meant for several in synonyms.ARGUMENTS.values() for meant in several} <= fields
    assert not set(synonyms.NAMES) & set(tb.__all__)


@value
class Own(tb.Value):
    depth: torch.Tensor = param(UNIT, SCALAR, "how deep")
    note: str = ""


ARGUMENTS = {
    "Phong(roughness=)": (lambda: tb.Phong(0.5, roughness=0.3), r"Phong: unknown argument 'roughness'; did you mean exponent \(s; another scale: see Roughness.*\)\? legal are specular, exponent, fresnel, normalization"),
    "Phong(shininess=)": (lambda: tb.Phong(0.5, shininess=3.0), r"did you mean exponent \(s\)\?"),
    "Phong(ks=)": (lambda: tb.Phong(ks=0.5, exponent=3.0), r"did you mean specular \(strength k\)\?"),
    "Lambert(Kd=)": (lambda: tb.Lambert(Kd=0.5), r"Lambert: unknown argument 'Kd'; did you mean albedo"),
    "Lambert(color=)": (lambda: tb.Lambert(color=0.5), r"did you mean albedo"),
    "Mirror(color=)": (lambda: tb.Mirror(color=0.5), r"did you mean tint"),
    "Lambert(albdeo=)": (lambda: tb.Lambert(albdeo=0.5), r"did you mean albedo"),
    "Dielectric(ior=)": (lambda: tb.Dielectric(ior=1.5), r"did you mean eta \(index of refraction, inside over outside\)"),
    "DirectionalLight(intensity=)": (lambda: tb.DirectionalLight([0, 0, 1], intensity=3.0), r"DirectionalLight: unknown argument 'intensity'; did you mean irradiance \(on a plane facing the light, W/m\^2\)"),
    "PointLight(irradiance=)": (lambda: tb.PointLight([0, 0, 1], irradiance=3.0), r"did you mean intensity \(radiant intensity, W/sr\)"),
    "GBuffer(normals=)": (lambda: tb.GBuffer(torch.zeros(3), normals=torch.zeros(3)), r"did you mean normal "),
    "replace": (lambda: tb.Lambert(0.5).replace(color=0.5), r"Lambert: unknown argument 'color'; did you mean albedo"),
    "a user's own": (lambda: Own(deep=0.5), r"Own: unknown argument 'deep'; did you mean depth \(how deep\)\? legal are depth, note"),
    "without a guess": (lambda: Own(0.5, zzz=0.5), r"Own: unknown argument 'zzz'; legal are depth, note$"),
    "Material": (lambda: tb.nn.Material(tb.Phong, specular=0.5, roughness=0.3), r"Material\(Phong\): unknown parameter \['roughness'\]; did you mean exponent"),
}  # fmt: skip


@pytest.mark.parametrize("case", ARGUMENTS)
def test_unknown_arguments_say_what_may_be_meant(case):
    call, message = ARGUMENTS[case]
    with pytest.raises(TypeError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_values_are_made_as_before():
    assert list(inspect.signature(tb.Phong).parameters) == ["specular", "exponent", "fresnel", "normalization"]
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'exponent'"):
        tb.Phong(0.5)
    with pytest.raises(TypeError, match="positional arguments but"):
        tb.Lambert(0.5, 0.5)
    with pytest.raises(TypeError, match="multiple values for argument 'albedo'"):
        tb.Lambert(0.5, albedo=0.5)


def test_a_value_with_an_init_of_its_own_keeps_it():
    @value
    class Twice(tb.Value):
        depth: torch.Tensor = param(UNIT, SCALAR, "how deep")

        def __init__(self, half):
            object.__setattr__(self, "depth", torch.tensor([2.0 * half]))

    assert Twice(half=0.25).depth == 0.5


def test_values_are_made_inside_one_full_graph():
    torch.compiler.reset()

    def one(x):
        return (
            Own(depth=x, note="n").depth
            + tb.PointLight(position=x.expand(2, 3), intensity=1.0).sample(x.expand(3)).radiance.sum() * tb.Lambert(albedo=x).albedo
        )

    x = torch.tensor([0.5])
    torch.testing.assert_close(torch.compile(one, fullgraph=True, backend="eager")(x), one(x))


def test_no_verb_bears_a_parameter_name():
    verbs = {"evaluate", "pdf", "sample", "directional_albedo", "reflectance", "lobes", "reciprocal", "energy_bound"}
    for cls in (*registered(BSDFS), *registered(FRESNEL_TERMS)):
        assert not verbs & set(cls._fields)
        assert cls.__doc__
        assert all(spec.doc for spec in cls._params.values())
