"""EXR files: their layers as arrays, and back; which of the layers is the picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from . import files

Layers = dict[str, dict[str, np.ndarray]]


def read_exr(path: str | Path) -> Layers:
    """Every channel of every part as float32 ``[H, W]``: ``layers[part name, or ""][channel name]``.

    Arrays cover the display window, so that they line up with the camera: a data window that is smaller is set into zeros,
    overscan is cut off. Deep parts and subsampled channels are errors. Errors as for :func:`read_image`.
    """
    import OpenEXR

    path = files.existing(path, "read_exr")
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            promised = len(file.parts)
            _check_exr_headers([part.header for part in file.parts], path.stat().st_size)
        # The reader drops a part that it cannot decode and goes on; the headers say how many there should be.
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if len(file.parts) != promised:
                raise ValueError(f"only {len(file.parts)} of its {promised} parts can be decoded")
            return {p.header.get("name") or "": {n: _in_display(c, p.header) for n, c in p.channels.items()} for p in file.parts}
    except Exception as error:
        raise ValueError(f"read_exr: {path} is damaged, truncated or not an EXR this reader knows: {files.reason(error)}") from None


def write_exr(path: str | Path, channels: Mapping[str, Any]) -> None:
    """Write ``channels`` (name -> tensor or array ``[H, W]``) as one part of float32 under exactly these names (``normal.X``)."""
    import OpenEXR

    path = files.writable(path, "write_exr", (".exr",))
    # A strided array would be written as wrong pixels without an error, and float64 is refused: hence both conversions.
    arrays = {n: np.ascontiguousarray(c.detach().cpu().float() if isinstance(c, Tensor) else c, np.float32) for n, c in channels.items()}
    shapes = {n: a.shape for n, a in arrays.items()}
    if not arrays or len(set(shapes.values())) > 1 or any(a.ndim != 2 or not a.size for a in arrays.values()):
        raise ValueError(f"write_exr: {path}: expected channels [H, W] of one size, found {shapes}")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        with OpenEXR.File(header, arrays) as file:
            file.write(str(path))
    except Exception as error:
        raise OSError(f"write_exr: {path} could not be written: {error}") from None


def _window(header: dict[str, Any], name: str) -> tuple[int, int, int, int]:
    """(left, top, width, height) in pixels."""
    (x0, y0), (x1, y1) = ([int(v) for v in corner] for corner in header[name])
    return x0, y0, x1 - x0 + 1, y1 - y0 + 1


def _check_exr_headers(headers: list[dict[str, Any]], size: int) -> None:
    """Refuse parts that are not read, and those whose windows or tiles together ask for more memory than is believed."""
    total = 0
    for header in headers:
        if "deep" in str(header.get("type")).lower():
            raise ValueError(f"part {header.get('name')!r} is deep, and only flat parts are read")
        thinned = [c.name for c in header["channels"] if (c.xSampling, c.ySampling) != (1, 1)]
        if thinned:
            raise ValueError(f"channels {thinned} are subsampled; write them at full resolution (as R, G, B)")
        sides = {name: _window(header, name)[2:] for name in ("dataWindow", "displayWindow")}
        if "tiles" in header:
            sides["tile"] = header["tiles"].xSize, header["tiles"].ySize
        name, (width, height) = max(sides.items(), key=lambda side: side[1][0] * side[1][1])
        if min(min(pair) for pair in sides.values()) < 1:
            raise ValueError(f"its windows are empty: {sides}")
        total += 4 * width * height * len(header["channels"])
        files.check_claim(total, size, f"its {name} claims {width} x {height} pixels of {len(header['channels'])} channels")


def _in_display(channel: Any, header: dict[str, Any]) -> np.ndarray:
    data, display = _window(header, "dataWindow"), _window(header, "displayWindow")
    pixels = np.asarray(channel.pixels).astype(np.float32, copy=False)
    if data == display:
        return pixels
    out = np.zeros((display[3], display[2]), np.float32)
    left, top = data[0] - display[0], data[1] - display[1]
    x0, x1, y0, y1 = max(left, 0), min(left + data[2], display[2]), max(top, 0), min(top + data[3], display[3])
    if x0 < x1 and y0 < y1:
        out[y0:y1, x0:x1] = pixels[y0 - top : y1 - top, x0 - left : x1 - left]
    return out


def picture(layers: Layers, path: Path) -> np.ndarray:
    """The picture among an EXR's layers, ``[H, W, C]``."""
    found: dict[tuple[int, str], dict[str, np.ndarray]] = {}
    for index, channels in enumerate(layers.values()):
        for name, pixels in channels.items():
            prefix, _, last = name.rpartition(".")
            found.setdefault((index, prefix), {})[last.upper()] = pixels
    names = list(layers)
    for wanted in ("RGB", "Y"):
        # The Y beside an X is a component of a vector, not luminance.
        groups = {key: group for key, group in found.items() if all(c in group for c in wanted) and "X" not in group}
        labels = {key: key[1] or names[key[0]] for key in groups}
        combined = [key for key, label in labels.items() if label.rpartition(".")[2].lower() == "combined"]
        chosen = (0, "") if (0, "") in groups else combined[0] if combined else next(iter(groups)) if len(groups) == 1 else None
        if chosen is not None:
            group = groups[chosen]
            return np.stack([group[c] for c in (*wanted, *("A" if "A" in group else ""))][: 4 if wanted == "RGB" else 1], -1)
        if groups:
            raise ValueError(f"read_image: {path} holds several pictures, {sorted(labels.values())}; read_exr gives them all")
    everything = sorted(name for channels in layers.values() for name in channels)
    raise ValueError(f"read_image: {path} holds no R, G, B and no Y, found channels {everything}")
