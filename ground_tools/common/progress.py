"""A progress bar for long computations, on stderr and only if stderr is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

from rich.console import Console
from rich.progress import Progress


@contextmanager
def progress(words: str, steps: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar. Yields the function to call after each step."""
    shown = Progress(
        console=Console(stderr=True),
        transient=True,
        # Otherwise output printed meanwhile would go to stderr too.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    # A bar that is only disabled prints an empty line (rich before 14.3).
    with shown if sys.stderr.isatty() else nullcontext():
        task = shown.add_task(words, total=steps)
        yield lambda: shown.advance(task)
