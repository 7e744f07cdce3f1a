"""The public names: nothing disappears, and nothing appears by accident."""

import pytest

import torchbrdf as tb
from torchbrdf.registry import BSDFS, FRESNEL_TERMS, registered

PUBLIC = """
BSDFSample BlinnPhong Bsdf Camera Conductor Constraint Contribution Decision Dielectric DirectionalLight Effect EnvironmentMap Frame
Fresnel GBuffer Geometry Interval Lambert Layout Light LightKind LightSample Lobe Mesh Mirror Phong Plan PointLight Prepared Scaled
Scene Schlick Sum Surface TwoSided Value Viewer bilinear compile fresnel is_planar load_mesh load_value microfacet nn normalize param
plan planar read_image reflect refract save_image shade stack testing validate value_and_grad visibility
""".split()  # noqa: SIM905 - a list that can be read


def test_all_is_as_written_down():
    """The models of the registry beside it: a new one is meant as it stands there, and an old one must not go."""
    assert set(PUBLIC) <= set(tb.__all__)
    assert set(tb.__all__) - set(PUBLIC) <= {*BSDFS, *FRESNEL_TERMS}
    assert tb.__all__ == sorted(tb.__all__)


@pytest.mark.parametrize("name", PUBLIC)
def test_name_resolves(name):
    assert getattr(tb, name) is not None
    assert name in dir(tb)


def test_unknown_name():
    with pytest.raises(AttributeError, match="no attribute 'lambert'"):
        _ = tb.lambert


def test_no_verb_bears_a_parameter_name():
    verbs = {"evaluate", "pdf", "sample", "directional_albedo", "reflectance", "lobes", "reciprocal", "energy_bound"}
    for cls in (*registered(BSDFS), *registered(FRESNEL_TERMS)):
        assert not verbs & set(cls._fields)
        assert cls.__doc__
        assert all(spec.doc for spec in cls._params.values())
