"""Radiance pictures (``.hdr``): four bytes a pixel, three mantissas and the exponent they share (Ward 1991, *Real Pixels*).

Reads all three encodings that exist: flat, the old run lengths and the new ones, in any of the eight orientations. The
mantissa is taken as written (``m 2^(e-136)``, as Walter's reader and most renderers do, without Radiance's own half step).
``EXPOSURE`` lines are divided out: the result is radiance in W/(m² sr), as the format defines it.
"""

import re

import numpy as np

from . import files

MAGIC = (b"#?RADIANCE", b"#?RGBE")
_HEADER_LIMIT, _SIZE_LIMIT = 1 << 16, 80  # bytes; a file without an end of header is not searched to its end
LONGEST_HEADER = _HEADER_LIMIT + _SIZE_LIMIT
_SIZE = re.compile(rb"([+-])([XY])\s+(\d{1,9})\s+([+-])([XY])\s+(\d{1,9})\s*")
_SHORTEST, _LONGEST = 8, 0x7FFF  # scanline widths for which the new run lengths are defined


def longest_body(head: bytes, size: int) -> int:
    """The most bytes that the scanlines after a header can take; ``ValueError`` where a file of ``size`` bytes cannot hold them."""
    _, (_, _, n0), (_, _, n1), _ = _header(head)
    if n0 * n1 == 0:
        raise ValueError(f"its header claims {n0} x {n1} pixels; a picture has at least one")
    files.check_claim(12 * n0 * n1, size, f"its header claims {n0} x {n1} pixels")
    return 8 * n0 * n1 + 4 * n0  # runs of one byte each: two bytes for one


def decode(data: bytes) -> np.ndarray:
    """The picture in ``data`` as float32 ``[H, W, 3]``, top row first. ``ValueError`` says what is wrong with a damaged one."""
    longest_body(data, len(data))
    exposure, (sign0, axis0, n0), (sign1, axis1, n1), start = _header(data)
    quads = _scanlines(data, start, n0, n1)
    quads = quads[:: 1 if (axis0, sign0) in ((b"Y", b"-"), (b"X", b"+")) else -1]
    quads = quads[:, :: 1 if (axis1, sign1) in ((b"Y", b"-"), (b"X", b"+")) else -1]
    image = _floats(quads if axis0 == b"Y" else quads.swapaxes(0, 1))
    image /= np.float32(exposure)
    return image


def _floats(quads: np.ndarray) -> np.ndarray:
    exponents = np.arange(256)
    scale = np.where(exponents > 0, np.ldexp(np.float32(1.0), exponents - 136), 0.0).astype(np.float32)
    floats = quads[..., :3].astype(np.float32)
    floats *= scale[quads[..., 3:]]
    return floats


def _header(data: bytes) -> tuple[float, tuple[bytes, bytes, int], tuple[bytes, bytes, int], int]:
    if not data.startswith(MAGIC):
        raise ValueError(f"it does not begin with {' or '.join(m.decode() for m in MAGIC)}")
    end = re.search(rb"\r?\n\r?\n", data[:_HEADER_LIMIT])
    size_end = -1 if end is None else data.find(b"\n", end.end(), end.end() + _SIZE_LIMIT)
    if end is None or size_end < 0:
        raise ValueError("its header has no end")
    exposure = _exposure(data[: end.start()].splitlines()[1:])
    match = _SIZE.fullmatch(data[end.end() : size_end])
    if match is None or match[2] == match[5]:
        raise ValueError(f"its size line is {data[end.end() : size_end]!r}, expected one like b'-Y 512 +X 1024'")
    return exposure, (match[1], match[2], int(match[3])), (match[4], match[5], int(match[6])), size_end + 1


def _exposure(lines: list[bytes]) -> float:
    total = 1.0
    for line in lines:
        key, _, text = line.partition(b"=")
        if key.strip() == b"FORMAT" and text.strip() != b"32-bit_rle_rgbe":
            raise ValueError(f"its FORMAT is {text.strip()!r}; only b'32-bit_rle_rgbe' is read")
        if key.strip() == b"EXPOSURE":
            total *= _positive(text)
    return total


def _positive(text: bytes) -> float:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (np.isfinite(number) and number > 0):
        raise ValueError(f"its EXPOSURE is {text!r}, expected a positive number")
    return number


def _scanlines(data: bytes, at: int, count: int, width: int) -> np.ndarray:
    out = np.empty((count, width, 4), np.uint8)
    for row in range(count):
        try:
            runs = _SHORTEST <= width <= _LONGEST and data[at : at + 4] == bytes((2, 2, width >> 8, width & 255))
            at = _new_runs(data, at + 4, out[row]) if runs else _old_runs(data, at, out[row])
        except (IndexError, ValueError) as error:
            raise ValueError(f"scanline {row} of {count} is cut short or damaged ({error})") from None
    return out


def _new_runs(data: bytes, at: int, row: np.ndarray) -> int:
    """One scanline, channel after channel: a byte n > 128 repeats the next byte n - 128 times, n <= 128 copies n bytes."""
    width = len(row)
    for channel in range(4):
        line = bytearray()
        while len(line) < width:
            n = data[at]
            piece = data[at + 1 : at + 2] * (n - 128) if n > 128 else data[at + 1 : at + 1 + n]
            if len(piece) != (n - 128 if n > 128 else n) or not piece:
                raise ValueError("a run is incomplete")
            line += piece
            at += 2 if n > 128 else 1 + n
        if len(line) != width:
            raise ValueError(f"runs of {len(line)} pixels in a row of {width}")
        row[:, channel] = np.frombuffer(line, np.uint8)
    return at


def _old_runs(data: bytes, at: int, row: np.ndarray) -> int:
    """One scanline of whole pixels; a pixel (1, 1, 1, n) repeats the last one n times, and successive ones count in base 256."""
    width = len(row)
    flat = np.frombuffer(data, np.uint8, min(width * 4, (len(data) - at) & ~3), at).reshape(-1, 4)
    marked = (flat[:, :3] == 1).all(-1)
    if len(flat) == width and not marked.any():
        row[:] = flat
        return at + 4 * width
    filled = shift = 0
    for quad, repeat in zip(flat, marked, strict=True):
        n = int(quad[3]) << shift if repeat else 1
        if filled + n > width or (repeat and filled == 0):
            raise ValueError("a run leaves its row")
        row[filled : filled + n] = row[filled - 1] if repeat else quad
        filled, shift, at = filled + n, shift + 8 if repeat else 0, at + 4
        if filled == width:
            return at
    raise ValueError("it ends early")
