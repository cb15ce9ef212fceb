"""Worker processes that end together with the process that started them, also on Ctrl-C and SIGTERM."""

from __future__ import annotations

import multiprocessing
import platform
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, Final

from companion.errors import ConfigError

_INTERRUPTS: Final = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def worker_pool(
    processes: int, initializer: Callable[..., object] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that ignore Ctrl-C, which a terminal sends to all processes. An exception in the block
    ends them at once, whatever they do; otherwise the block ends when they have done everything.

    Submit work in a block of `interrupts_held`.

    Args:
        processes: Greatest number of worker processes.
        initializer: Function that each worker calls first, with `arguments`.

    Raises:
        ConfigError: A worker was killed from outside, or this version of Python has another pool.
    """
    context = multiprocessing.get_context("spawn")
    with interrupts_held():
        pool = ProcessPoolExecutor(processes, context, _begin, (initializer, arguments))
        results = _results_of(pool)
    with pool:
        try:
            yield pool
        except BrokenProcessPool as error:
            raise ConfigError("a worker process was killed (out of memory?)") from error
        except BaseException:
            # The pool would wait for the remaining work, also if a further Ctrl-C interrupted its end.
            with interrupts_held():
                for child in multiprocessing.active_children():
                    child.terminate()
                # The pool would wait for the rest of a result that a worker was sending.
                results.close()
                # A thread of the pool that still ended at the interpreter's exit would race with it.
                pool.shutdown(wait=True, cancel_futures=True)
            raise


def _results_of(pool: ProcessPoolExecutor) -> Connection:
    """The end of the results' pipe into which workers write. There is no public way to close it.

    Raises:
        ConfigError: This version of Python keeps it elsewhere. A pool that cannot be ended must not begin.
    """
    try:
        writer: Connection = pool._result_queue._writer  # type: ignore[attr-defined]
    except AttributeError as error:
        raise ConfigError(
            f"worker processes cannot be used with Python {platform.python_version()}, because they could "
            f"not be ended safely (concurrent.futures: {error}); use an earlier version of Python"
        ) from error
    return writer


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the end of the block: while queues are made and workers start,
    because an exception in the midst of that would leave one behind, and while a caller stores a result.
    A signal that is ignored stays so."""
    if threading.current_thread() is not threading.main_thread():  # only that one is interrupted
        yield
        return
    pressed: list[int] = []
    heard = [number for number in _INTERRUPTS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, lambda n, _: pressed.append(n)) for number in heard}
    # A worker inherits the mask, so that nothing interrupts it before it can ignore Ctrl-C.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if pressed:
            signal.raise_signal(pressed[0])


def _begin(initializer: Callable[..., object] | None, arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if initializer is not None:
        initializer(*arguments)
