"""PyTorch as everything here uses it; where it is missing, what to do about it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from companion.errors import ConfigError


@contextmanager
def needs_torch() -> Iterator[None]:
    """Around the imports that need PyTorch or what comes with it.

    Raises:
        ConfigError: something of it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{error.name} is not installed; in the checkout: pip install -e '.[train]'"
        ) from error


def set_up_torch() -> None:
    """One thread, since two are slower on networks of this size, and denormal numbers as 0: weights of
    far-off pairs and what is learned from them are tiny, and denormals slow.

    Raises:
        ConfigError: it is not installed.
    """
    with needs_torch():
        import torch
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
