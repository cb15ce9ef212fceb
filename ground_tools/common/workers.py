"""Work in parallel processes that ends at Ctrl-C and keeps what is done."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from rich.console import Console

from companion.errors import ConfigError

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    function: Callable[[Item], Result], items: Sequence[Item], processes: int, words: Console
) -> Iterator[tuple[Item, Result]]:
    """Each item with its result as soon as it is there, in the order in which they come.

    Args:
        function: of a module's top level; runs in processes of their own.
        words: where it is said that Ctrl-C ended it.

    Raises:
        ConfigError: a worker was killed from outside.
    """
    if not items:
        return
    context = multiprocessing.get_context("spawn")
    ignored = (signal.SIGINT, signal.SIG_IGN)
    with ProcessPoolExecutor(min(processes, len(items)), context, signal.signal, ignored) as pool:
        try:
            futures = {pool.submit(function, item): item for item in items}
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        except BrokenProcessPool as error:
            raise ConfigError(
                "a worker process was killed (out of memory?); what was flown is kept, and the same command "
                "goes on from there, with fewer --processes if need be"
            ) from error
        except BaseException as error:
            # The workers do not hear Ctrl-C, and the pool would wait for what is left.
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            if isinstance(error, KeyboardInterrupt):
                words.print("interrupted; what was flown is kept, and the same command goes on from there")
            raise
