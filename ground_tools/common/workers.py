"""Work in parallel processes that can be interrupted with Ctrl-C and keeps finished results."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Final, TypeVar

from rich.console import Console

from companion.errors import ConfigError

Item = TypeVar("Item")
Result = TypeVar("Result")
_INTERRUPTED: Final = "Interrupted. With --out, finished flights are kept and the same command continues."


def in_parallel(
    function: Callable[[Item], Result], items: Sequence[Item], processes: int, words: Console
) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result, in the order in which they finish.

    Args:
        function: The work for one item, a top-level function of a module. It runs in worker processes, or in
            this one where a single worker would do all the work.
        items: The items.
        processes: Greatest number of worker processes.
        words: Console for the message about Ctrl-C.

    Raises:
        ConfigError: A worker was killed from outside.
    """
    if min(processes, len(items)) <= 1:
        try:
            for item in items:
                yield item, function(item)
        except KeyboardInterrupt:
            words.print(_INTERRUPTED)
            raise
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
                "a worker process was killed (out of memory?); with --out, finished flights are kept and the "
                "same command continues from them; fewer --processes need less memory"
            ) from error
        except BaseException as error:
            # The workers ignore Ctrl-C, and the pool would wait for the remaining items.
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            if isinstance(error, KeyboardInterrupt):
                words.print(_INTERRUPTED)
            raise
