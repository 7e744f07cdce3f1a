"""``check``: a material against every property of the contract, and its report."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..bsdf.base import Bsdf
from ..optics.fresnel import Fresnel
from ..value import validate
from .borders import dark_outside_domain, delta_lobes
from .compiled import compiles
from .energy import albedo, energy_bound, lambert
from .gradients import gradients, second_gradients
from .hard_cases import hard_cases
from .layout import broadcasting, dtypes, planar_memory, vmap
from .reciprocity import reciprocity
from .sampling import pdf_integrates_to_one, samples_follow_pdf
from .subject import Outcome, generator, materials
from .textbook import textbook
from .weights import mean_weight, weights_match

Property = Callable[..., Outcome]

PROPERTIES: tuple[Property, ...] = (
    gradients,
    second_gradients,
    textbook,
    reciprocity,
    energy_bound,
    albedo,
    lambert,
    pdf_integrates_to_one,
    samples_follow_pdf,
    weights_match,
    mean_weight,
    dark_outside_domain,
    delta_lobes,
    broadcasting,
    planar_memory,
    dtypes,
    vmap,
    hard_cases,
    compiles,
)
MARKS = {True: "ok", False: "FAILED", None: "-"}


@dataclasses.dataclass(frozen=True)
class Report:
    """What :func:`check` found."""

    subject: Any
    outcomes: tuple[Outcome, ...]

    @property
    def ok(self) -> bool:
        """Whether every property that applies holds."""
        return all(o.ok is not False for o in self.outcomes)

    @property
    def failed(self) -> tuple[str, ...]:
        """The names of the properties that do not hold."""
        return tuple(o.name for o in self.outcomes if o.ok is False)

    def __str__(self) -> str:
        rows = [(o.name, MARKS[o.ok], "" if o.figure is None else f"{o.figure:.3g}", o.detail) for o in self.outcomes]
        lines = [f"{name:<22} {mark:<7} {figure:>9}  {detail}" for name, mark, figure, detail in rows]
        verdict = "holds" if self.ok else f"is broken: {', '.join(self.failed)}"
        return "\n".join([repr(self.subject), *lines, f"The contract {verdict}."])

    def save_picture(self, path: str | Path) -> None:
        """Draw the directional albedo over the angle, against its bound, and samples against their density."""
        from .picture import save

        save(self.subject, path)


def check(subject: Any, *, seed: int = 0, thorough: bool = False, compiled: bool | str = False) -> Report:
    """Check a BSDF or Fresnel term, at its own parameters; of a batch, up to three materials drawn at random.

    ``thorough`` takes more points; ``compiled`` also compiles it (seconds to a minute), by inductor or by the backend named:
    ``"aot_eager"`` only traces, forward and backward, in a second or two. Raises ``ValueError`` for parameters
    out of their range, ``TypeError`` for anything but a BSDF or Fresnel term.
    """
    if not isinstance(subject, Bsdf | Fresnel):
        raise TypeError(f"check: expected a BSDF or a Fresnel term, found {type(subject).__name__}")
    validate(subject)
    singles = materials(subject, generator(seed), 3)
    properties = [p for p in PROPERTIES if compiled or p is not compiles]
    options = {compiles: {"backend": compiled}} if isinstance(compiled, str) else {}
    return Report(subject, tuple(_worst([run(p, s, seed, thorough, **options.get(p, {})) for s in singles]) for p in properties))


def run(prop: Property, single: Any, seed: int = 0, thorough: bool = False, **options: Any) -> Outcome:
    """One property of one unbatched float64 material. A model that raises does not have the property. ``options`` are the property's."""
    try:
        return prop(single, generator(seed), thorough, **options)
    except Exception as error:
        return Outcome(prop.__name__, False, None, f"raised {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}")


def _worst(outcomes: list[Outcome]) -> Outcome:
    """The first that failed; else the one with the largest figure of those that apply."""
    failed = [o for o in outcomes if o.ok is False]
    held = sorted((o for o in outcomes if o.ok), key=lambda o: o.figure or 0.0)
    return failed[0] if failed else held[-1] if held else outcomes[0]
