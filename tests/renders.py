"""Images by other renderers: crops that the repository carries (data/SOURCES.md), and the whole ones where they lie beside it."""

import json
from pathlib import Path

import torch

import torchbrdf as tb

WHOLE = Path(__file__).resolve().parents[2] / "shared" / "data"
CARRIED = Path(__file__).resolve().parent / "data"


def about(image: Path) -> dict:
    """What the ``.json`` beside an image says of it."""
    return json.loads(image.with_suffix(".json").read_text())


def cropped(camera: tb.Camera, said: dict) -> tb.Camera:
    """The camera of the image that is there, given that of the whole one."""
    if "window" not in said:
        return camera
    row, column, height, width = said["window"]
    return camera.replace(principal=camera.principal - torch.tensor([column, row]), size=(height, width))


def within(whole: torch.Tensor, said: dict) -> torch.Tensor:
    """The window of something ``[H, W, ...]`` that was found for the whole image."""
    if "window" not in said:
        return whole
    row, column, height, width = said["window"]
    return whole[row : row + height, column : column + width]


def spot(folder: Path) -> tuple[tb.Mesh, tb.Camera, dict]:
    """The cow, the camera of the images in ``folder``, and their scene."""
    scene = about(folder / "scene")
    return tb.load_mesh(folder / scene["mesh"]), cropped(whole_view(scene), scene), scene


def whole_view(scene: dict) -> tb.Camera:
    """The camera of the whole images of the cow."""
    return tb.Camera.look_at(scene["eye"], scene["target"], scene["up"], scene["fov_y_deg"], (scene["res"],) * 2)
