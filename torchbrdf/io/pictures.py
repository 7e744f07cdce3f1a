"""Pictures at the border: files in, linear float32 tensors out, and back.

Inside the library every colour is linear; sRGB is decoded here when an 8- or 16-bit picture comes in and encoded when one
goes out. Non-finite pixels are kept as they are by everything that reads, and by EXR, which can hold them; an 8-bit picture
shows NaN as black and the infinities as black and white, with one warning that counts them.
"""

import math
import warnings
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .. import arguments
from . import exr, files, raster, rgbe

EIGHT_BIT = (".png", ".jpg", ".jpeg")
_MOST_EXPOSURE = 126  # stops, all that float32 spans to either side of 1
_ROWS = 256  # of a picture that are recoded at a time: the sRGB curve holds several copies of what it works on


def read_image(path: str | Path, srgb: bool | None = None) -> Tensor:
    """Picture as linear float32 ``[H, W, C]``, top row first; C is 1, 3, or 4 with alpha (which is never decoded).

    ``.exr`` (R, G, B and A, or Y), Radiance ``.hdr`` and what Pillow opens of formats that are pixels alone (``raster.py``).
    ``srgb=None`` decodes sRGB for integer pictures alone, True and False force it on or off. Of an EXR with several layers the
    first part's plain R, G, B is taken, else the layer called Combined, else the only one. A missing file raises
    ``FileNotFoundError``; a damaged, truncated, unknown or unbelievably large one (``files.py``) ``ValueError``, each naming the file.
    """
    path = files.existing(path, "read_image")
    kind = path.suffix.lower()
    if kind == ".exr":
        pixels, integer = exr.picture(exr.read_exr(path), path), False
    elif kind in (".hdr", ".pic", ".rgbe"):
        pixels, integer = _read_radiance(path), False
    else:
        pixels, integer = raster.read(path), True
    image = torch.from_numpy(np.ascontiguousarray(pixels))
    return _recode(image, "rgb_to_linear_rgb") if (integer if srgb is None else srgb) else image


def save_image(path: str | Path, image: Tensor, exposure: float = 0.0) -> None:
    """Write linear ``image [H, W, 3]`` (or grey, ``[H, W, 1]`` or ``[H, W]``), scaled by ``2**exposure``.

    ``.png`` and ``.jpg``: sRGB encoded, clipped to [0, 1], 8 bit. ``.exr``: linear float32, as it is. Batches, alpha, channels
    first and integers are ``ValueError``s that name the remedy.
    """
    path = files.writable(path, "save_image", (*EIGHT_BIT, ".exr"))
    if not (isinstance(exposure, int | float) and abs(exposure) <= _MOST_EXPOSURE):  # so is NaN refused
        raise ValueError(f"save_image: exposure: expected stops from -{_MOST_EXPOSURE} to {_MOST_EXPOSURE}, found {exposure!r}")
    pixels = _picture(image).float().cpu() * 2.0**exposure
    if path.suffix.lower() == ".exr":
        exr.write_exr(path, dict(zip("RGB" if pixels.shape[-1] == 3 else "Y", pixels.unbind(-1), strict=True)))
        return
    from PIL import Image

    encoded = _recode(_finite(pixels, path).clamp(0.0, 1.0), "linear_rgb_to_rgb")
    bytes_ = (encoded * 255.0).round().to(torch.uint8).contiguous().numpy()
    Image.fromarray(bytes_ if bytes_.shape[-1] == 3 else bytes_[..., 0]).save(path, quality=95)


def _picture(image: Tensor) -> Tensor:
    """``[H, W, 1]`` or ``[H, W, 3]`` without history; what is no such picture is named, with its remedy."""
    arguments.of_kind(image, "save_image: image", Tensor, "tb.shade(g, bsdf, lights)")
    remedy = _remedy(image, list(image.shape))
    if remedy is not None:
        found = f"{str(image.dtype).removeprefix('torch.')} {list(image.shape)}"
        raise ValueError(f"save_image: image: expected linear floats [H, W, 3], [H, W, 1] or [H, W], found {found}{remedy}")
    return image.detach() if image.dim() == 3 else image.detach().unsqueeze(-1)


def _remedy(image: Tensor, shape: list[int]) -> str | None:
    """What to do with an image that cannot be written as it is; None for one that can."""
    if not image.numel():
        return "; it has no pixels"
    if image.dtype == torch.uint8:
        return "; divide by 255 and decode its sRGB first (kornia.color.rgb_to_linear_rgb takes [..., 3, H, W])"
    if not image.is_floating_point():
        return "; convert it, for example with image.float()"
    if len(shape) < 2:
        return "; one pixel is image.reshape(1, 1, -1)"
    if len(shape) > 3:
        return f"; it is a batch: save one picture of it, such as image[{', '.join('0' * (len(shape) - 3))}]"
    if len(shape) == 2:
        return f"; if it is a list of pixels, did you mean image.reshape(H, W, {shape[1]})?" if shape[1] in (1, 3) else None
    if shape[-1] in (1, 3):
        return None
    if shape[0] in (1, 3):
        return "; did you mean image.movedim(0, -1)?"
    return f"; {'alpha is not written' if shape[-1] == 4 else 'choose three channels or one'}: did you mean image[..., :3]?"


def _read_radiance(path: Path) -> np.ndarray:
    try:
        with path.open("rb") as file:
            head = file.read(rgbe.LONGEST_HEADER)
            size = path.stat().st_size
            data = head + file.read(min(size, rgbe.longest_body(head, size)))
        return rgbe.decode(data)
    except (ValueError, MemoryError) as error:
        raise ValueError(f"read_image: {path} is damaged, truncated or not a Radiance picture: {files.reason(error)}") from None


def _recode(image: Tensor, name: str) -> Tensor:
    """Apply kornia's sRGB curve to the colour channels of ``[H, W, C]``, a few rows at a time."""
    import kornia.color

    count = 3 if image.shape[-1] >= 3 else 1
    out = image.clone()
    for rows in out[..., :count].split(_ROWS):
        rows.copy_(getattr(kornia.color, name)(rows.movedim(-1, 0).expand(3, -1, -1))[:count].movedim(0, -1))
    return out


def _finite(pixels: Tensor, path: Path) -> Tensor:
    bad = int((~torch.isfinite(pixels)).sum())
    if bad:
        warnings.warn(f"save_image: {path}: {bad} non-finite values; NaN and -inf are shown black, +inf white", stacklevel=3)
    return torch.nan_to_num(pixels, nan=0.0, posinf=math.inf, neginf=0.0)
