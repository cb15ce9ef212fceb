"""Work on a Ray cluster that ends at Ctrl-C and keeps what is done.

Every node needs this software as it stands here, which is checked before the first item. ray is an optional
dependency and imported on use.
"""

from __future__ import annotations

import logging
import os
import re
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from rich.console import Console

from companion.errors import ConfigError

Item = TypeVar("Item")
Result = TypeVar("Result")

_ANSWER_S: Final = 5.0
"""Within which the address must take a connection."""
_LOOK_S: Final = 1.0
_QUEUED: Final = 2
"""Items under way for each CPU: one that is worked on, one that waits."""
_MOST_LOST: Final = 3
"""Workers that one item may lose before it is given up."""


def on_ray(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    address: str,
    state: Callable[[], str],
    words: Console,
) -> Iterator[tuple[Item, Result]]:
    """Each item with its result as soon as it is there, in the order in which they come.

    Args:
        function: of a module's top level; runs on one CPU of the cluster.
        address: HOST:PORT from a machine of the cluster, ray://HOST:PORT from elsewhere.
        state: of a module's top level: what results hang on. Asked once on each node, before its first item;
            it is the place to compile what `function` calls.
        words: where lost workers are said, and that Ctrl-C ended it.

    Raises:
        ConfigError: ray is missing, the cluster does not answer or is of another version, a node holds other
            software, or one item lost worker after worker.
    """
    if not items:
        return
    ray = _connect(address)
    try:
        _check_nodes(ray, state)
        yield from _work(ray, ray.remote(max_retries=0)(function), items, words)
    except KeyboardInterrupt:
        words.print("interrupted; what was flown is kept, and the same command goes on from there")
        raise
    finally:
        ray.shutdown()  # ends what this run has under way there


def _connect(address: str) -> Any:
    """The module, connected."""
    match = re.fullmatch(r"(?:ray://)?(\[[0-9a-fA-F:.]+\]|[^:/\s]+):([0-9]{1,5})", address)
    if match is None or not 0 < int(match[2]) < 1 << 16:
        raise ConfigError(f"--ray: {address}: allowed is HOST:PORT or ray://HOST:PORT, such as 10.0.0.5:6379")
    try:
        import ray
    except ImportError as error:
        raise ConfigError("ray is not installed; in the checkout: pip install -e '.[cluster]'") from error
    # ray itself would try for a quarter of an hour.
    os.environ.setdefault("RAY_gcs_server_port_wait_time_s", "1")
    try:
        socket.create_connection((match[1].strip("[]"), int(match[2])), _ANSWER_S).close()
    except OSError as error:
        raise ConfigError(f"--ray: {address}: no answer: {error.strerror or error}") from error
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise ConfigError(f"--ray: {address}: {_line(error)}") from error
    return ray


def _check_nodes(ray: Any, state: Callable[[], str]) -> None:
    """Refuse a cluster without CPUs, and nodes whose results would be others."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy as On

    nodes = {node["NodeID"]: node["NodeManagerAddress"] for node in ray.nodes() if _cpus(node)}
    if not nodes:
        raise ConfigError("--ray: the cluster has no CPU")
    ask = ray.remote(max_retries=_MOST_LOST)(state)
    asked = [ask.options(scheduling_strategy=On(node, soft=False)).remote() for node in nodes]
    here = state()
    for name, answer in zip(nodes.values(), asked, strict=True):
        try:
            there = ray.get(answer)
        except ray.exceptions.RayError as error:
            cause = getattr(error, "cause", None) or error
            raise ConfigError(f"--ray: node {name}: {_line(cause)}") from error
        if there != here:
            raise ConfigError(
                f"--ray: node {name}: other software ({there}; here {here}): install the same there"
            )


def _work(ray: Any, remote: Any, items: Sequence[Item], words: Console) -> Iterator[tuple[Item, Any]]:
    errors = ray.exceptions
    lost_with = (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError,
                 errors.LocalRayletDiedError)  # fmt: skip
    waiting = deque((item, 0) for item in items)
    running: dict[Any, tuple[Item, int]] = {}
    while waiting or running:
        room = _QUEUED * max(1, sum(_cpus(node) for node in ray.nodes()))
        while waiting and len(running) < room:
            item, lost = waiting.popleft()
            running[remote.remote(item)] = item, lost
        done, _ = ray.wait(list(running), timeout=_LOOK_S)
        for answer in done:
            item, lost = running.pop(answer)
            try:
                result = ray.get(answer)
            except lost_with as error:
                if lost + 1 == _MOST_LOST:
                    raise ConfigError(
                        f"--ray: {_MOST_LOST} workers were lost at the same work ({type(error).__name__}; "
                        "out of memory?); what was flown is kept, and the same command goes on from there"
                    ) from error
                words.print(f"a worker was lost ({type(error).__name__}); what it had is flown again")
                waiting.append((item, lost + 1))
            except errors.RayTaskError as error:
                raise error.cause from None
            else:
                yield item, result


def _cpus(node: dict[str, Any]) -> int:
    return int(node["Resources"].get("CPU", 0)) if node["Alive"] else 0


def _line(error: BaseException) -> str:
    """What an error says, in one line."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
