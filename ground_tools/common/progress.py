"""How far a long computation is, on stderr and only where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress


@contextmanager
def progress(words: str, steps: int) -> Iterator[Callable[[], None]]:
    """Gives the function to call after each step."""
    shown = Progress(
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
        # Otherwise what is printed meanwhile would leave by stderr too.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    with shown:
        task = shown.add_task(words, total=steps)
        yield lambda: shown.advance(task)
