"""For the tests of training."""

from __future__ import annotations

import pytest
import torch


@pytest.fixture(autouse=True)
def _one_thread():
    """As in training; several are slower on networks of this size."""
    torch.set_num_threads(1)
