"""`python -m tests.fuzz.run`: every reader of bytes from others against damaged ones, by the million.

Inputs are drawn in numbered blocks, each from its own seed and with readers fresh in it, so that a finding
comes back with `--seed SEED --block NUMBER`. Exit status: 0 nothing found, 1 a finding, 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import faulthandler
import math
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from tests.fuzz.mutate import Mutator
from tests.fuzz.seeds import Target
from tests.fuzz.targets import make_targets

INPUTS = 2000
"""Inputs for each reader in a block."""
GROWTH_KIB = 64 * 1024
"""A process that grows by more after its first blocks keeps what it should forget."""
_SETTLED_BLOCKS = 10
_HANGS_S = 300.0
"""A block takes a second or two."""
_SAY_EVERY_S = 15.0


@dataclass(frozen=True)
class Finding:
    """An input that a reader did not survive."""

    target: str
    block: int
    index: int
    data: bytes
    error: str


@dataclass
class Block:
    """What became of one block."""

    number: int
    taken: Counter[str] = field(default_factory=Counter)
    """Inputs of which something was read, by reader."""
    payloads: int = 0
    findings: list[Finding] = field(default_factory=list)
    process: int = 0
    memory_kib: int = 0
    """Most that the process ever held."""


def run_block(seed: int, number: int, inputs: int = INPUTS) -> Block:
    """Feed every reader `inputs` inputs."""
    block = Block(number)
    for target in make_targets():
        _feed(target, Random(f"{seed}/{number}/{target.name}"), inputs, block)
    block.process = os.getpid()
    block.memory_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return block


def _feed(target: Target, random: Random, inputs: int, block: Block) -> None:
    mutator = Mutator(random, target.seeds)
    fed, data = 0, b""
    try:
        while fed < inputs:
            data = mutator.draw()
            block.taken[target.name] += target.feed(data)
            fed += 1
        target.check()
    except Exception:
        block.findings.append(Finding(target.name, block.number, fed, data, traceback.format_exc()))
    block.payloads += fed


def _work(job: tuple[int, int]) -> Block:
    faulthandler.dump_traceback_later(_HANGS_S / 2)
    try:
        return run_block(*job)
    finally:
        faulthandler.cancel_dump_traceback_later()


class Campaign:
    """Blocks of many processes, summed up."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed, self.folder = seed, folder
        self.began_s = self._said_s = time.monotonic()
        self.payloads = 0
        self.found = 0
        self.taken: Counter[str] = Counter()
        self._blocks: Counter[int] = Counter()
        self._settled_kib: dict[int, int] = {}
        self.growth_kib = 0

    def add(self, block: Block) -> None:
        """Count a block, write down what it found."""
        self.payloads += block.payloads
        self.taken += block.taken
        for finding in block.findings:
            self._write(finding)
        self._blocks[block.process] += 1
        if self._blocks[block.process] == _SETTLED_BLOCKS:
            self._settled_kib[block.process] = block.memory_kib
        grown = block.memory_kib - self._settled_kib.get(block.process, block.memory_kib)
        self.growth_kib = max(self.growth_kib, grown)
        if time.monotonic() - self._said_s > _SAY_EVERY_S:
            self._said_s = time.monotonic()
            print(self.line(), flush=True)

    def line(self) -> str:
        """Progress."""
        seconds = time.monotonic() - self.began_s
        return (
            f"{self.payloads:,} payloads in {seconds:,.0f} s ({self.payloads / seconds:,.0f}/s), "
            f"{self.found} findings, memory +{self.growth_kib:,} KiB"
        )

    def verdict(self) -> int:
        """Say how it went; the exit status."""
        for name, taken in sorted(self.taken.items()):
            print(f"  {name:20}{taken:14,} read in full or in part")
        print(self.line())
        if self.growth_kib > GROWTH_KIB:
            print(f"FOUND: a process grew by {self.growth_kib:,} KiB; allowed {GROWTH_KIB:,}")
        elif not self.found:
            print("nothing found")
        return 1 if self.found or self.growth_kib > GROWTH_KIB else 0

    def _write(self, finding: Finding) -> None:
        self.found += 1
        self.folder.mkdir(parents=True, exist_ok=True)
        name = f"{finding.target.replace(' ', '-')}-{self.seed}-{finding.block}-{finding.index}.txt"
        text = (
            f"reader {finding.target}, seed {self.seed}, block {finding.block}, input {finding.index}\n"
            f"again: python -m tests.fuzz.run --seed {self.seed} --block {finding.block}\n"
            f"{finding.data.hex()}\n\n{finding.error}"
        )
        (self.folder / name).write_text(text)
        print(f"FOUND: {self.folder / name}\n{finding.error}", flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a campaign."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.run", description=__doc__)
    parser.add_argument("--payloads", type=int, default=1_000_000, help="inputs in all (default 1,000,000)")
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after this long")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--block", type=int, help="run this block alone, in this process")
    parser.add_argument("--findings", type=Path, default=Path("runs/fuzz"), help="folder for what is found")
    arguments = parser.parse_args(argv)
    if arguments.payloads < 1 or arguments.processes < 1 or arguments.seconds <= 0:
        parser.error("--payloads, --processes and --seconds must be above 0")

    campaign = Campaign(arguments.seed, arguments.findings)
    if arguments.block is not None:
        campaign.add(run_block(arguments.seed, arguments.block))
        return campaign.verdict()
    blocks = math.ceil(arguments.payloads / (INPUTS * len(make_targets())))
    jobs = [(arguments.seed, number) for number in range(blocks)]
    ignore_interrupts = (signal.SIGINT, signal.SIG_IGN)
    with multiprocessing.Pool(arguments.processes, signal.signal, ignore_interrupts) as pool:
        results = pool.imap_unordered(_work, jobs)
        while time.monotonic() - campaign.began_s < arguments.seconds:
            try:
                campaign.add(results.next(timeout=_HANGS_S))
            except (StopIteration, KeyboardInterrupt):
                break
            except multiprocessing.TimeoutError:
                print(f"FOUND: no block done for {_HANGS_S:.0f} s: a reader hangs, see the traces above")
                campaign.verdict()
                return 1
    return campaign.verdict()


if __name__ == "__main__":
    sys.exit(main())
