"""Shared fixtures and settings: determinism, one thread a worker, and the real data that lies beside a checkout."""

import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is loaded; processes that a test starts keep to it, too

import hypothesis
import pytest
import torch

hypothesis.settings.register_profile("the same everywhere", derandomize=True, database=None, deadline=None)
hypothesis.settings.load_profile("the same everywhere")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure() -> None:
    """Tensors of tests are small: each worker is quickest on a core of its own."""
    torch.set_num_threads(1)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """A single test that was asked for runs in this process, where a debugger finds it; else xdist counts the cores."""
    return 0 if config.args and all("::" in arg for arg in config.args) else None


def pytest_collectstart() -> None:
    """What a module draws while it is loaded is the same in every worker."""
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.fixture
def shared_data() -> Path:
    """The folder of real meshes, images and tables; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip(f"the shared data folder is absent: {SHARED.name} is expected beside the checkout's parent")
    return SHARED
