"""Work on a Ray cluster that can be interrupted with Ctrl-C and keeps finished results.

Every node needs the same version of this software as the local machine, which is checked before the first
item. ray is an optional dependency and imported on use.
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
from companion.shipped import how_to_install

Item = TypeVar("Item")
Result = TypeVar("Result")

_ANSWER_S: Final = 5.0
"""Time within which the address must accept a connection."""
_LOOK_S: Final = 1.0
_QUEUED: Final = 2
"""Items submitted for each CPU: one that is worked on, one that waits."""
_MOST_LOST: Final = 3
"""Number of lost workers after which an item is given up."""


def on_ray(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    address: str,
    state: Callable[[], str],
    words: Console,
) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result, in the order in which they finish.

    Args:
        function: The work for one item, a top-level function of a module. It runs on one CPU of the cluster.
        items: The items.
        address: HOST:PORT from a machine of the cluster, ray://HOST:PORT from elsewhere.
        state: A top-level function of a module that describes everything on which results depend. It is
            called once on each node before its first item, so it can also compile what `function` calls.
        words: Console for messages about lost workers and about Ctrl-C.

    Raises:
        ConfigError: ray is missing, the cluster does not answer or has another version, a node has other
            software, or one item lost `_MOST_LOST` workers.
    """
    if not items:
        return
    ray = _connect(address)
    try:
        _check_nodes(ray, state)
        yield from _work(ray, ray.remote(max_retries=0)(function), items, words)
    except KeyboardInterrupt:
        words.print("Interrupted. With --out, finished flights are kept and the same command continues.")
        raise
    finally:
        ray.shutdown()  # Ends the remaining tasks of this run.


def _connect(address: str) -> Any:
    """Connect to the cluster. Returns the module `ray`."""
    match = re.fullmatch(r"(?:ray://)?(\[[0-9a-fA-F:.]+\]|[^:/\s]+):([0-9]{1,5})", address)
    if match is None or not 0 < int(match[2]) < 1 << 16:
        raise ConfigError(
            f"--ray: {address} is not allowed; allowed: HOST:PORT or ray://HOST:PORT, such as 10.0.0.5:6379"
        )
    try:
        import ray
    except ImportError as error:
        raise ConfigError(how_to_install("ray", "cluster")) from error
    # By default, ray tries to connect for 15 minutes.
    os.environ.setdefault("RAY_gcs_server_port_wait_time_s", "1")
    try:
        socket.create_connection((match[1].strip("[]"), int(match[2])), _ANSWER_S).close()
    except OSError as error:
        raise ConfigError(f"--ray: {address} does not answer: {error.strerror or error}") from error
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise ConfigError(f"--ray: {address}: {_line(error)}") from error
    return ray


def _check_nodes(ray: Any, state: Callable[[], str]) -> None:
    """Reject a cluster without CPUs, and nodes whose software would give different results."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy as On

    nodes = {node["NodeID"]: node["NodeManagerAddress"] for node in ray.nodes() if _cpus(node)}
    if not nodes:
        raise ConfigError("--ray: the cluster has no node with a CPU")
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
                f"--ray: node {name} has other software ({there}) than this machine ({here}); "
                "install the same version on all nodes"
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
                        "out of memory?); with --out, finished flights are kept and the same command "
                        "continues from them"
                    ) from error
                words.print(f"A worker was lost ({type(error).__name__}). Its flights are repeated.")
                waiting.append((item, lost + 1))
            except errors.RayTaskError as error:
                raise error.cause from None
            else:
                yield item, result


def _cpus(node: dict[str, Any]) -> int:
    return int(node["Resources"].get("CPU", 0)) if node["Alive"] else 0


def _line(error: BaseException) -> str:
    """First line of an error's message."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
