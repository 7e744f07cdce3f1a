"""Learn a material and a light from many views, on many processes or machines: each shades its share of the views.

    python examples/shard_views.py                                        # one process
    torchrun --nproc-per-node 2 examples/shard_views.py                   # two; each has half of the views
    torchrun --nnodes 4 --nproc-per-node 8 --rdzv-backend c10d --rdzv-endpoint HOST:29400 examples/shard_views.py

Every process makes the G-buffers of its own views alone, adds up the gradients over them, one view after the other
(`tb.value_and_grad(..., fill=True)`), and then over all processes by one all_reduce. What is learned is the same everywhere, so each
takes the same optimiser step. The photographs are made here, with a known material.
"""

import argparse
import math
import os
from pathlib import Path
from typing import NamedTuple

import torch
import torch.distributed as dist
from recovery.builtin import lumpy_ring
from torch import Tensor, nn

import torchbrdf as tb


class View(NamedTuple):
    """A G-buffer and its photograph."""

    g: tb.GBuffer
    photograph: Tensor


class Scene(nn.Module):
    """All that is learned: an albedo, a strength, an exponent, an index of refraction, and where the light is and how bright."""

    def __init__(self, g: tb.GBuffer) -> None:
        super().__init__()
        fresnel = tb.nn.Material(tb.Dielectric, eta=tb.nn.Learned(1.3))
        gloss = tb.nn.Material(tb.Phong, specular=tb.nn.Learned(0.5), exponent=tb.nn.Learned(10.0), fresnel=fresnel)
        made = tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned([0.5, 0.5, 0.5])) + gloss
        self.light = tb.nn.Material(tb.PointLight, position=tb.nn.Learned([1.0, 4.0, 1.0]), intensity=tb.nn.Learned([40.0]))
        self.shader = tb.nn.Shader(made, tb.plan(g, made(g), self.light(g)))

    def forward(self, g: tb.GBuffer) -> Tensor:
        return self.shader(g, self.light(g))


def view(mesh: tb.Mesh, angle: float, size: int) -> View:
    eye = [4.0 * math.cos(angle), 2.0, 4.0 * math.sin(angle)]
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at(eye, [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], fov_y=35.0, size=(size, size)))
    truth = tb.Lambert([0.6, 0.3, 0.2]) + tb.Phong(0.8, 30.0, fresnel=tb.Dielectric(1.6))
    return View(g, tb.shade(g, truth, tb.PointLight([2.0, 4.0, 2.0], 60.0)))


def my_share(count: int, size: int, rank: int, processes: int) -> list[View]:
    """Views rank, rank + processes, ..."""
    mesh = lumpy_ring()
    return [view(mesh, 2.0 * math.pi * k / count, size) for k in range(rank, count, processes)]


def squares(scene: Scene, g: tb.GBuffer, photograph: Tensor) -> Tensor:
    return (scene(g) - photograph).square().sum()


def add_over_processes(scene: nn.Module, loss: Tensor) -> Tensor:
    """Sum the loss and the gradients over all processes, in one message."""
    if not dist.is_initialized():
        return loss
    numbers = torch.cat([loss.reshape(1), *(p.grad.reshape(-1) for p in scene.parameters())])
    dist.all_reduce(numbers)
    loss, *gradients = numbers.split([1, *(p.numel() for p in scene.parameters())])
    for p, gradient in zip(scene.parameters(), gradients, strict=True):
        p.grad = gradient.view_as(p)
    return loss.squeeze()


def fit(scene: Scene, views: list[View], steps: int, compiled: bool, rate: float = 0.03) -> list[float]:
    """The sum of squares before each step, over all processes."""
    optimiser = torch.optim.Adam(scene.parameters(), lr=rate)
    step = tb.value_and_grad(squares, fill=True, compiled=compiled)
    losses = []
    for _ in range(steps):
        for p in scene.parameters():
            p.grad = torch.zeros_like(p)  # a process without views adds nothing
        mine = sum((step(scene, v.g, v.photograph)[0] for v in views), torch.zeros(()))
        losses.append(float(add_over_processes(scene, mine)))
        optimiser.step()
    return losses


def main(argv: list[str] | None = None) -> list[float]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--eager", action="store_true", help="do not compile: pays for few or small views")
    parser.add_argument("--out", type=Path, help="where the losses and what was learned go, a .pt file")
    args = parser.parse_args(argv)
    together = "RANK" in os.environ  # started by torchrun
    if together:
        dist.init_process_group("gloo")  # on GPUs "nccl"
    rank, processes = (dist.get_rank(), dist.get_world_size()) if together else (0, 1)
    scene = Scene(view(lumpy_ring(), 0.0, 8).g)  # the same start everywhere
    losses = fit(scene, my_share(args.views, args.size, rank, processes), args.steps, not args.eager)
    if rank == 0:
        print(f"{processes} process(es), {args.views} views: loss {losses[0]:.4g} -> {losses[-1]:.4g} in {args.steps} steps")
        if args.out:
            torch.save({"losses": losses, "learned": scene.state_dict()}, args.out)
    if together:
        dist.destroy_process_group()
    return losses


if __name__ == "__main__":
    main()
