"""What is checked, and at which points: single materials in float64, geometries a margin away from every declared kink."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..geometry import Layout
from ..interval import Interval
from ..optics.fresnel import Fresnel
from ..value import Param, Value
from ..vector import Frame, normalize
from .words import degrees, pair

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

    def at(self, k: int) -> str:
        """One of the inputs, in words."""
        x = {name: v[k] for name, v in self.inputs.items()}
        if "wo" not in x:
            return ", ".join(f"{name} = {v.item():.4g}" for name, v in x.items() if v.numel() == 1)
        return pair(x["wi"], x["wo"], x["n"]) if "wi" in x else f"wo at {degrees(Frame.from_normal(x['n']).to_local(x['wo']))}"


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


def views(bsdf: Any, above: tuple[float, ...], below: tuple[float, ...] = (45.0, 80.0)) -> Tensor:
    """Local directions ``[V, 3]`` at these angles from the normal; and below the surface, for a model that is seen from there."""
    up = at_angles(*above)
    return torch.cat([up, mirrored(at_angles(*below))]) if sees_below(bsdf) else up


def mirrored(w: Tensor) -> Tensor:
    """Local directions on the other side of the surface."""
    return w * torch.tensor([1.0, 1.0, -1.0], dtype=w.dtype)


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
    both = torch.cat([wi, mirrored(wi)])
    below = mirrored(at_angles(40.0))
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
    kept, masks = [], torch.zeros(2, dtype=torch.int64)
    for wi, wanted in ((uniformly, count - count // 2), (sampled, count // 2)):
        w = {"wi": frame.to_world(wi), "wo": frame.to_world(wo), "n": frame.normal}
        g = bsdf.geometry(w["wi"], w["wo"], w["n"])
        inside, smooth = bsdf.domain(g).expand(tries), (bsdf.kink_distance(g) > MARGIN).expand(tries)
        masks += torch.stack([inside.sum(), smooth.sum()])
        kept.append({name: v[inside & smooth][:wanted] for name, v in w.items()})
    found = {name: torch.cat([k[name] for k in kept]) for name in kept[0]}
    if len(found["wi"]) == 0:
        raise ValueError(_excluded(2 * tries, *masks.tolist()))
    return found


def _excluded(tries: int, inside: int, smooth: int) -> str:
    """Which mask left no geometry to look at."""
    if not inside:
        return f"domain excludes all of {tries} pairs of directions"
    if not smooth:
        return f"kink_distance is below {MARGIN} at all of {tries} pairs of directions"
    return f"of {tries} pairs of directions {inside} are in domain and {smooth} are {MARGIN} from a kink by kink_distance, none is both"


def probes(subject: Any, rng: torch.Generator, count: int) -> Iterator[Probe]:
    """The functions through which a value is seen: ``evaluate``, each delta lobe's sample weight, ``reflectance``."""
    if isinstance(subject, Fresnel):
        cos = MARGIN + (1.0 - 2.0 * MARGIN) * torch.rand(64 * count, generator=rng, dtype=torch.float64)
        smooth = subject.kink_distance(Layout.beside(cos), cos) > MARGIN
        if not bool(smooth.any()):
            raise ValueError(f"kink_distance is below {MARGIN} at all of {len(cos)} cosines")
        yield Probe("reflectance", lambda v, cos_i: v.reflectance(cos_i), {"cos_i": cos[smooth][:count].unsqueeze(-1)})
        return
    if spread(subject) is not None:
        yield Probe("evaluate", lambda v, wi, wo, n: v.evaluate(wi, wo, n), smooth_points(subject, rng, count))
    delta = subject.select(DELTA)
    if delta is not None and len(delta.lobes) == 1:
        w = smooth_points(delta, rng, count)
        yield Probe("sample", _delta_weight, {"wo": w["wo"], "n": w["n"]})


def calls(subject: Any, rng: torch.Generator, count: int) -> Iterator[Probe]:
    """What else must not depend on how arguments are shaped: samples, their density, the albedo."""
    if not isinstance(subject, Bsdf):
        return
    frame = Frame.from_normal(directions(count, rng))
    w = {"wo": frame.to_world(viewers(subject, count, rng)), "n": frame.normal}
    yield Probe("sample", _everything, w | {"u": uniform(count, rng)})
    yield Probe("pdf", lambda v, wo, n, wi: v.pdf(wi, wo, n), w | {"wi": frame.to_world(viewers(subject, count, rng))})
    yield Probe("directional_albedo", lambda v, wo, n: v.directional_albedo(wo, n, order=4), w)


def _everything(bsdf: Bsdf, wo: Tensor, n: Tensor, u: Tensor) -> Tensor:
    s = bsdf.sample(wo, u, n)
    return torch.cat([s.wi, s.weight, s.pdf, s.lobe.to(s.pdf.dtype), s.eta], -1)


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

    def vary(held: Any) -> Any:
        return tuple(map(vary, held)) if isinstance(held, tuple) else batched(held, count, rng) if isinstance(held, Value) else held

    changed = {name: _neighbours(t, spec, count, rng) for name, t, spec in value.own_tensors()}
    return value.replace(**{name: vary(getattr(value, name)) for name in value._fields if name not in value._params}, **changed)


def _neighbours(t: Tensor, spec: Param, count: int, rng: torch.Generator) -> Tensor:
    """A parameter ``[*event]`` as legal ones ``[count, *event]``: numbers up to a tenth smaller, others moved as in learning."""
    if not t.is_floating_point():
        return t.expand(count, *t.shape)
    noise = torch.rand(count, *t.shape, generator=rng, dtype=t.dtype)
    if not isinstance(spec.constraint, Interval):
        return spec.constraint.from_unconstrained(spec.constraint.to_unconstrained(t) + 0.1 * noise)
    return torch.where(spec.constraint.contains(t * (1.0 - 0.1 * noise)), t * (1.0 - 0.1 * noise), t)
