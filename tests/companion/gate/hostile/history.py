"""One history: a random vehicle, a hostile program and the gate between them.

`History` gives the vehicle's events to the gate itself. `SystemHistory` (see `system_history`) gives the
vehicle's bytes to a whole companion, so that it also judges what the companion reports to its gate.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Protocol

import msgspec

from companion.config import Config
from companion.events import CurrentMode, Event, Firmware, Heartbeat
from companion.gate.gate import Gate
from tests.companion.gate.hostile.oracle import ASKED, Oracle
from tests.companion.gate.hostile.program import COMMAND, SETPOINT, HostileProgram


class AnyGate(Protocol):
    """Public methods of the gate that a history uses."""

    counts: Counter[str]

    def hear(self, event: Event, now_s: float) -> None: ...
    def emptied(self, now_s: float) -> None: ...
    def answered(self, asked_s: float, now_s: float) -> None: ...
    def behind(self) -> None: ...
    def decided(self, now_s: float) -> None: ...
    def release(self, data: bytes, now_s: float) -> bytes: ...


class History(HostileProgram):
    """Offers a number of frames to one gate and has the oracle judge what it passes."""

    def __init__(
        self, seed: int, number: int, commands: int, make: Callable[[Config], AnyGate] = Gate
    ) -> None:
        """Draw the history `number` of a seed, which offers `commands` frames."""
        rng = Random(f"{seed}/{number}")
        super().__init__(rng)
        self.left = commands
        self.gate = make(self.config)
        self.pending: list[int] = []
        """Modes that were requested and not entered yet."""
        self.pilot = rng.choice((0.0, 0.01, 0.05, 0.3)) if not self.true else rng.choice((0.0, 0.0, 0.01))
        """Share of steps in which the pilot selects a mode."""
        self.trouble = rng.choice((0.0, 0.005, 0.05)) if not self.true else rng.choice((0.0, 0.0, 0.01))
        """Share of steps in which something rare happens."""
        self.beats = rng.choice((0.2, 0.5, 1.0))
        self.positions = rng.choice((0.2, 0.5, 1.0))
        self.answers = rng.choice((0.0, 0.7, 0.9, 1.0, 1.0))
        """Shares of steps with a heartbeat, with a position and with an answer to a question."""

    # ------------------------------------------------------------ what listens

    def _hear(self, event: Event) -> None:
        self.gate.hear(event, self.now_s)

    def _hear_old(self, event: Heartbeat | CurrentMode) -> None:
        """The link marks it, but not always when the gate itself knows that old messages arrive."""
        if self.now_s >= self.oracle.mixed_until_s or self.rng.random() < 0.5:
            event = msgspec.structs.replace(event, overtaken=True)
        self._hear(event)

    def _emptied(self) -> None:
        self.gate.emptied(self.now_s)
        super()._emptied()

    def _behind(self) -> None:
        self.gate.behind()
        super()._behind()

    def _decided(self) -> None:
        self.gate.decided(self.now_s)
        self.oracle.decided_s = self.now_s

    def _answer(self) -> None:
        """The vehicle answers a question, mostly a new one."""
        rng = self.rng
        asked_s = self.now_s - (rng.uniform(0.0, 0.2) if rng.random() < 0.95 else rng.uniform(0.2, 2.0))
        self.gate.answered(asked_s, self.now_s)
        self.oracle.answered(asked_s, self.now_s)

    def _release(self, data: bytes) -> bytes | None:
        """Frames of `data` that pass the gate now; None if the gate was not asked."""
        return self.gate.release(data, self.now_s)

    # ------------------------------------------------------------ the history

    def run(self) -> Oracle:
        """Run the whole history. The oracle has listed what it found."""
        self._begin()
        while self.left > 0:
            self._step()
        return self.oracle

    def _begin(self) -> None:
        """Begin, mostly with a vehicle that was seen on the ground, is armed and flies."""
        self._emptied()
        if self.rng.random() < 0.8:
            self.armed = False
            self._beat()
            self.armed, self.on_ground = True, False
            if self.rng.random() < 0.8:
                self.custom = self.custom_modes[self.rng.randrange(2)]
        self._position(0.0)
        self._beat()
        if self.own_walls is not None:
            self._own_fence(self.own_walls)
        if self.rng.random() < 0.5:
            self._moved(0.05)
            self._emptied()
            self._beat()

    def _step(self) -> None:
        rng = self.rng
        self._moved(self.step_s)
        if rng.random() < self.pilot:
            self.custom = rng.choice(self.custom_modes)
        elif self.pending and rng.random() < 0.5:
            self.custom = self.pending.pop()
            self.pending.clear()
        if rng.random() < self.trouble:
            self._rare()
        if rng.random() < self.positions:
            self._position(rng.uniform(0.0, 0.02))
        if rng.random() < 0.3:
            self._clock(rng.uniform(0.0, 0.02))
        if rng.random() < self.beats:
            self._beat()
        elif self.firmware is Firmware.PX4 and rng.random() < 0.3:
            self._current_mode()
        if rng.random() < 0.2:
            self._landed()
        if rng.random() < 0.97:
            self._emptied()
        if self.answers and rng.random() < self.answers:
            self._answer()
        if rng.random() < 0.97:
            self._decided()
        self._offer()

    def _offer(self) -> None:
        offered: list[bytes] = []
        whole: list[bool] = []
        for _ in range(1 if self.true or self.rng.random() < 0.7 else self.rng.randrange(1, 8)):
            frame, is_whole = self._frame()
            offered.append(frame)
            whole.append(is_whole)
            if not is_whole:
                break
        self.left -= len(offered)
        data = b"".join(offered)
        out = self._release(data)
        if out is None:
            return
        self.oracle.judge(offered, whole, out, self.now_s)
        if out:
            self._obeyed(offered, out)
        if len(out) < len(data):
            self._refused()

    def _refused(self) -> None:
        rng, oracle = self.rng, self.oracle
        if oracle.gone or not self.armed or self.on_ground:
            if rng.random() < 0.1:  # Begin another flight.
                self.armed = False
                self._beat()
                self.armed, self.on_ground = True, False
                self.custom = self.custom_modes[rng.randrange(2)]
        elif rng.random() < 0.6:
            self._wait()

    def _wait(self) -> None:
        """Wait until a gate that a fault has shut is open again."""
        for _ in range(16):
            self._moved(0.2)
            self._position(0.01)
            self._beat()
            self._emptied()
        if self.rng.random() < 0.7:
            self.heading += math.pi
            self.custom = self.custom_modes[self.rng.randrange(2)]

    def _obeyed(self, offered: list[bytes], out: bytes) -> None:
        at = 0
        for frame in offered:
            if not out.startswith(frame, at):
                continue
            at += len(frame)
            if len(frame) < 12 or frame[0] != 0xFD:
                continue
            payload = frame[10 : 10 + frame[1]]
            if frame[7] == 84:
                _, *numbers, _, _, _, _ = SETPOINT.unpack(payload[:53].ljust(53, b"\0"))
                north, east, down = numbers[3:6]
                self.last = self.cos * north + self.sin * east, self.cos * east - self.sin * north, down
                self.released_s = self.now_s
                position = self.oracle.position
                if position is not None:
                    self.longest_s = max(self.longest_s, self.now_s - position.measured_s)
            elif frame[7] == 76:
                fields = COMMAND.unpack(payload[:33].ljust(33, b"\0"))
                custom = ASKED[self.firmware.value].get((fields[1], fields[2]))  # type: ignore[call-overload]
                if fields[7] == 176 and custom is not None and self.rng.random() < 0.8:
                    self.pending.append(custom)
