"""The contract notices what it claims to notice: every fault by its named property, every property by some fault."""

import pytest
from faults import FAULTS

from torchbrdf.testing import PROPERTIES, run
from torchbrdf.testing.subject import generator, materials

BY_NAME = {p.__name__: p for p in PROPERTIES}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f"{f.name} - {f.broken_by}")
def test_fault_is_noticed(fault, monkeypatch):
    prop = BY_NAME[fault.broken_by]
    (subject,) = materials(fault.subject(), generator(0), 1)
    if fault.broken_by != "compiles":  # that the sound model compiles is a test of its own, and costs a compilation
        assert run(prop, subject).ok, "the property must hold before the fault"
    fault.apply(monkeypatch)
    (broken,) = materials(fault.subject(), generator(0), 1)
    outcome = run(prop, broken)
    assert outcome.ok is False, outcome


def test_every_property_is_killed():
    assert {f.broken_by for f in FAULTS} == set(BY_NAME)


def test_enough_faults():
    assert len({f.name for f in FAULTS}) >= 12
