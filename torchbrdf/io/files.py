"""Files from outside: what they may claim, and how a reader says no.

A header costs its writer nothing, and so does a run of zeros that unpacks to a terabyte. What a file claims to hold is
therefore added up before anything is decoded: up to :data:`MAX_DECODED_BYTES` bytes are believed of any file, and beyond that
:data:`MAX_EXPANSION` times its own size. A reader holds up to three copies of what it decodes.

Every refusal is a ``ValueError`` (a missing file is a ``FileNotFoundError``) of one line that names the file.
"""

import os
from pathlib import Path

MAX_DECODED_BYTES = 1 << 30  # bytes; raise it (torchbrdf.io.files.MAX_DECODED_BYTES = ...) for a file that you trust
MAX_EXPANSION = 64  # what a format packs to less than this part of its size, beyond MAX_DECODED_BYTES, is taken for a bomb


def existing(path: str | Path, who: str) -> Path:
    """The path of a file that is there."""
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"{who}: expected the path of a file, found {type(path).__name__}")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{who}: no such file: {path}")
    return Path(path)


def folder_of(path: str | Path, who: str) -> Path:
    """The folder, which must be there, of a file that is to be written."""
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"{who}: expected the path of a file, found {type(path).__name__}")
    folder = Path(path).parent
    if not folder.is_dir():
        raise FileNotFoundError(f"{who}: {path}: no such folder: {folder}")
    return folder


def writable(path: str | Path, who: str, legal: tuple[str, ...]) -> Path:
    """The path of a file that is to be written, whose folder is there and whose name ends in one of ``legal``."""
    folder_of(path, who)
    path = Path(path)
    if path.suffix.lower() not in legal:
        raise ValueError(f"{who}: {path}: the name must end in one of {', '.join(legal)}")
    return path


def plausible_size(size: int) -> int:
    """How many decoded bytes are believed of a file of ``size`` bytes."""
    return max(MAX_DECODED_BYTES, MAX_EXPANSION * size)


def check_claim(claimed: int, size: int, what: str) -> None:
    """Raise ``ValueError`` if a file of ``size`` bytes claims, by ``what``, more decoded bytes than are believed of it."""
    if claimed > plausible_size(size):
        raise ValueError(
            f"{what}: {_amount(claimed)}, which its {size} bytes cannot hold (at most {_amount(plausible_size(size))} is believed; "
            "for a file that you trust, raise torchbrdf.io.files.MAX_DECODED_BYTES)"
        )


def reason(error: BaseException) -> str:
    """What an exception says, in one short line; a bare ``ValueError`` goes without its name."""
    said = (str(error).strip().splitlines() or [""])[0][:300]
    return said if said and type(error) is ValueError else ": ".join(filter(None, (type(error).__name__, said)))


def _amount(count: int) -> str:
    return f"{count / 2**30:.3g} GiB" if count >= 2**30 else f"{count / 2**20:.3g} MiB"
