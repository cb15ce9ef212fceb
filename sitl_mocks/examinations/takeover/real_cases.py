"""`sitl-mocks takeover --real`: the takeover examination with real processes, sockets and signals.

`companion run` and `sitl-mocks serve` are processes; a router (`processes.wire`) stands between them.
While the companion controls the vehicle, it is stopped (SIGSTOP), the pilot selects a mode on a second link,
and the companion is resumed (SIGCONT). Disarming gives authority back, and the next case begins.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from companion.events import Firmware
from sitl_mocks.examinations.modelled_link import KINDS, Kind
from sitl_mocks.examinations.processes.pilot_link import ARM, SET_MODE, PilotLink
from sitl_mocks.examinations.processes.stopped_process import state_of
from sitl_mocks.examinations.processes.wire import CAUSE_S, GRACE_S, Wire
from sitl_mocks.examinations.rule_judge import Breach, Judge
from sitl_mocks.examinations.world import bounds_of
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode

_PATIENCE_S = 180.0
"""Longest wait for a process or its answer; generous, because machines can be slow."""
_REFUSED_S = 1.0
"""Longest wait for an answer that accepts a command after another one: PX4 answers twice."""
_RETAKEN_S = 25.0
"""Longest wait for the companion to take the vehicle before authority is given again."""
_TRIES = 3
"""How often a case is begun in which a stall of the machine leaves no result."""
_DISARMED_S = 1.2
"""Longer than the time from one heartbeat to the next."""
_HELD_S = 0.4
"""Setpoints must stream for this long before a case begins."""
_WATCH_S = (1.0, 4.5)
"""Observation time after the companion resumes. One case in four is watched for the long time, until a fault
is over.
"""
_LONGEST_S = 10.0
_HEIGHT_M = 400.0
_PILOTS: Final = (VehicleMode.RTL, VehicleMode.LAND, VehicleMode.HOLD, VehicleMode.MANUAL)
_TRAJECTORY = """altitude = "home"
waypoint = [
  { t_s = 0.0, lat_deg = 47.397, lon_deg = 8.545, alt_m = 400.0 },
  { t_s = 3600.0, lat_deg = 47.450, lon_deg = 8.545, alt_m = 400.0 },
]
"""
_CONFIG = """[identity]
uas_id = "TAKEOVER{port}"
[vehicle]
link = "{link}"
system_id = 1
wait_s = 40.0
[flight]
use = "fly"
trajectory = "path.toml"
take_in_flight = true
start_within_m = 10000.0
[limits]
max_speed_mps = 6.0
[avoidance]
law = "none"
[record]
folder = "{folder}"
"""


@dataclass(frozen=True, slots=True)
class RealCase:
    """Actions and times of one case."""

    number: int
    stall_s: float
    selects_s: float
    """Time of the pilot's choice after the stop (s)."""
    mode: VehicleMode
    traffic_hz: float
    watch_s: float


@dataclass(frozen=True, slots=True)
class RealVerdict:
    """Result of one case. `trouble` is the reason if there is no result."""

    firmware: Firmware
    link: Kind
    case: RealCase
    breaches: tuple[Breach, ...]
    trouble: str | None = None


def real_case(seed: int, number: int) -> RealCase:
    """Case `number` of a seed."""
    rng = np.random.default_rng((seed, number))
    stall_s = float(rng.uniform(0.1, _LONGEST_S))
    return RealCase(
        number=number,
        stall_s=round(stall_s, 3),
        selects_s=round(float(rng.uniform(0.0, stall_s + 0.3)), 3),
        mode=_PILOTS[int(rng.integers(len(_PILOTS)))],
        traffic_hz=round(float(np.exp(rng.uniform(math.log(10.0), math.log(500.0)))), 1),
        watch_s=_WATCH_S[int(rng.random() < 0.25)],
    )


class NoFlightError(Exception):
    """The companion did not take the vehicle."""


class CompanionEndedError(NoFlightError):
    """The companion's process has ended."""


class RealFlight:
    """One vehicle, one companion and the wire between them, for successive cases.

    Raises:
        NoFlightError: a process ended, or the companion does not take the vehicle.
    """

    def __init__(self, firmware: Firmware, link: Kind, folder: Path) -> None:
        self.firmware, self.link = firmware, link
        self._modes = MANNERS[firmware].custom_modes
        self._start_mode = MANNERS[firmware].waits_in
        self._folder = folder
        self._stack = contextlib.ExitStack()
        self._armed = True
        self._mode: int | None = None
        try:
            self._begin()
        except BaseException:
            self._stack.close()
            raise

    def _begin(self) -> None:
        folder = self._folder
        vehicle = self._process(
            "vehicle", "sitl_mocks.cli", "serve", "--firmware", self.firmware.value,
            "--link", "udpin:127.0.0.1:0", "--link", "udpin:127.0.0.1:0",
            "--airborne", str(_HEIGHT_M), "--mode", self._start_mode.value,
        )  # fmt: skip
        log = folder / "vehicle.log"
        self._wait(lambda: "ready" in log.read_text(), vehicle, "the vehicle is not ready")
        ports = [int(port) for port in re.findall(r"link udpin:127\.0\.0\.1:(\d+)", log.read_text())]
        bounds = bounds_of(self.firmware, "fly")
        self.judge = Judge(bounds, grace_s=GRACE_S, cause_s=CAUSE_S)
        self._wire = Wire(self.link, ports[0], self.judge)
        self._stack.callback(self._wire.close)
        self._pilot = PilotLink(self.firmware, ports[1])
        self._stack.callback(self._pilot.close)
        (folder / "path.toml").write_text(_TRAJECTORY)
        config = folder / "companion.toml"
        config.write_text(_CONFIG.format(port=ports[0], link=self._wire.name, folder=folder / "runs"))
        self._companion = self._process("companion", "companion.commands.cli", "run", "--config", str(config))
        self._until_held()

    def _process(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        log = self._stack.enter_context((self._folder / f"{name}.log").open("wb"))
        child = subprocess.Popen(
            [sys.executable, "-u", "-m", *arguments],
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._stack.callback(_end, child)
        return child

    def _wait(self, done: Callable[[], bool], child: subprocess.Popen[bytes], words: str) -> None:
        give_up_s = time.monotonic() + _PATIENCE_S
        while not done():
            if child.poll() is not None or time.monotonic() > give_up_s:
                raise NoFlightError(words)
            time.sleep(0.05)

    def close(self) -> None:
        """End the processes."""
        self._stack.close()

    # ------------------------------------------------------------ one case

    def fly(self, case: RealCase) -> RealVerdict:
        """Fly one case. The companion must control the vehicle.

        Raises:
            NoFlightError: the companion no longer controls the vehicle when the case begins, the vehicle does
                not accept the pilot's mode, or the companion has ended.
        """
        self._wire.traffic_hz = case.traffic_hz
        self._pump(0.2)
        if not self._streams:
            raise NoFlightError(f"the companion lost the vehicle before the case (mode {self._mode})")
        self.judge.breaches.clear()
        begins_s = time.monotonic()
        os.kill(self._companion.pid, signal.SIGSTOP)
        while state_of(self._companion.pid) not in "Tt":
            self._pump(0.001)
        self._wire.stopped()
        ends_s, selects_s = begins_s + case.stall_s, begins_s + case.selects_s
        for at_s in sorted((ends_s, selects_s)):
            self._pump(at_s - time.monotonic())
            if at_s == ends_s:
                self._go_on()
            else:
                self._select(case.mode)
        self._pump(case.watch_s)
        breaches = tuple(b._replace(at_s=round(b.at_s - begins_s, 3)) for b in self.judge.first())
        self._wire.traffic_hz = 0.0
        self._check_companion()
        return RealVerdict(self.firmware, self.link, case, breaches)

    def _go_on(self) -> None:
        self._wire.pump(0.0)
        self._wire.continues()
        os.kill(self._companion.pid, signal.SIGCONT)

    def _select(self, mode: VehicleMode) -> None:
        """Select a mode and wait until the vehicle has accepted it."""
        self.judge.selects(time.monotonic(), self._modes[mode])
        self._pilot.ask_modes(mode)
        self._acknowledged(SET_MODE)
        self._show(self._modes[mode])
        self.judge.accepted(time.monotonic())

    def _acknowledged(self, command: int) -> None:
        began_s = time.monotonic()
        while (command, 0) not in self._pilot.answers:
            answered = any(number == command for number, _ in self._pilot.answers)
            if time.monotonic() - began_s > (_REFUSED_S if answered else _PATIENCE_S):
                raise NoFlightError(
                    f"the vehicle did not accept command {command}; its answers: {self._pilot.answers}"
                )
            self._pump(0.002)

    def give_back(self) -> None:
        """Disarm for a moment in the air, which gives authority again, and wait until the companion takes it.

        Raises:
            NoFlightError: the companion does not take the vehicle, or has ended.
        """
        self._disarm_and_arm()
        self._until_held()

    def _disarm_and_arm(self) -> None:
        self._pilot.arm(armed=False)
        self._acknowledged(ARM)
        self._pilot.ask_modes(self._start_mode)
        self._pump(_DISARMED_S)
        self._pilot.arm(armed=True)
        self._acknowledged(ARM)

    @property
    def _streams(self) -> bool:
        """Whether the vehicle is in the setpoint mode and setpoints stream."""
        external = self._modes[VehicleMode.EXTERNAL]
        return self._mode == external and time.monotonic() - self.judge.setpoint_s < 0.2

    def _until_held(self) -> None:
        """Wait until the companion controls the vehicle.

        A stall of the machine may end its authority, because the vehicle's failsafe acts meanwhile. Authority
        is then given again.
        """
        give_up_s = time.monotonic() + _PATIENCE_S
        while not self._held_within(_RETAKEN_S):
            if time.monotonic() > give_up_s:
                raise NoFlightError(f"the companion did not take the vehicle {self._state()}")
            self._disarm_and_arm()

    def _held_within(self, patience_s: float) -> bool:
        give_up_s, since_s = time.monotonic() + patience_s, math.inf
        while time.monotonic() - since_s < _HELD_S:
            self._pump(0.02)
            now_s = time.monotonic()
            since_s = min(since_s, now_s) if self._streams else math.inf
            self._check_companion()
            if now_s > give_up_s:
                return False
        return True

    def _check_companion(self) -> None:
        if self._companion.poll() is not None:
            raise CompanionEndedError(f"the companion ended {self._state()}")

    def _state(self) -> str:
        words = (self._folder / "companion.log").read_text()[-600:]
        return f"(mode {self._mode}); end of its log: {words}"

    # ------------------------------------------------------------ the second link

    def _pump(self, for_s: float) -> None:
        self._pump_until(lambda: False, for_s)

    def _pump_until(self, done: Callable[[], bool], for_s: float) -> None:
        end_s = time.monotonic() + for_s
        while not done():
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return
            self._wire.pump(min(left_s, 0.002))
            self._pilot.hear(self._heard)

    def _heard(self, custom_mode: int, armed: bool | None) -> None:
        self._armed = self._armed if armed is None else armed
        self._show(custom_mode)

    def _show(self, custom_mode: int) -> None:
        self._mode = custom_mode
        self.judge.shows(time.monotonic(), custom_mode, armed=self._armed)


def _end(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        child.send_signal(signal.SIGCONT)
        child.kill()
    child.wait()


def fly_cases(firmware: Firmware, link: Kind, cases: list[RealCase], folder: Path) -> list[RealVerdict]:
    """Fly cases of one firmware and link. After a case without a result the processes are started again."""
    found: list[RealVerdict] = []
    flight: RealFlight | None = None
    try:
        for case in cases:
            for left in reversed(range(_TRIES)):
                where = folder / f"{firmware.value}-{link}-{case.number}-{left}"
                try:
                    if flight is None:
                        where.mkdir(parents=True)
                        flight = RealFlight(firmware, link, where)
                    else:
                        flight.give_back()
                    found.append(flight.fly(case))
                    break
                except NoFlightError as error:
                    if flight is not None:
                        flight.close()
                    flight = None
                    if not left or isinstance(error, CompanionEndedError):
                        found.append(RealVerdict(firmware, link, case, (), str(error)))
                        break
    finally:
        if flight is not None:
            flight.close()
    return found


def many_real(seed: int, cases: int, jobs: int, folder: Path) -> list[RealVerdict]:
    """Fly the cases from 0 to below `cases` of a seed on `jobs` threads, in turn by firmware and link."""
    turns = {
        place: [real_case(seed, number) for number in range(k, cases, len(PLACES))]
        for k, place in enumerate(PLACES)
    }
    with ThreadPoolExecutor(jobs) as pool:
        flown = [pool.submit(fly_cases, *place, mine, folder) for place, mine in turns.items() if mine]
        return [verdict for future in flown for verdict in future.result()]


PLACES: Final[tuple[tuple[Firmware, Kind], ...]] = tuple(
    (firmware, link) for firmware in Firmware for link in KINDS
)
