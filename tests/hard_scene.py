"""A G-buffer of everything that goes wrong, by hand and from a damaged mesh, with lights to match."""

import itertools
import math

import torch
import trimesh

import torchbrdf as tb

NAN, INF = math.nan, math.inf
LARGEST = torch.finfo(torch.float32).max  # what renderers write where they hit nothing
DENORMAL = 2.0**-140
GRAZING = (2.0**-20, 2.0**-60, 2.0**-100, DENORMAL)  # cosines; the square of the third vanishes in float32
USUAL = {"position": (0.1, -0.2, 0.3), "normal": (0.1, 0.2, 0.9), "view": (-0.3, 0.2, 0.8), "uv": (0.4, 0.7), "tangent": (1.0, 0.2, 0.0)}

NORMALS = [(0, 0, 0), (NAN, 0, 1), (0, NAN, NAN), (INF, 0, 1), (-INF, INF, 1), (0, 0, -1), (0, 0, DENORMAL), (0, 0, 1e-30), (1e30, 1e30, 1e30), (0, 0, 7), (0, LARGEST, 0)]  # fmt: skip
VIEWS = [(0, 0, 0), (NAN, 0, 1), (0, 0, INF), (0, 0, DENORMAL), (0, 0, 1e-30), (3e30, 0, 1e30), (0, 0, -1)]
SILHOUETTES = [{"normal": (0, 0, 1), "view": (1, 0, c * s)} for c, s in itertools.product((0.0, *GRAZING), (1, -1))] + [
    {"normal": (0, 0, 1), "view": (0.6, -0.8, c)} for c in GRAZING
]
POSITIONS = [(NAN, 0, 0), (INF, -INF, 0), (LARGEST, 0, 0), (-LARGEST, LARGEST, 1e38), (1e30, 0, 0), (DENORMAL, 0, 0), (0, 0, 0)]
UVS = [(NAN, 0.5), (INF, -INF), (1e30, -1e30), (LARGEST, 0), (0, 0), (1, 1), (-7.25, 3.5)]
TANGENTS = [(0, 0, 0), (NAN, 1, 0), (INF, 0, 0), (0.1, 0.2, 0.9)]

LIGHT = (0.4, 0.3, 2.0)
ALMOST = (0.0, 0.0, 2.0**-20)  # from the origin, where some points are


def rows():
    """One dictionary per point: the usual one, with one thing or two wrong."""
    yield {}
    for name, values in (("normal", NORMALS), ("view", VIEWS), ("position", POSITIONS), ("uv", UVS), ("tangent", TANGENTS)):
        yield from ({name: v} for v in values)
    yield from SILHOUETTES
    yield from ({"normal": n, "view": v} for n, v in itertools.product(NORMALS, VIEWS))
    # The light above, in, a little above and below, and behind the horizon; facing its mirror image, itself, and away.
    towards = tb.normalize(torch.tensor(LIGHT, dtype=torch.float64) - torch.tensor(USUAL["position"], dtype=torch.float64))
    frame = tb.Frame.from_normal(towards)
    for c in (1.0, 0.3, 0.0, *GRAZING, *(-c for c in GRAZING), -0.4, -1.0):
        n = c * towards + math.sqrt(1 - c * c) * frame.tangent
        for view in (towards, -towards, tb.reflect(towards, n), frame.tangent, frame.bitangent, n):
            yield {"normal": tuple(n.tolist()), "view": tuple(view.tolist())}
    yield from ({"position": p, "normal": n, "view": (0.2, 0.1, 1)} for p in (LIGHT, ALMOST, (0, 0, 0)) for n in ((0, 0, 1), (1, 0, 0), (0, 0, -1)))  # fmt: skip


def by_hand(dtype):
    """``g [N]``: every point twice, in the second half masked out."""
    found = list(rows())
    fields = {
        name: torch.tensor([row.get(name, usual) for row in found] * 2, dtype=torch.float64).to(dtype) for name, usual in USUAL.items()
    }
    mask = torch.tensor([[True]] * len(found) + [[False]] * len(found))
    return tb.GBuffer(**fields, mask=mask)


def damaged_mesh(dtype):
    """A ball with uv whose faces partly collapse to edges and points, some of its normals zero or not finite."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = torch.tensor(ball.vertices, dtype=dtype), torch.tensor(ball.faces)
    normals = vertices.clone()
    normals[::7] = 0.0
    normals[1::11] = NAN
    normals[2::13] = INF
    normals[3::17] *= 1e-30
    vertices[5::19] = vertices[6::19][: len(vertices[5::19])]  # two corners become one
    faces = torch.cat([faces, faces[:9].flip(-1), faces[:5, [0, 0, 1]], faces[:5, [2, 2, 2]]])
    return tb.Mesh(vertices, faces, normals=normals, uv=vertices[:, :2].clone())


def from_mesh(dtype, size=24):
    """What a camera sees of it, its edge and the background included, one view from the inside."""
    eyes = torch.tensor([[0.3, 0.4, 3.0], [0.0, 0.0, 0.0]])
    camera = tb.Camera.look_at(eyes, torch.tensor([0.1, 0.0, -0.2]), torch.tensor([0.0, 1.0, 0.1]), 45.0, (size, size))
    return tb.GBuffer.from_mesh(damaged_mesh(dtype), camera)


def lights(dtype, dazzling=1e30):
    """Usual, almost touching, dazzling, nearer than the falloff has numbers for, strong, none, in the horizon, and from below."""
    positions = [LIGHT, ALMOST, LIGHT, (0.0, 0.0, 2.0**-90)]
    point = tb.PointLight(positions, [[8.0, 4.0, 1.0], [1e-6] * 3, [dazzling, 1.0, 1e-30], [0.0, 1e-30, 1e-30]])
    sun = tb.DirectionalLight([[0.3, 0.2, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1e-30]], [[1e6] * 3, [1.0] * 3, [2.0] * 3, [1.0, 0.0, 1e-38]])  # fmt: skip
    return [point.to(dtype), sun.to(dtype)]


def sky(dtype, dazzling=1e30):
    """A dazzling sun beside darkness."""
    texels = torch.linspace(0.0, 1.0, 4 * 8 * 3, dtype=torch.float64).reshape(4, 8, 3)
    texels[1, 2], texels[0, 5], texels[3, 3] = dazzling, 0.0, 1e-38
    return tb.EnvironmentMap(texels.to(dtype))
