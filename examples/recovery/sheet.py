"""What people look at: one sheet of pictures, the recovered textures, and the numbers as JSON."""

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

import torchbrdf as tb

from .problem import Problem, View


def shown(image: Tensor, exposure: float) -> Any:
    """8-bit-like values in [0, 1] of a linear image, sRGB-encoded."""
    from kornia.color import linear_rgb_to_rgb

    return linear_rgb_to_rgb((image * exposure).clamp(0, 1).movedim(-1, 0)).movedim(0, -1).float().numpy()


def render(material: nn.Module, problem: Problem, view: View) -> Tensor:
    """All lights of a view, [L, H, W, C], by the material as it is now."""
    with torch.no_grad():
        return tb.shade(view.g, material(view.g), problem.lights(view.g), visibility=view.visibility, per_light=True)


def save_sheet(path: Path, view: View, start: Tensor, recovered: Tensor, losses: list[float], columns: int = 4) -> None:
    """Target, start, recovered and the error x 10 for some of the lights, and the loss."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    count = len(view.images)
    picks = sorted({round(k * (count - 1) / max(columns - 1, 1)) for k in range(min(columns, count))})
    rows = {"target": view.images, "start": start, "recovered": recovered, "|error| x 10": 10 * (recovered - view.images).abs()}
    figure, axes = plt.subplots(len(picks) + 1, 4, figsize=(10, 2.6 * len(picks) + 2.6), squeeze=False)
    mask = view.g.valid
    for line, light in zip(axes, picks, strict=False):
        exposure = 0.9 / float(view.images[light][mask.squeeze(-1)].quantile(0.99))
        for axis, (title, images) in zip(line, rows.items(), strict=True):
            axis.imshow(shown(images[light] * mask, exposure))
            axis.set_title(f"{title}, light {light}", fontsize=8)
            axis.axis("off")
    gs = axes[-1][0].get_gridspec()
    for axis in axes[-1]:
        axis.remove()
    loss = figure.add_subplot(gs[-1, :])
    loss.semilogy(torch.tensor(losses).sqrt().numpy())
    loss.set(xlabel="iteration", ylabel="rms residual", title="loss")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def save_material(folder: Path, material: nn.Module, rows: list[dict[str, Any]]) -> None:
    """``material.json`` with every number, and each learned texture as an EXR (exact) and a PNG (to look at)."""
    record: dict[str, Any] = {"report": rows, "parameters": {}}
    for name, module in material.named_modules():
        if not isinstance(module, tb.nn.Learned | tb.nn.Texture):
            continue
        value = module.value.detach()
        if isinstance(module, tb.nn.Texture):
            file = name.replace("terms.", "").replace(".", "_")
            for suffix in (".exr", ".png"):
                tb.save_image(folder / f"{file}{suffix}", value.float())
            record["parameters"][name] = f"{file}.exr"
        else:
            record["parameters"][name] = value.tolist()
    (folder / "material.json").write_text(json.dumps(record, indent=2) + "\n")
