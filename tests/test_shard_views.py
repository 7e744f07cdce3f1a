"""`examples/shard_views.py`: it learns, and two processes that share the views learn what one learns."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SMALL = ["--views", "3", "--size", "24", "--steps", "8", "--eager"]


def test_one_process_learns(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    losses = importlib.import_module("shard_views").main(SMALL)
    assert len(losses) == 8
    assert losses[-1] < 0.7 * losses[0]


def learned(out, *launcher):
    """What a run wrote."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    command = [sys.executable, *launcher, str(EXAMPLES / "shard_views.py"), *SMALL, "--out", str(out)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return torch.load(out)


@pytest.mark.slow  # torchrun starts three interpreters with torch
def test_two_processes_learn_what_one_learns(tmp_path):
    """Three views, so that the shares differ."""
    one = learned(tmp_path / "one.pt")
    two = learned(tmp_path / "two.pt", "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2")
    torch.testing.assert_close(two["losses"], one["losses"], rtol=1e-5, atol=0.0)
    torch.testing.assert_close(two["learned"], one["learned"], rtol=1e-5, atol=1e-5)
    assert set(one["learned"]) == set(two["learned"])
