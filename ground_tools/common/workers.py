"""Work in parallel processes that can be interrupted with Ctrl-C and keeps finished results."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Final, TypeVar

from rich.console import Console

from companion.errors import ConfigError
from sitl_mocks.worker_pool import interrupts_held, worker_pool

Item = TypeVar("Item")
Result = TypeVar("Result")
Outcome = TypeVar("Outcome")
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
    with _pool(min(processes, len(items)), words) as pool:
        with interrupts_held():
            futures = {pool.submit(function, item): item for item in items}
        for future in as_completed(futures):
            result = future.result()
            with interrupts_held():
                yield futures.pop(future), result


def rounds_in_parallel(
    function: Callable[[Item], Result],
    works: Sequence[Generator[list[Item], list[Result], Outcome]],
    processes: int,
    words: Console,
) -> Iterator[tuple[int, Outcome]]:
    """Run several works in parallel that proceed in rounds. Yields the index and the outcome of each work as
    it ends.

    Args:
        function: The work for one item, a top-level function of a module.
        works: Generators. Each yields the items of its next round, receives their results in the same order,
            and returns its outcome. All share the workers, so one work may use several.
        processes: Number of worker processes; with 1, everything runs in this one.
        words: Console for the message about Ctrl-C.

    Raises:
        ConfigError: A worker was killed from outside.
    """
    if processes <= 1:
        for number, work in enumerate(works):
            yield number, _alone(function, work)
        return
    with _pool(processes, words) as pool:
        rounds: dict[int, list[Future[Result]]] = {}
        waiting: set[Future[Result]] = set()
        ready: list[tuple[int, list[Result] | None]] = [(number, None) for number in range(len(works))]
        while ready or waiting:
            for number, results in ready:
                try:
                    items = next(works[number]) if results is None else works[number].send(results)
                except StopIteration as end:
                    rounds.pop(number, None)
                    with interrupts_held():
                        yield number, end.value
                    continue
                with interrupts_held():
                    rounds[number] = [pool.submit(function, item) for item in items]
                waiting.update(rounds[number])
            if waiting and all(rounds.values()):
                waiting = wait(waiting, return_when=FIRST_COMPLETED).not_done
            ready = [
                (number, [future.result() for future in futures])
                for number, futures in sorted(rounds.items())
                if all(future.done() for future in futures)
            ]


def _alone(function: Callable[[Item], Result], work: Generator[list[Item], list[Result], Outcome]) -> Outcome:
    """Run one work in this process."""
    try:
        items = next(work)
        while True:
            items = work.send([function(item) for item in items])
    except StopIteration as end:
        outcome: Outcome = end.value
        return outcome


@contextmanager
def _pool(processes: int, words: Console) -> Iterator[ProcessPoolExecutor]:
    """A worker pool that tells what is kept when it is interrupted or a worker is killed."""
    with worker_pool(processes) as pool:
        try:
            yield pool
        except BrokenProcessPool as error:
            raise ConfigError(
                "a worker process was killed (out of memory?); with --out, finished flights are kept and the "
                "same command continues from them; fewer processes need less memory"
            ) from error
        except KeyboardInterrupt:
            words.print(_INTERRUPTED)
            raise
