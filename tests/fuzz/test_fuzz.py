"""A short run of the fuzzer, what readers remember, and work that grows no faster than the input."""

from __future__ import annotations

import gc
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any, SupportsIndex

import pytest

from companion.errors import PeerDataError
from tests.fuzz import run, targets
from tests.fuzz.mutate import Mutator
from tests.fuzz.seeds import Target
from tests.fuzz.targets import makers

NAMES = list(makers())
INPUTS = 300
SLACK = 2500
"""Lines or bytes: readers stop early, or not, at limits between the sizes."""


def the(name: str) -> Target:
    return makers()[name]()


def test_nothing_but_peer_data_error_comes_out_of_a_reader() -> None:
    block = run.run_block(seed=7, number=0, inputs=INPUTS)
    assert [finding.error for finding in block.findings] == []
    assert block.payloads == INPUTS * len(NAMES)
    # A reader that takes all or nothing is not being tested.
    assert {name for name in NAMES if 0 < block.taken[name] < INPUTS} == set(NAMES)


def test_a_block_comes_back_the_same() -> None:
    first, again = (run.run_block(seed=9, number=3, inputs=50) for _ in range(2))
    assert first.taken == again.taken
    other = run.run_block(seed=9, number=4, inputs=50)
    assert first.taken != other.taken


@pytest.mark.parametrize("name", NAMES)
def test_a_reader_does_not_grow(name: str) -> None:
    target = the(name)
    mutator = Mutator(Random(name), target.seeds)
    # Everything that the process holds by now would be looked through by each of the collections below.
    gc.collect()
    gc.freeze()

    def growth() -> float:
        """Bytes gained per input, over some hundred."""
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(300):
            target.feed(mutator.draw())
        gc.collect()
        return (tracemalloc.get_traced_memory()[0] - before) / 300

    tracemalloc.start()
    try:
        # Tables fill up to their bounds, and then no more; keeping a word of each input never settles.
        settled = any(growth() < 32 for _ in range(33))
    finally:
        tracemalloc.stop()
    target.check()
    assert settled


# ---------------------------------------------------------------- work, counted


class Counted(bytes):
    """Bytes that count how many of them are copied by slicing."""

    copied = 0

    def __getitem__(self, key: SupportsIndex | slice) -> Any:
        result = super().__getitem__(key)
        if isinstance(result, bytes):
            Counted.copied += len(result)
            return Counted(result)
        return result


def work(feed: Callable[[bytes], bool], data: bytes) -> tuple[int, int]:
    """Lines executed, and bytes copied by slicing, over one input."""
    lines = 0

    def trace(_frame: FrameType, event: str, _argument: object) -> Any:
        nonlocal lines
        lines += event == "line"
        return trace

    Counted.copied = 0
    previous = sys.gettrace()
    sys.settrace(trace)
    try:
        feed(Counted(data))
    finally:
        sys.settrace(previous)
    return lines, Counted.copied


def attacks(target: Target) -> Iterator[Callable[[int], bytes]]:
    """Shapes of input, of any size: one byte over and over, alone or behind the start of a sound input."""
    seed = max(target.seeds, key=len)
    for byte in (0x00, 0x01, 0x04, 0xDD, 0xFD, 0xFE, 0xFF):
        yield lambda size, byte=byte: bytes((byte,)) * size  # type: ignore[misc]
        for start in (4, 30, 36, len(seed)):
            yield lambda size, byte=byte, start=start: seed[:start] + bytes((byte,)) * size  # type: ignore[misc]
    yield lambda size: seed * (size // len(seed))
    yield lambda size: (seed[: len(seed) // 2]) * (2 * size // len(seed))


@pytest.mark.parametrize("name", NAMES)
def test_work_grows_no_faster_than_the_input(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(targets, "_record", lambda *_, **__: None)  # a record takes no bytes but plain ones
    worked = False
    for attack in attacks(the(name)):
        # From 1000 to 2000 bytes, and from 2000 to 4000: twice the step may cost twice as much.
        costs = [work(the(name).feed, attack(size)) for size in (1000, 2000, 4000)]
        worked = worked or costs[0] > (0, 0)
        for small, middle, large in zip(*costs, strict=True):
            assert large - middle <= 2.2 * max(0, middle - small) + SLACK, attack(40).hex()
    assert worked


def test_the_count_of_work_sees_a_quadratic_reader() -> None:
    def rescans(data: bytes) -> bool:
        while data:
            data = data[1:]
        return True

    def looks_back(data: bytes) -> bool:
        return all(sum(1 for at in range(end) if data[at] != 7) >= 0 for end in range(0, len(data), 20))

    for feed, count in ((rescans, 1), (looks_back, 0)):
        small, middle, large = (work(feed, bytes(size))[count] for size in (1000, 2000, 4000))
        assert large - middle > 2.2 * (middle - small) + SLACK


# ---------------------------------------------------------------- the fuzzer itself


def planted(data: bytes) -> bool:
    if len(data) < 3:
        raise PeerDataError("short")
    return data[1] / (data[2] ^ 0x80) >= 0  # ZeroDivisionError at one byte


def test_a_planted_fault_is_found_written_down_and_comes_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def feed(data: bytes) -> bool:
        try:
            return planted(data)
        except PeerDataError:
            return False

    monkeypatch.setattr(run, "make_targets", lambda: [Target("planted", [bytes(range(9))], feed)])
    monkeypatch.setattr(run, "INPUTS", 50_000)
    finding = run.run_block(5, 2, 50_000).findings[0]
    assert "ZeroDivisionError" in finding.error
    assert run.main(["--seed", "5", "--block", "2", "--findings", str(tmp_path)]) == 1
    (written,) = tmp_path.iterdir()
    text = written.read_text()
    assert finding.data.hex() in text
    assert "--seed 5 --block 2" in text
    assert "ZeroDivisionError" in capsys.readouterr().out


def test_a_reader_that_keeps_a_word_of_each_input_is_seen() -> None:
    kept: list[int] = []
    tracemalloc.start()
    kept += [number * 1000 for number in range(1000)]
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown >= 32 * 1000


def test_what_a_reader_remembers_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[bytes] = []

    def feed(data: bytes) -> bool:
        kept.append(data)
        return True

    def check() -> None:
        assert len(kept) <= 10, "keeps everything"

    monkeypatch.setattr(run, "make_targets", lambda: [Target("hoarder", [b"seed"], feed, check)])
    assert "keeps everything" in run.run_block(1, 0, 20).findings[0].error


def test_the_command_runs_in_several_processes_and_gives_a_verdict(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.fuzz.run", "--payloads", "1000", "--seed", "1"]
    done = subprocess.run(
        [*command, "--findings", str(tmp_path)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 findings" in done.stdout
    assert "nothing found" in done.stdout
    assert list(tmp_path.iterdir()) == []
