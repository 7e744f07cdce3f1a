"""Write docs/models.md and docs/api.md from what the code declares.

    python docs/make_tables.py            # after a model or a public name was added or changed
    python docs/make_tables.py --check    # say whether they are up to date, and write nothing

Formulas, albedos, non-smooth points and sources are the docstrings of the models; ranges and shapes are their ``param``
declarations. Nothing of it is typed twice.
"""

import argparse
import dataclasses
import importlib
import inspect
import sys
from pathlib import Path
from typing import Any

import torchbrdf
from torchbrdf.bsdf.base import ALBEDO_ORDER, Bsdf
from torchbrdf.registry import BSDFS, FRESNEL_TERMS, registered
from torchbrdf.testing.instances import of_class

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import rst  # noqa: E402

NOTICE = "<!-- Written by docs/make_tables.py from the code: change the docstrings and declarations there, then run it. -->"
MODELS_HEAD = (
    "# Models\n\n"
    "Choose a reflection model or a Fresnel term here: each with its formula, its parameters and their ranges, its directional albedo, "
    "where it is not smooth, and its source.\n\n"
    'Every parameter is a pure number, but for Phong\'s `specular` with `normalization="none"`, which is then in 1/sr. '
    "`[..., C]` is a colour (any number of channels), `[..., 1]` a scalar; `...` are batch axes, which broadcast with those of the "
    "points. Ranges are checked by `tb.validate`, `tb.plan` and `tb.shade`. *Drawn from* is where tests take typical values; at the "
    "values of *hard cases* the contract asks for finite values and gradients.\n\n"
    "`evaluate` is f in 1/sr without the cosine, and 0 unless both directions are strictly above the horizon: every model jumps "
    "there, and derivatives are claimed above it. Which directions, normals and index of refraction are meant is said in "
    "[conventions](conventions.md), what happens at the edges in [numerics](numerics.md)."
)
API_HEAD = (
    "# Public names\n\n"
    "Look up here the signature and the documentation of every `tb.<name>`; each is imported when it is first used. Names for those who "
    "extend it (the decorator `value`, the parts of `bsdf.base`) are imported from their modules, see [extending](extending.md): "
    "`tb.value` is the module `torchbrdf.value`, not the decorator."
)


def models() -> str:
    """The text of models.md."""
    terms, bsdfs = registered(FRESNEL_TERMS), registered(BSDFS)
    parts = [NOTICE, MODELS_HEAD, "## Reflection models at a glance", overview(bsdfs), "## Reflection models"]
    parts += sections(bsdfs)
    parts += ["## Fresnel terms", *sections(terms)]
    return "\n\n".join(parts) + "\n"


def overview(classes: tuple[type[Any], ...]) -> str:
    """One row a model, from its declarations."""
    rows = [["model", "formula", "parameters", "lobes", "directional albedo", "reciprocal"]]
    for cls in classes:
        parameters = ", ".join(f"`{n}` in {p.constraint}" for n, p in cls.params().items())
        lobes = "those of its parts" if is_of_parts(cls) else ", ".join(lobe.label for lobe in lobes_of(cls))
        reciprocal = "if its parts are" if isinstance(cls.reciprocal, property) else "yes" if cls.reciprocal else "no"
        rows.append(
            [
                f"[`{cls.__name__}`](#{cls.__name__.lower()})",
                f"${own_formula(cls)}$",
                parameters or "none of its own",
                lobes,
                albedo_of(cls),
                reciprocal,
            ]
        )
    return rst.as_table(rows)


def albedo_of(cls: type[Any]) -> str:
    """How a class comes by its directional albedo."""
    if is_of_parts(cls):
        return "from its parts"
    by_quadrature = "quadrature" in f"{cls.albedo_at.__doc__}"
    closed = ("albedo_at" in vars(cls) and not by_quadrature) or all(lobe.is_delta for lobe in lobes_of(cls))
    return "in closed form" if closed else f"by quadrature, {ALBEDO_ORDER} x {ALBEDO_ORDER} nodes"


def is_of_parts(cls: type[Any]) -> bool:
    """Whether a class is made of models of any kind, and has the lobes that they have."""
    return "may_hold" not in vars(cls) and any(isinstance(v, Bsdf) for v in next(of_class(cls))[1].nested())


def lobes_of(cls: type[Any]) -> tuple[Any, ...]:
    """Those of a class, or where its static choices decide, of its first variant."""
    found: tuple[Any, ...] = next(of_class(cls))[1].lobes if isinstance(cls.lobes, property) else cls.lobes
    return found


def own_formula(cls: type[Any]) -> str:
    """The formula of a class: that of its own docstring, else that of its module's."""
    own, shared = (inspect.cleandoc(text or "") for text in (cls.__doc__, module_of(cls).__doc__))
    return rst.formula(own) or rst.formula(shared)


def sections(classes: tuple[type[Any], ...]) -> list[str]:
    """A section for each model; the docstring of a module that several share comes before the first of them."""
    made, seen = [], set()
    for cls in classes:
        module = module_of(cls)
        shared = sum(module_of(other) is module for other in classes) > 1
        if shared and module.__name__ not in seen:
            made.append(rst.to_markdown(inspect.cleandoc(module.__doc__ or "")))
        seen.add(module.__name__)
        text = cls.__doc__ if shared else module.__doc__
        made += [f"### {cls.__name__}", rst.to_markdown(inspect.cleandoc(text or ""), drop="parameter"), parameter_table(cls)]
        made.append(f"Code: `{path_of(module)}`")
    return made


def parameter_table(cls: type[Any]) -> str:
    """Every field of a model: parameters with shape and range, then the static choices."""
    rows = [["field", "shape, legal range", "meaning", "drawn from", "hard cases"]]
    for field in dataclasses.fields(cls):
        if field.name not in cls.params():
            rows.append([f"`{field.name}`", kind_of(field), "", "", ""])
            continue
        spec = cls.params()[field.name]
        shape = f"`{spec.shape}` in {spec.constraint}"
        drawn = "" if spec.constraint.typical is None else "{:g} to {:g}".format(*spec.constraint.typical)
        hard = ", ".join(f"{x:.7g}" for x in sorted(set(spec.constraint.extremes())))
        default = "" if field.default is dataclasses.MISSING else f"; default {field.default}"
        rows.append([f"`{field.name}`", shape, f"{spec.doc}{default}", drawn, hard])
    return rst.as_table(rows)


def kind_of(field: dataclasses.Field[Any]) -> str:
    """Type and default of a field that is no parameter."""
    kind = field.type if isinstance(field.type, str) else inspect.formatannotation(field.type).replace("torchbrdf.", "")
    kind = ".".join(kind.split(".")[-1:]) if "[" not in kind else kind.replace("bsdf.base.", "").replace("optics.fresnel.", "")
    return f"`{kind}`" + ("" if field.default is dataclasses.MISSING else f", default `{field.default!r}`")


def module_of(cls: type[Any]) -> Any:
    """The module that a class is written in."""
    return importlib.import_module(cls.__module__)


def path_of(module: Any) -> str:
    """The module's file, from the root of the project."""
    return module.__name__.replace(".", "/") + ".py"


def api() -> str:
    """The text of api.md: every public name, in the order of the face."""
    parts = [NOTICE, API_HEAD]
    for home, names in torchbrdf._HOME.items():
        parts.append(f"## torchbrdf.{home}")
        parts += [f"::: torchbrdf.{home}.{name}" for name in names]
    parts += ["## Models and Fresnel terms", "Described in [models](models.md)."]
    parts += [f"::: torchbrdf.{home}.{name}" for name, home in (BSDFS | FRESNEL_TERMS).items()]
    for module in torchbrdf._MODULES.values():
        names = importlib.import_module(f"torchbrdf.{module}").__all__
        parts += [f"## torchbrdf.{module}", *(f"::: {where(module, name)}" for name in names)]
    return "\n\n".join(parts) + "\n"


def where(module: str, name: str) -> str:
    """The path at which a name of a module is written (its documentation is read without importing)."""
    found = getattr(importlib.import_module(f"torchbrdf.{module}"), name)
    return f"{getattr(found, '__module__', f'torchbrdf.{module}')}.{name}"


PAGES = {"models.md": models, "api.md": api}


def main() -> int:
    """Write, or check, the pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    stale = [name for name, make in PAGES.items() if not (HERE / name).is_file() or (HERE / name).read_text() != make()]
    if parser.parse_args().check:
        print("\n".join(f"docs/{name} is not up to date: run python docs/make_tables.py" for name in stale) or "up to date")
        return bool(stale)
    for name in stale:
        (HERE / name).write_text(PAGES[name]())
        print(f"wrote docs/{name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
