"""Campaign of random histories. See the package."""

from __future__ import annotations

import argparse
import multiprocessing
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from companion.config import Config
from companion.gate.gate import Gate
from tests.companion.gate import hostile as package
from tests.companion.gate.hostile.history import AnyGate, History
from tests.companion.gate.hostile.system_history import SystemHistory

_SAY_EVERY_S = 15.0
_BLOCK = 50


@dataclass
class Block:
    """Sums over some histories."""

    histories: int = 0
    commands: int = 0
    setpoints: int = 0
    requests: int = 0
    slowed: int = 0
    near: int = 0
    """Number of histories in which the vehicle came within a metre of a wall, the floor or the ceiling."""
    refused: Counter[str] = field(default_factory=Counter)
    broken: list[tuple[int, str, str]] = field(default_factory=list)
    """Number of the history, name of the rule, text."""


def run_block(
    seed: int,
    first: int,
    count: int,
    commands: int,
    make: Callable[[Config], AnyGate] = Gate,
    kind: type[History] = History,
) -> Block:
    """Run `count` histories from the number `first` on."""
    block = Block()
    for number in range(first, first + count):
        history = kind(seed, number, commands, make)
        oracle = history.run()
        block.histories += 1
        block.commands += commands - history.left
        block.setpoints += oracle.setpoints
        block.requests += oracle.requests
        block.slowed += oracle.slowed
        block.near += history.true and history.nearest < 1.0
        block.refused.update(history.gate.counts)
        block.broken += [(number, rule, words) for rule, words in oracle.found[:3]]
    return block


def _work(job: tuple[int, int, int, int], kind: type[History]) -> Block:
    return run_block(*job, kind=kind)


def _line(total: Block, began_s: float) -> str:
    seconds = time.monotonic() - began_s
    return (
        f"{total.histories:,} histories, {total.commands:,} commands in {seconds:,.0f} s "
        f"({total.commands / seconds:,.0f}/s); left: {total.setpoints:,} setpoints ({total.slowed:,} slowing "
        f"down), {total.requests:,} mode requests; {total.near:,} came within a metre; "
        f"{len(total.broken)} broken"
    )


def _add(total: Block, block: Block) -> None:
    for name in ("histories", "commands", "setpoints", "requests", "slowed", "near"):
        setattr(total, name, getattr(total, name) + getattr(block, name))
    total.refused += block.refused
    for number, rule, words in block.broken:
        if len(total.broken) < 20:
            print(f"BROKEN: history {number}: {rule}: {words}", flush=True)
        total.broken.append((number, rule, words))


def main(argv: Sequence[str] | None = None) -> int:
    """Run a campaign."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.companion.gate.hostile", description=package.__doc__
    )
    parser.add_argument("--histories", type=int, default=1000)
    parser.add_argument("--commands", type=int, default=100, help="in each history (default 100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--history", type=int, metavar="NUMBER", help="repeat this history alone")
    parser.add_argument(
        "--through",
        choices=("gate", "system"),
        default="gate",
        help="what hears the vehicle: the gate alone, or a whole companion (default gate)",
    )
    arguments = parser.parse_args(argv)
    if min(arguments.histories, arguments.commands, arguments.jobs) < 1:
        parser.error("--histories, --commands and --jobs must be above 0")
    kind = SystemHistory if arguments.through == "system" else History
    total, began_s = Block(), time.monotonic()
    said_s = began_s
    if arguments.history is not None:
        _add(total, run_block(arguments.seed, arguments.history, 1, arguments.commands, kind=kind))
    else:
        jobs = [
            (arguments.seed, first, min(_BLOCK, arguments.histories - first), arguments.commands)
            for first in range(0, arguments.histories, _BLOCK)
        ]
        with multiprocessing.Pool(arguments.jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            for block in pool.imap_unordered(partial(_work, kind=kind), jobs):
                _add(total, block)
                if time.monotonic() - said_s > _SAY_EVERY_S:
                    said_s = time.monotonic()
                    print(_line(total, began_s), flush=True)
    for rule, count in sorted(total.refused.items()):
        print(f"  {rule:12}{count:14,} refused")
    print(_line(total, began_s))
    print("a rule was broken" if total.broken else "no rule broken")
    return 1 if total.broken else 0
