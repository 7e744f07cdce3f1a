"""Cut the pieces that the repository carries out of the whole files of ``../shared/data`` (or of the folder that is named):

    python tests/data/make_crops.py [folder]

A crop is a window of the image with every channel, part and attribute as it was, so its camera is that of the image with the
principal point moved. SOURCES.md says what each is and where it comes from.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import OpenEXR

HERE = Path(__file__).resolve().parent
SIDE = 64
SPOT = {  # name: (first row, first column), the lights whose images are carried, whether AOVs are
    "tail": ((152, 72), (0, 2), False),  # the shadow of the tail between the legs
    "neck": ((72, 112), (3,), True),  # the shadow of the head on the neck, and the silhouette of both
    "horns": ((24, 112), (1,), True),  # horns and an ear before the background
}
SPHERES = {"blender/bl50_lambert": (0, 8), "blender/bl50_ggx": (0, 8), "mitsuba/diffuse": (0, 8)}  # its dark side and its edge
LINES = range(240, 264)  # of the Radiance picture, across windows and lamps
METALS = ("Ag_Johnson", "Al_Rakic", "Au_Johnson", "Cr_Johnson", "Cu_Johnson", "Fe_Johnson", "Ni_Johnson", "Ti_Johnson")
COARSER = 4  # the lat-long map, in each direction


def crop(source: Path, target: Path, row: int, column: int) -> None:
    """One EXR file."""
    end = np.array([SIDE - 1, SIDE - 1], dtype=np.int32)
    box = (np.zeros(2, dtype=np.int32), end)
    parts = []
    for part in OpenEXR.File(str(source), separate_channels=True).parts:
        header = {k: v for k, v in part.header.items() if k not in ("channels", "chunkCount")}
        header |= {"dataWindow": box, "displayWindow": box}
        window = {n: np.ascontiguousarray(c.pixels[row : row + SIDE, column : column + SIDE]) for n, c in part.channels.items()}
        parts.append(OpenEXR.Part(header, window, part.name()))
    target.parent.mkdir(parents=True, exist_ok=True)
    with OpenEXR.File(parts) as file:
        file.write(str(target))


def spot(whole: Path) -> None:
    scene = json.loads((whole / "spot/scene.json").read_text())
    (HERE / "spot").mkdir(exist_ok=True)
    shutil.copy(whole / "spot/spot.obj", HERE / "spot/spot.obj")
    for name, ((row, column), lights, aovs) in SPOT.items():
        folder = HERE / "spot" / name
        if aovs:
            crop(whole / "spot/aov.exr", folder / "aov.exr", row, column)
        for files in scene["images"].values():
            for k in lights:
                crop(whole / "spot" / files[k], folder / files[k], row, column)
        kept = {"lights": [scene["lights"][k] for k in lights], "images": {m: [f[k] for k in lights] for m, f in scene["images"].items()}}
        cut = {"mesh": "../spot.obj", "window": [row, column, SIDE, SIDE], "shadows": name != "horns"}
        (folder / "scene.json").write_text(json.dumps({**scene, **kept, **cut}, indent=1) + "\n")


def spheres(whole: Path) -> None:
    for name, (row, column) in SPHERES.items():
        crop(whole / f"{name}.exr", HERE / f"{name}.exr", row, column)
        about = json.loads((whole / f"{name}.json").read_text())
        (HERE / f"{name}.json").write_text(json.dumps({**about, "window": [row, column, SIDE, SIDE]}, indent=1) + "\n")


def coarser_map(whole: Path) -> None:
    """The darkest of COARSER x COARSER texels, so that thin lines stay lines: all of a map is needed, its resolution is not."""
    (part,) = OpenEXR.File(str(whole / "hdri/OrientationLatLong.exr"), separate_channels=True).parts
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "owner": part.header["owner"]}
    pixels = {n: c.pixels.astype(np.float64) for n, c in part.channels.items() if n in "RGB"}
    blocks = {n: p.reshape(p.shape[0] // COARSER, COARSER, -1, COARSER).min((1, 3)).astype(np.float16) for n, p in pixels.items()}
    with OpenEXR.File(header, {n: np.ascontiguousarray(b) for n, b in blocks.items()}) as file:
        file.write(str(HERE / "hdri/OrientationLatLong.exr"))


def line_ends(data: bytes, at: int, lines: int, width: int) -> list[int]:
    """Where each run-length encoded line of a Radiance picture begins, and where the last one ends."""
    found = [at]
    for _ in range(lines):
        assert data[at : at + 4] == bytes((2, 2, width >> 8, width & 255)), "the encoding by channels"
        at += 4
        for _ in range(4):
            left = width
            while left:
                count = data[at]
                left -= count - 128 if count > 128 else count
                at += 2 if count > 128 else 1 + count
        found.append(at)
    return found


def some_lines(whole: Path) -> None:
    """The bytes of some lines of the Radiance picture as its writer left them, under a header that says how many there are."""
    data = (whole / "hdri/studio.hdr").read_bytes()
    size = b"-Y 512 +X 1024\n"
    begin = data.index(size)
    ends = line_ends(data, begin + len(size), 512, 1024)
    header = data[:begin] + b"-Y %d +X 1024\n" % len(LINES)
    (HERE / "hdri/studio.hdr").write_bytes(header + data[ends[LINES.start] : ends[LINES.stop]])


def main() -> None:
    whole = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parents[2] / "shared" / "data"
    for folder in ("hdri", "nk"):
        (HERE / folder).mkdir(exist_ok=True)
    spot(whole)
    spheres(whole)
    coarser_map(whole)
    some_lines(whole)
    for metal in METALS:
        shutil.copy(whole / f"nk/{metal}.yml", HERE / f"nk/{metal}.yml")


if __name__ == "__main__":
    main()
