"""What is checked, and at which points: single materials in float64, geometries a margin away from every declared kink."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..geometry import Layout
from ..optics.fresnel import Fresnel
from ..value import Value
from ..vector import Frame, normalize

DELTA, SPREAD = Lobe.DELTA, Lobe.SPREAD
MARGIN = 0.05  # distance kept from kinks: a hundred times what half precision may move a cosine


class Outcome(NamedTuple):
    """The verdict on one property: ``ok`` is None where it does not apply; ``figure`` is the worst number found."""

    name: str
    ok: bool | None
    figure: float | None = None
    detail: str = ""

    @staticmethod
    def absent(name: str, why: str) -> "Outcome":
        """A property that does not apply."""
        return Outcome(name, None, None, why)


class Probe(NamedTuple):
    """A differentiable function of a value and of ``inputs`` ``[N, k]`` (float64), none of them near a kink."""

    name: str
    call: Callable[..., Tensor]
    inputs: dict[str, Tensor]


def generator(seed: int) -> torch.Generator:
    """Random numbers that are the same everywhere."""
    return torch.Generator().manual_seed(seed)


def materials(subject: Any, rng: torch.Generator, count: int) -> list[Any]:
    """Up to ``count`` single materials of a batch, drawn at random, as detached float64 values on the CPU."""
    batch = subject.batch_shape
    plain = subject.detach().to(device="cpu", dtype=torch.float64)
    if not batch:
        return [plain]
    picks = [tuple(int(torch.randint(size, (), generator=rng)) for size in batch) for _ in range(min(count, batch.numel()))]
    return [plain[pick] for pick in picks]


def directions(count: int, rng: torch.Generator) -> Tensor:
    """Unit vectors ``[count, 3]``, uniform on the sphere."""
    return normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64))


def above(count: int, rng: torch.Generator, least: float = MARGIN) -> Tensor:
    """Local directions ``[count, 3]`` of cosine at least ``least``."""
    w = directions(count, rng)
    z = least + (1.0 - least) * torch.rand(count, generator=rng, dtype=torch.float64)
    side = normalize(torch.stack([w[:, 0], w[:, 1], torch.zeros_like(z)], -1)) * torch.sqrt(1.0 - z * z).unsqueeze(-1)
    return side + torch.stack([torch.zeros_like(z), torch.zeros_like(z), z], -1)


def at_angles(*degrees: float) -> Tensor:
    """Local directions ``[len, 3]`` at these angles from the normal, none in a plane of symmetry."""
    t = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    phi = torch.tensor(0.3, dtype=torch.float64)
    return torch.stack([torch.sin(t) * torch.cos(phi), torch.sin(t) * torch.sin(phi), torch.cos(t)], -1)


def uniform(count: int, rng: torch.Generator) -> Tensor:
    """Random numbers ``[count, 3]`` for a sampler."""
    return torch.rand(count, 3, generator=rng, dtype=torch.float64)


def viewers(bsdf: Any, count: int, rng: torch.Generator) -> Tensor:
    """Local directions ``[count, 3]`` to viewers for whom the model may send light: above, or on both sides."""
    wo = above(count, rng)
    return wo if not sees_below(bsdf) else wo * torch.where(torch.arange(count) % 2 == 0, 1.0, -1.0).unsqueeze(-1)


def sees_below(bsdf: Any) -> bool:
    """Whether the domain of a model has viewers below the surface."""
    wi = at_angles(*range(0, 90, 15))
    both = torch.cat([wi, wi * torch.tensor([1.0, 1.0, -1.0], dtype=wi.dtype)])
    below = at_angles(40.0) * torch.tensor([1.0, 1.0, -1.0], dtype=wi.dtype)
    return isinstance(bsdf, Bsdf) and bool(bsdf.domain(bsdf.geometry(both, below.expand_as(both))).any())


def spread(subject: Any) -> Bsdf | None:
    """The part of a model that is no delta lobe."""
    return subject.select(SPREAD) if isinstance(subject, Bsdf) else None


def transmits(bsdf: Bsdf) -> bool:
    """Whether some lobe sends light to the other side."""
    return any(lobe.transmits for lobe in bsdf.lobes)


def smooth_points(bsdf: Bsdf, rng: torch.Generator, count: int) -> dict[str, Tensor]:
    """``wi, wo, n [count, 3]`` in world space: half of them uniform, half where the sampler goes, all away from kinks."""
    tries = max(16 * count, 1024)
    frame = Frame.from_normal(directions(tries, rng))
    wo = viewers(bsdf, tries, rng)
    sampled = bsdf.sample(wo, uniform(tries, rng)).wi.detach()
    uniformly = above(tries, rng) if not (transmits(bsdf) or sees_below(bsdf)) else directions(tries, rng)
    kept = []
    for wi, wanted in ((uniformly, count - count // 2), (sampled, count // 2)):
        w = {"wi": frame.to_world(wi), "wo": frame.to_world(wo), "n": frame.normal}
        g = bsdf.geometry(w["wi"], w["wo"], w["n"])
        smooth = (bsdf.domain(g) & (bsdf.kink_distance(g) > MARGIN)).reshape(tries)
        kept.append({name: v[smooth][:wanted] for name, v in w.items()})
    found = {name: torch.cat([k[name] for k in kept]) for name in kept[0]}
    if len(found["wi"]) == 0:
        raise ValueError(f"{type(bsdf).__name__}: no geometry lies {MARGIN} away from its kinks; is kink_distance right?")
    return found


def probes(subject: Any, rng: torch.Generator, count: int) -> Iterator[Probe]:
    """The functions through which a value is seen: ``evaluate``, each delta lobe's sample weight, ``reflectance``."""
    if isinstance(subject, Fresnel):
        cos = MARGIN + (1.0 - 2.0 * MARGIN) * torch.rand(64 * count, generator=rng, dtype=torch.float64)
        smooth = subject.kink_distance(Layout.beside(cos), cos) > MARGIN
        yield Probe("reflectance", lambda v, cos_i: v.reflectance(cos_i), {"cos_i": cos[smooth][:count].unsqueeze(-1)})
        return
    if spread(subject) is not None:
        yield Probe("evaluate", lambda v, wi, wo, n: v.evaluate(wi, wo, n), smooth_points(subject, rng, count))
    delta = subject.select(DELTA)
    if delta is not None and len(delta.lobes) == 1:
        w = smooth_points(delta, rng, count)
        yield Probe("sample", _delta_weight, {"wo": w["wo"], "n": w["n"]})


def _delta_weight(bsdf: Bsdf, wo: Tensor, n: Tensor) -> Tensor:
    delta = bsdf.select(DELTA)
    assert delta is not None
    return delta.sample(wo, torch.full((*wo.shape[:-1], 3), 0.5, dtype=wo.dtype), n).weight


def leaves(value: Value) -> tuple[list[str], list[Tensor], Callable[[list[Tensor]], Any]]:
    """Names and tensors of all parameters, nested ones too, and the way back."""
    found = list(value.named_tensors())

    def rebuild(tensors: list[Tensor]) -> Any:
        left = iter(tensors)
        return value.map(lambda _: next(left))

    return [path for path, _ in found], [t for _, t in found], rebuild


def batched(value: Any, count: int, rng: torch.Generator) -> Any:
    """``count`` neighbours of a single material, as one value with a batch axis."""

    def vary(t: Tensor) -> Tensor:
        return (
            t * (1.0 - 0.1 * torch.rand(count, t.shape[-1], generator=rng, dtype=t.dtype)) if t.is_floating_point() else t.expand(count, -1)
        )

    return value.map(vary)
