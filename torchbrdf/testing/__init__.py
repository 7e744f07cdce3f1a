"""The contract: what every reflection model and Fresnel term must keep, with :func:`check` to test yours by it, too.

>>> import torchbrdf as tb
>>> report = tb.testing.check(tb.Lambert([0.5, 0.4, 0.3]))
>>> report.ok
True

``print(report)`` is a table of properties, figures and verdicts; ``report.save_picture(path)`` draws the albedo against its
bound and the samples against their density. Each property is a function ``prop(subject, rng, thorough) -> Outcome`` in a
file of this folder, and works on any subclass of :class:`torchbrdf.Bsdf` or :class:`torchbrdf.Fresnel`.
"""

from .instances import instances
from .report import PROPERTIES, Report, check, run
from .subject import Outcome

__all__ = ["PROPERTIES", "Outcome", "Report", "check", "instances", "run"]
