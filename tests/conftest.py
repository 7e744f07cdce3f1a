"""Shared fixtures: determinism, one thread's worth of noise, and the real data that lies beside a checkout."""

from pathlib import Path

import pytest
import torch

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.fixture
def shared_data() -> Path:
    """The folder of real meshes, images and tables; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip(f"the shared data folder is absent: {SHARED.name} is expected beside the checkout's parent")
    return SHARED
