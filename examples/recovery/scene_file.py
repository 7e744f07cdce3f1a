"""Scene files: a user's own mesh, views, photographs and lights, in JSON. The format is described in docs/recover.md."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchbrdf as tb

from .entry import Entry, read
from .problem import Lights, Problem, View

BORDER = 2  # pixels on each side of a 5x5 neighbourhood
PARAMETERS = ("albedo", "specular", "exponent", "eta", "alpha", "f0")
LIGHTS: dict[str, tuple[type[tb.Light], dict[str, int | None]]] = {
    "point": (tb.PointLight, {"position": 3, "intensity": None}),
    "directional": (tb.DirectionalLight, {"direction": 3, "irradiance": None}),
}


def load(path: Path, name: str, shadow: str = "auto") -> Problem:
    """Read a scene file and the images called ``name`` in it, and decide which pixels count.

    With shadows, a pixel counts for a light if its 5x5 neighbourhood lies in the mask and is wholly lit; with
    ``shadow="off"`` every pixel of the mask counts for every light. What is wrong with the file is one ``ValueError`` (of a file
    that is missing, ``FileNotFoundError``) that says where.
    """
    scene = read(path)
    mesh = tb.load_mesh(scene.file(scene.get("mesh", str), "mesh")).to(torch.float64)
    lights = Lights(*(_light(entry, k, scene) for k, entry in enumerate(scene.get("lights", list))))
    views = [Entry(v, f"{path}: views[{k}]", path.parent) for k, v in enumerate(scene.get("views", list))] if "views" in scene else [scene]
    if not lights.entries or not views:
        raise ValueError(f"{path}: {'views' if lights.entries else 'lights'}: found none; give one at least")
    truth = _truth(scene.entry("materials"), name) if "materials" in scene else {}
    start = {"albedo": 0.5, "specular": 0.5, "exponent": 20.0, "eta": 1.3, "alpha": 0.6, "f0": 0.5}
    return Problem([_view(view, name, mesh, lights, shadow) for view in views], lights, truth, start)


def _truth(materials: Entry, name: str) -> dict[str, Tensor]:
    if name not in materials:
        return {}
    material = materials.entry(name)
    truth = {k: material.numbers(k) for k in PARAMETERS if k in material}
    if "k" in material and "eta" in truth:  # the index of a metal, of which only the colour can be recovered
        truth["f0"] = tb.fresnel.conductor(torch.ones(1, dtype=torch.float64), truth.pop("eta"), material.numbers("k"))
    return truth


def _light(given: Any, k: int, scene: Entry) -> Any:
    """``[x, y, z]``, or a dictionary with ``type``, its parameters, and ``learn``: the names of those to be learned."""
    if isinstance(given, list):
        given = {"type": "point", "position": given, "intensity": scene.found.get("intensity")}
    entry = Entry(given, f"{scene.where}: lights[{k}]", scene.folder)
    named = entry.get("type", str) if "type" in entry else "point"
    if named not in LIGHTS:
        raise ValueError(f"{scene.where}: lights: unknown type {named!r}; legal are {sorted(LIGHTS)}")
    kind, sizes = LIGHTS[named]
    values = {n: entry.numbers(n, *() if size is None else (size,)).reshape(-1) for n, size in sizes.items()}
    learned = entry.texts("learn") if "learn" in entry else []
    if set(learned) - set(values):
        raise ValueError(f"{entry.where}: learn: found {learned}, legal are {sorted(values)}")
    try:
        light = kind(**values)
        tb.validate(light)
        if not learned:
            return light
        return tb.nn.Material(kind, **{n: tb.nn.Learned(v) if n in learned else tb.nn.Constant(v) for n, v in values.items()})
    except ValueError as error:
        raise entry.wrong(error) from None


def _camera(view: Entry) -> tb.Camera:
    size = view.numbers("size", 2).tolist() if "size" in view else [view.get("res", float)] * 2
    try:
        if "K" in view:
            convention = view.get("convention", str) if "convention" in view else "opencv"
            return tb.Camera.from_matrix(view.numbers("K", 3, 3), view.numbers("world_to_camera"), tuple(size), convention=convention)
        eye, target, up = (view.numbers(n, 3) for n in ("eye", "target", "up"))
        return tb.Camera.look_at(eye, target, up, fov_y=view.get("fov_y_deg", float), size=tuple(size))
    except ValueError as error:
        raise view.wrong(error) from None


def _view(view: Entry, name: str, mesh: tb.Mesh, lights: Lights, shadow: str) -> View:
    several = isinstance(view.found.get("images"), dict)
    files = view.entry("images").texts(name) if several else view.texts("images")
    if len(files) != len(lights.entries):
        raise ValueError(
            f"{view.where}: images: {len(files)} in a view of a scene with {len(lights.entries)} lights; "
            "give one image per light, in their order"
        )
    camera = _camera(view)
    images, unsaturated = zip(*(_photograph(view.file(f, "images")) for f in files), strict=True)
    for file, image in zip(files, images, strict=True):
        _check_picture(view, file, image, camera, images[0].shape[-1])
    g = tb.GBuffer.from_mesh(mesh, camera.to(torch.float64))  # of a size that there are pictures of: a file may make one up
    mask = g.valid
    if "mask" in view:
        file = view.get("mask", str)
        painted = tb.read_image(view.file(file, "mask"), srgb=False)[..., :1]
        _check_picture(view, file, painted, camera, 1)
        mask = mask & (painted > 0.5)
    weights = mask & torch.stack(unsaturated)
    visibility = None
    if shadow != "off":
        known = lights(g)
        visibility = tb.visibility(g, known, mesh)
        weights = weights & eroded(mask) & eroded((visibility > 0) & _faces_light(g, known))
    return View(g, torch.stack(images), weights, visibility)


def _check_picture(view: Entry, file: str, image: Tensor, camera: tb.Camera, channels: int) -> None:
    expected = [*camera.size, channels]
    if list(image.shape) != expected:
        raise ValueError(f"{view.where}: {file}: expected {expected} (height, width, channels), found {list(image.shape)}")


def _photograph(path: Path) -> tuple[Tensor, Tensor]:
    """Linear radiance [H, W, 3] in float64 and where it is not saturated (only 8-bit files can be, at 1)."""
    image = tb.read_image(path)[..., :3].to(torch.float64)
    limited = path.suffix.lower() not in (".exr", ".hdr")
    return image, (image < 1).all(-1, keepdim=True) if limited else torch.ones_like(image[..., :1], dtype=torch.bool)


def _faces_light(g: tb.GBuffer, lights: list[tb.Light]) -> Tensor:
    """Where the shading normal faces each light, [L, H, W, 1]."""
    wi = torch.cat([light.sample(g.position).wi for light in lights])
    return (wi * g.normal).sum(-1, keepdim=True) > 0


def eroded(mask: Tensor) -> Tensor:
    """Where the whole 5x5 neighbourhood of ``mask [..., H, W, 1]`` is set."""
    from kornia.morphology import erosion

    flat = mask.squeeze(-1).reshape(-1, 1, *mask.shape[-3:-1]).to(torch.float32)
    kept = erosion(flat, torch.ones(2 * BORDER + 1, 2 * BORDER + 1), border_type="constant", border_value=0.0)
    return (kept > 0).reshape(mask.shape)
