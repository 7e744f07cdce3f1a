"""G-buffers in EXR files: our own, Mitsuba's AOVs, Blender's passes. What a file leaves open is assumed aloud, in one line.

Our own files are one part of float32 channels: ``position.X/.Y/.Z``, ``normal``, ``view``, ``geometric_normal``, ``tangent`` and
``barycentric`` alike, ``uv.U/.V``, ``depth.T`` (distance along the ray, named as Mitsuba does), ``mask``, ``triangle``, ``material``,
``handedness``.

==================  ====================================================  =========================================================
file                layers                                                what is done with them
==================  ====================================================  =========================================================
Mitsuba 3           the user's prefix + .X/.Y/.Z, .U/.V, .T, .I           every pass is an average over the pixel: where its normal is
                                                                          shorter than 0.95 the pixel blends surfaces and is masked
                                                                          out; v counts from the top row and is turned upwards
Blender 5           one part a pass, with or without the view layer       depth is planar and 1e10 in the background; normals are
Blender up to 4.5   one part, ``ViewLayer.Normal.X``                      averages (position and depth are not)
==================  ====================================================  =========================================================

Mitsuba counts depth from the near clipping plane (0.01 by default), so where a camera and positions are known, depth is the
distance between them. Without positions they are made from depth and the camera's rays (a near_clip
too close if the depth is Mitsuba's).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .. import arguments, vector
from ..io.exr import read_exr, write_exr
from .camera import Camera
from .gbuffer import GBuffer
from .passes import Pass, check_fields, group, is_blender, recognise

FAR = 1e9  # Blender writes 1e10 where there is no surface
WHOLE = 0.95  # length of an averaged normal from which a pixel counts as one surface
_CHANNELS = {
    **dict.fromkeys(("position", "normal", "view", "geometric_normal", "tangent", "barycentric"), "XYZ"),
    **{"uv": "UV", "depth": "T", "mask": "", "triangle": "", "material": "", "handedness": ""},
}
_OURS = {"mask", *(f"{field}.{c}" for field in ("position", "normal") for c in "XYZ")}  # a file with these is one of our own
_LARGEST_ID = 1 << 24  # float32 holds every whole number up to here
_NO_ID = {"triangle": -1, "material": 0}  # where there is no surface; the least id there is


def save_gbuffer(g: GBuffer, path: str | Path) -> None:
    """Write a G-buffer ``[H, W]`` as float32 (ids up to 2^24). A missing mask is written as ``g.valid``."""
    g = g.replace(mask=g.valid)
    if len(g.batch_shape) != 2:
        raise ValueError(f"save: {path}: expected a G-buffer [H, W], found {list(g.batch_shape)}; index it and save one view a file")
    for field in _NO_ID:
        ids = getattr(g, field)
        if ids is not None and int(ids.abs().max()) > _LARGEST_ID:
            raise ValueError(
                f"save: {path}: {field} holds ids beyond {_LARGEST_ID}, which float32 cannot tell apart; save it with Value.save"
            )
    channels: dict[str, Tensor] = {}
    for field, tensor, _ in g.own_tensors():
        parts = tensor.expand(*g.batch_shape, tensor.shape[-1]).unbind(-1)
        channels |= {_name(field, c): p for c, p in zip(_CHANNELS[field] or " ", parts, strict=True)}
    write_exr(path, channels)


def load_gbuffer(path: str | Path, camera: Camera | None = None, names: Mapping[str, str] | None = None) -> GBuffer:
    """Read a G-buffer ``[H, W]`` of float32, and print in one line what was assumed.

    ``camera`` gives ``view``, depth along the ray, and positions where the file has none; without it ``view`` is None unless
    stored. ``names`` says which layer is which field, as in ``{"position": "P"}``. A file without normals, or without
    positions and the means to make them, a camera of another size and an ambiguous name are each one ``ValueError``.
    """
    if camera is not None:
        arguments.of_kind(camera, "camera", Camera, "tb.Camera.look_at(eye, target, up)")
    if not (names is None or isinstance(names, Mapping)):
        raise TypeError(f"names: expected a dictionary such as {{'position': 'P'}}, found {type(names).__name__}")
    layers = read_exr(path)
    groups = group(layers)
    flat = layers.get("", {})
    try:
        if set(flat) >= _OURS:  # the file's own channels say whose it is, not what the caller says about them
            fields, notes = _own(flat, names or {}), ["own G-buffer"]
            _add_view(fields, camera, notes)
        else:
            fields, notes = _foreign(recognise(groups, names), camera, is_blender(groups))
    except ValueError as error:
        raise ValueError(f"load: {path}: {error}; the file has layers {sorted(groups)}") from None
    print(f"{Path(path).name}: {'; '.join(notes)}")
    return GBuffer(**fields)


def _name(field: str, letter: str) -> str:
    return f"{field}.{letter}" if letter.strip() else field


def _own(flat: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Tensor]:
    """The fields of one of our own files; ``names`` (field -> layer) may have one read from another's channels."""
    check_fields(names, _CHANNELS)
    fields = {}
    for field, letters in _CHANNELS.items():
        channels = [_name(names.get(field, field), c) for c in letters or " "]
        if all(c in flat for c in channels):
            fields[field] = _typed(field, vector.stack([torch.from_numpy(flat[c]) for c in channels]))
        elif field in names:
            raise ValueError(f"names: no channels {channels} for the {field}")
    return fields


def _typed(field: str, x: Tensor) -> Tensor:
    return x > 0 if field == "mask" else _ids(field, x) if field in _NO_ID else x


def _foreign(passes: Mapping[str, Pass], camera: Camera | None, blender: bool) -> tuple[dict[str, Tensor], list[str]]:
    """Fields from another renderer's passes, and what was assumed on the way."""
    if "normal" not in passes:
        raise ValueError("no layer looks like normals; say which with names={'normal': ...}")
    notes = [f"{'Blender passes' if blender else 'Mitsuba AOVs'}: {', '.join(f'{f}<-{p.layer}' for f, p in passes.items())}"]
    fields = {f: p.pixels for f, p in passes.items()}
    mask = _mask(fields, passes, notes)
    for field in ("normal", "geometric_normal", "tangent"):
        if field in fields:
            fields[field] = _unit(fields[field], mask, field, notes)
    if "uv" in fields and not blender:
        u, v = fields["uv"].unbind(-1)
        fields["uv"] = vector.stack([u, 1.0 - v])
        notes.append("v turned upwards")
    _place(fields, passes, camera, notes)
    ids = {f: torch.where(mask, _ids(f, fields[f]), none) for f, none in _NO_ID.items() if f in fields}
    fields = {f: torch.where(mask, x, 0.0) for f, x in fields.items()} | ids
    fields["mask"] = mask
    _add_view(fields, camera, notes)
    return fields, notes


def _mask(fields: Mapping[str, Tensor], passes: Mapping[str, Pass], notes: list[str]) -> Tensor:
    """Where all passes agree that there is one surface, ``[H, W, 1]``."""
    length = _length(fields["normal"])
    planar = "depth" in passes and passes["depth"].letters != "T"
    tests = {"normals": length > (0.0 if planar else WHOLE)}
    if "depth" in fields:
        tests["depth"] = (fields["depth"] > 0) & (fields["depth"] < FAR)
    if "triangle" in fields:
        tests["id >= 0"] = fields["triangle"] >= 0
    mask = torch.isfinite(length)
    for test in tests.values():
        mask = mask & test
    if "position" in fields:
        mask = mask & torch.isfinite(fields["position"]).all(-1, keepdim=True)
    blended = int(((length > 0) & (length <= WHOLE)).sum()) if not planar else 0
    left_out = f", leaving out {blended} pixels that blend surfaces" if blended else ""
    notes.append(f"mask from {' and '.join(tests)}{left_out}")
    return mask


def _length(v: Tensor) -> Tensor:
    return vector.direction_and_length(vector.components(v))[1].unsqueeze(-1)


def _unit(v: Tensor, mask: Tensor, field: str, notes: list[str]) -> Tensor:
    """Averaged directions renormalised; those that are unit up to the accuracy of a stored float stay as they are, bit for bit."""
    stretch = torch.where(mask, (_length(v) - 1.0).abs(), 0.0)
    averaged = bool((stretch > 8 * torch.finfo(v.dtype).eps).any())
    notes.append(f"{field}s {'averaged, renormalised' if averaged else 'as given'}")
    return vector.normalize(v) if averaged else v


def _place(fields: dict[str, Tensor], passes: Mapping[str, Pass], camera: Camera | None, notes: list[str]) -> None:
    """Bring position and depth into agreement: depth is the distance from the camera along the ray."""
    planar = "depth" in passes and passes["depth"].letters != "T"
    if camera is not None:
        origin, direction, cosine = _rays(camera, fields["normal"].shape[:2])
        if "position" in fields:
            notes.append("depth = distance from the camera to the position")
        elif "depth" in fields:
            along = fields["depth"].double() / (cosine if planar else 1.0)
            fields["position"] = (origin + direction * along).float()
            what = "planar depth" if planar else "depth along the ray, as if counted from the camera"
            notes.append(f"position from {what}, through the pixel centres")
        if "position" in fields:
            fields["depth"] = _length(fields["position"].double() - origin).float()
    elif planar:
        del fields["depth"]
        notes.append("planar depth left out (camera= would turn it into distance along the ray)")
    elif "depth" in fields:
        notes.append("depth along the ray, as given")
    if "position" not in fields:
        raise ValueError("no layer looks like positions; say which with names={'position': ...}, or give a depth layer and camera=")


def _rays(camera: Camera, size: torch.Size) -> tuple[Tensor, Tensor, Tensor]:
    """Origin ``[1, 1, 3]``, unit directions ``[H, W, 3]`` through the pixel centres, and their cosine ``[H, W, 1]`` to the optical axis."""
    exact = camera.detach().to(torch.device("cpu"), torch.float64)
    if exact.batch_shape or exact.size != tuple(size):
        batch = f"{list(exact.batch_shape)} cameras" if exact.batch_shape else "one camera"
        raise ValueError(f"camera: found {batch} of size {exact.size}, expected one of size {tuple(size)} (height, width)")
    origin, direction = exact.rays()
    cosine = vector.dot(vector.components(direction), vector.components(exact.forward))
    return origin, direction, cosine.unsqueeze(-1)


def _ids(field: str, x: Tensor) -> Tensor:
    """Ids as whole numbers; none where a number means no id: averaged, between two others, or damaged."""
    none = _NO_ID[field]
    return torch.where((x == x.round()) & (x >= none) & (x <= _LARGEST_ID), x, float(none)).long()


def _add_view(fields: dict[str, Tensor], camera: Camera | None, notes: list[str]) -> None:
    if "view" in fields:
        notes.append("view as stored")
    elif camera is None:
        notes.append("no view (camera= would give it)")
    else:
        origin, _, _ = _rays(camera, fields["position"].shape[:2])
        view = vector.normalize(origin - fields["position"].double()).float()
        fields["view"] = torch.where(fields["mask"], view, 0.0)
        notes.append("view from the camera")
