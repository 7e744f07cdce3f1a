"""Scene files: a user's own mesh, views, photographs and lights, in JSON. The format is described in docs/recover.md."""

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchbrdf as tb

from .problem import Lights, Problem, View

BORDER = 2  # pixels on each side of a 5x5 neighbourhood


def load(path: Path, name: str, shadow: str = "auto") -> Problem:
    """Read a scene file and the images called ``name`` in it, and decide which pixels count.

    With shadows, a pixel counts for a light if its 5x5 neighbourhood lies in the mask and is wholly lit; with
    ``shadow="off"`` every pixel of the mask counts for every light.
    """
    if not path.is_file():
        raise FileNotFoundError(f"--scene: no such file: {path}")
    scene = json.loads(path.read_text())
    folder = path.parent
    mesh = tb.load_mesh(folder / scene["mesh"]).to(torch.float64)
    lights = Lights(*(_light(entry, scene) for entry in scene["lights"]))
    views = [_view(entry, scene, folder, name, mesh, lights, shadow) for entry in scene.get("views", [scene])]
    material = scene.get("materials", {}).get(name, {})
    truth = {k: torch.tensor(v, dtype=torch.float64) for k, v in material.items() if k in ("albedo", "specular", "exponent", "eta")}
    return Problem(views, lights, truth, {"albedo": 0.5, "specular": 0.5, "exponent": 20.0, "eta": 1.3})


def _light(entry: Any, scene: dict[str, Any]) -> Any:
    """``[x, y, z]``, or a dictionary with ``type``, its parameters, and ``learn``: the names of those to be learned."""
    if isinstance(entry, list):
        entry = {"type": "point", "position": entry, "intensity": scene["intensity"]}
    kinds = {"point": (tb.PointLight, ("position", "intensity")), "directional": (tb.DirectionalLight, ("direction", "irradiance"))}
    if entry.get("type", "point") not in kinds:
        raise ValueError(f"lights: unknown type {entry['type']!r}; legal are {sorted(kinds)}")
    kind, names = kinds[entry.get("type", "point")]
    values = {n: torch.tensor(entry[n], dtype=torch.float64).reshape(-1) for n in names}
    learned = entry.get("learn", [])
    if not learned:
        return kind(**values)
    return tb.nn.Material(kind, **{n: tb.nn.Learned(v) if n in learned else tb.nn.Constant(v) for n, v in values.items()})


def _camera(view: dict[str, Any]) -> tb.Camera:
    if "K" in view:
        return tb.Camera.from_matrix(view["K"], view["world_to_camera"], tuple(view["size"]), convention=view.get("convention", "opencv"))
    size = view["size"] if "size" in view else [view["res"]] * 2
    return tb.Camera.look_at(view["eye"], view["target"], view["up"], fov_y=view["fov_y_deg"], size=tuple(size))


def _view(view: dict[str, Any], scene: dict[str, Any], folder: Path, name: str, mesh: tb.Mesh, lights: Lights, shadow: str) -> View:
    g = tb.GBuffer.from_mesh(mesh, _camera(view).to(torch.float64))
    files = view["images"][name] if isinstance(view["images"], dict) else view["images"]
    images, unsaturated = zip(*(_photograph(folder / f) for f in files), strict=True)
    known = lights(g)
    if len(images) != len(known):
        raise ValueError(f"images: {len(images)} in a view of a scene with {len(known)} lights; give one image per light, in their order")
    mask = g.valid
    if "mask" in view:
        mask = mask & (tb.read_image(folder / view["mask"], srgb=False)[..., :1] > 0.5)
    weights = mask & torch.stack(unsaturated)
    visibility = None
    if shadow != "off":
        visibility = tb.visibility(g, known, mesh)
        weights = weights & eroded(mask) & eroded((visibility > 0) & _faces_light(g, known))
    return View(g, torch.stack(images), weights, visibility)


def _photograph(path: Path) -> tuple[Tensor, Tensor]:
    """Linear radiance [H, W, 3] in float64 and where it is not saturated (only 8-bit files can be, at 1)."""
    image = tb.read_image(path)[..., :3].to(torch.float64)
    limited = path.suffix.lower() not in (".exr", ".hdr")
    return image, (image < 1).all(-1, keepdim=True) if limited else torch.ones_like(image[..., :1], dtype=torch.bool)


def _faces_light(g: tb.GBuffer, lights: list[tb.Light]) -> Tensor:
    """Where the shading normal faces each light, [L, H, W, 1]."""
    wi = torch.cat([light.incident(g.position)[0] for light in lights])
    return (wi * g.normal).sum(-1, keepdim=True) > 0


def eroded(mask: Tensor) -> Tensor:
    """Where the whole 5x5 neighbourhood of ``mask [..., H, W, 1]`` is set."""
    from kornia.morphology import erosion

    flat = mask.squeeze(-1).reshape(-1, 1, *mask.shape[-3:-1]).to(torch.float32)
    kept = erosion(flat, torch.ones(2 * BORDER + 1, 2 * BORDER + 1), border_type="constant", border_value=0.0)
    return (kept > 0).reshape(mask.shape)
