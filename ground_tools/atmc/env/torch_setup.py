"""Common PyTorch setup, and an error message with instructions if PyTorch is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from companion.errors import ConfigError
from companion.shipped import how_to_install


@contextmanager
def needs_torch() -> Iterator[None]:
    """Context for imports of PyTorch and of packages that are installed with it.

    Raises:
        ConfigError: A package is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(how_to_install(str(error.name), "train")) from error


def set_up_torch() -> None:
    """Set PyTorch to one thread and flush denormal numbers to 0.

    Two threads are slower than one on networks of this size. Weights of distant pairs and their gradients are
    tiny, and denormal arithmetic is slow.

    Raises:
        ConfigError: PyTorch is not installed.
    """
    with needs_torch():
        import torch
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
