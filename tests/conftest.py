"""Shared fixtures and settings: determinism, one thread a worker, and the real data that lies beside a checkout."""

import os
import re
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is loaded; processes that a test starts keep to it, too

import hypothesis
import pytest
import renders
import torch

hypothesis.settings.register_profile("the same everywhere", derandomize=True, database=None, deadline=None)
hypothesis.settings.load_profile("the same everywhere")


def pytest_configure() -> None:
    """Tensors of tests are small: each worker is quickest on a core of its own."""
    torch.set_num_threads(1)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """A single test that was asked for runs in this process, where a debugger finds it; else xdist counts the cores."""
    return 0 if config.args and all("::" in arg for arg in config.args) else None


# Tests that share a fixture which takes as long as all of them: they run in one worker, every other test by itself.
TOGETHER = [
    re.compile(r"test_docs\.py::test_python_blocks_run"),
    re.compile(r"test_hostile_files\.py::test_(whole_files|every_short_file|damage_ends|a_lie_is|no_code)"),
]


def scope_of(nodeid: str) -> str:
    """What runs in one worker: the same for all tests of a group, else the test's own."""
    return next((group.pattern for group in TOGETHER if group.search(nodeid)), nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Of pytest-xdist, unless ``--dist`` asks for another one. (Its own groups, by marker, do nothing under pytest 9.2.)"""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduler(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return scope_of(nodeid)

    return Scheduler(config, log) if config.getvalue("dist") == "loadscope" else None


def pytest_collectstart() -> None:
    """What a module draws while it is loaded is the same in every worker."""
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What needs more than the repository carries is slow, so that a newcomer's run skips nothing."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def shared_data() -> Path:
    """The folder of whole meshes, images and tables; tests that need it are slow, and skip where it is absent."""
    if not renders.WHOLE.is_dir():
        pytest.skip("the whole renders are absent: a folder shared/data is expected beside the checkout")
    return renders.WHOLE


def _carried_or_whole(request: Any, within: str) -> Path:
    if request.param != "whole":
        return renders.CARRIED / within / request.param
    return request.getfixturevalue("shared_data") / within


SLOWLY = pytest.param("whole", marks=pytest.mark.slow)


@pytest.fixture(params=["", SLOWLY], ids=["carried", "whole"])
def real_data(request: Any) -> Path:
    """The folder of spheres by Blender and Mitsuba, of maps and metals: cut to what tests/data holds, and (slow) whole."""
    return _carried_or_whole(request, "")


@pytest.fixture(params=["tail", "neck", "horns", SLOWLY])
def spot_renders(request: Any) -> Path:
    """A folder with images of the cow and their scene.json, for ``renders.spot``: three windows, and (slow) the whole of it."""
    return _carried_or_whole(request, "spot")


@pytest.fixture(params=["neck", "horns", SLOWLY])
def spot_aovs(request: Any) -> Path:
    """The same where there is an aov.exr."""
    return _carried_or_whole(request, "spot")
