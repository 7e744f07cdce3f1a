"""Integer pictures (PNG, JPEG, TIFF, ...) through Pillow, and 16-bit colour PNG, which Pillow would cut to 8 bits, through kornia_rs.

Only formats that are nothing but pixels are opened, whatever the name of the file says: an EPS file is a program, and Pillow
would run it.

OpenImageIO (3.2.2 was tried) would replace this module and ``rgbe.py`` in a quarter of the lines and of the time. It is not
used because it reads a truncated JPEG as grey, the old run lengths of Radiance files as pixels and any file called ``.null`` as
black, all without an error, and refuses Radiance files without a ``FORMAT`` line.
"""

import io
import struct
from pathlib import Path

import numpy as np

from . import files

FORMATS = ("AVIF", "BMP", "DIB", "GIF", "JPEG", "JPEG2000", "PCX", "PNG", "PPM", "PSD", "QOI", "SGI", "TGA", "TIFF", "WEBP")
_CHANNELS = {"L": 1, "RGB": 3, "RGBA": 4}  # of the modes that are taken as they are, beside those of 16-bit grey


def read(path: Path) -> np.ndarray:
    """Float32 ``[H, W, C]`` in [0, 1], turned upright by its EXIF orientation; grey stays one channel."""
    try:
        pixels = _read_deep_png(path) if _is_deep_png(path) else _read_pillow(path)
    except Exception as error:
        why = f"none of {', '.join(FORMATS)}" if type(error).__name__ == "UnidentifiedImageError" else files.reason(error)
        raise ValueError(f"read_image: {path} is damaged, truncated or no picture that Pillow knows: {why}") from None
    return pixels if pixels.ndim == 3 else pixels[..., None]


def _read_pillow(path: Path) -> np.ndarray:
    from PIL import Image, ImageOps

    Image.init()
    data = io.BytesIO(path.read_bytes())  # of which no chunk can be longer than there is
    with Image.open(data, formats=[name for name in FORMATS if name in Image.OPEN]) as file:
        if file.mode == "F":
            raise ValueError("its pixels are floats, which an 8-bit reader would clip; save it as EXR")
        deep = file.mode.startswith("I")
        _check_size(path, *file.size, 1 if deep else _CHANNELS.get(file.mode, 4))
        picture = ImageOps.exif_transpose(file)
        if not deep and picture.mode not in _CHANNELS:
            picture = picture.convert("RGBA" if picture.has_transparency_data else "RGB")
        pixels = np.array(picture, np.float32)
    pixels /= np.float32(65535.0 if deep else 255.0)
    return pixels


def _check_size(path: Path, width: int, height: int, channels: int) -> None:
    files.check_claim(4 * width * height * channels, path.stat().st_size, f"it claims {width} x {height} pixels of {channels} floats")


def _is_deep_png(path: Path) -> bool:
    """16-bit colour, which Pillow would cut to 8 bits without a word (16-bit grey it keeps)."""
    head = _head(path)
    return head.startswith(b"\x89PNG\r\n\x1a\n") and len(head) == 26 and head[24] == 16 and head[25] != 0


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(26)


def _read_deep_png(path: Path) -> np.ndarray:
    import kornia_rs  # kornia's own picture reader

    read_any = getattr(kornia_rs, "io", kornia_rs).read_image
    width, height = struct.unpack(">II", _head(path)[16:24])
    _check_size(path, width, height, 4)
    pixels = np.asarray(read_any(str(path)))
    if pixels.dtype != np.uint16 or pixels.shape[0] != height:
        raise ValueError("this version of kornia_rs reads no 16-bit colour PNG; save the picture as EXR")
    scaled = pixels.astype(np.float32)
    scaled /= np.float32(65535.0)
    return scaled
