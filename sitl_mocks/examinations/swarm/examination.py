"""`sitl-mocks swarm --faults`: examine every companion while faults are injected around it.

A router (`processes.wire`) stands between each vehicle and its companion. Companions are stopped
(SIGSTOP) and resumed. Vehicles answer mode requests wrongly. Pilots select modes on links of their own. The
vehicle is then disarmed for a moment, which gives authority back, and the next round begins. A judge that
uses only the bytes at the vehicle's end and the pilot's choices reports which rules were broken.
"""

from __future__ import annotations

import contextlib
import heapq
import json
import math
import struct
import subprocess
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from companion.autopilot.wire import Frame
from companion.config import LimitsConfig
from companion.events import Firmware
from companion.runtime.record.recorder import write_json
from sitl_mocks.examinations.faults import Fault, begin_outside, end_outside, to_json
from sitl_mocks.examinations.modelled_link import ModelledLink
from sitl_mocks.examinations.processes.pilot_link import ARM, PilotLink, mode_told
from sitl_mocks.examinations.processes.stopped_process import StoppedProcess
from sitl_mocks.examinations.processes.wire import CAUSE_S, GRACE_S, Wire
from sitl_mocks.examinations.rule_judge import Breach, Judge
from sitl_mocks.examinations.swarm.schedule import GIVEN_BACK, AircraftSchedule, to_file
from sitl_mocks.examinations.swarm.verdict import Done
from sitl_mocks.examinations.world import bounds_of
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode

_PUMP_S = 0.02
_STAMP = struct.Struct(">Q")
"""Time stamp of a record in a telemetry log."""
_ANSWER_S = 5.0
_TAKEN_S = 10.0
_GIVEN_TIMES = 3
"""Attempts to give the vehicle back. A failsafe may take the vehicle before the companion does, which also
ends authority.
"""
_HELD_S = 0.4
"""Time for which setpoints must stream before a round begins."""
_STREAMS_S = 0.2
_STOPS_S = 2.0


@dataclass(frozen=True, slots=True)
class ServedVehicle:
    """A vehicle's process, as an examination reaches it."""

    name: str
    firmware: Firmware
    system_id: int
    ports: tuple[int, int]
    """UDP ports: for the companion and for the pilot."""
    troubles: IO[str]
    """Pipe to its standard input (`sitl-mocks serve --troubles`)."""


class Examination:
    """Examination of one aircraft: the router, the pilot and the judge, which all run in one thread.

    It is the `Place` of its faults. Call `start`, then `watch` when the companion has been started, `rest`
    before the companion is asked to end, and `close`.

    Args:
        begins_s: time 0 of the timed paths on the monotonic clock.
        folder: folder for the bytes at the vehicle's end.
    """

    def __init__(
        self,
        vehicle: ServedVehicle,
        limits: LimitsConfig,
        begins_s: float,
        schedule: AircraftSchedule,
        folder: Path,
    ) -> None:
        self.name = vehicle.name
        self.schedule = schedule
        self.done: list[Done] = []
        self.trouble: str | None = None
        """Reason why no result is known; None if there is none."""
        firmware = vehicle.firmware
        self._judge = Judge(
            bounds_of(firmware, "fly", limits),
            system_id=vehicle.system_id,
            grace_s=GRACE_S,
            cause_s=CAUSE_S,
        )
        self._vehicle = vehicle
        self._start_mode = MANNERS[firmware].waits_in
        self._begins_s = begins_s
        self._stack = contextlib.ExitStack()
        self._open_links(folder)
        self.link_name = self._wire.name
        """Link name for the companion's configuration."""
        self._armed = True
        self._entered: set[int] = set()
        """Modes that the vehicle has reported since the pilot's last command."""
        self._companion = StoppedProcess()
        self._continue_s: float | None = None
        self._lasting: list[tuple[float, int, Fault]] = []
        self._waiting = deque(schedule.faults)
        self._shift_s = math.inf
        """Offset from the schedule's clock to the monotonic clock. The schedule's clock starts when the
        companion first flies.
        """
        self._rests = threading.Event()
        self._resting = threading.Event()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"faults-{vehicle.name}")

    def _open_links(self, folder: Path) -> None:
        vehicle, schedule = self._vehicle, self.schedule
        (folder / "wire").mkdir(exist_ok=True)
        path = folder / "wire" / f"{vehicle.name}.tlog"
        self._file: IO[bytes] = self._stack.enter_context(path.open("wb"))
        self._wire = Wire(
            schedule.link,
            vehicle.ports[0],
            self._judge,
            rng=np.random.default_rng((schedule.seed, vehicle.system_id, 8)),
            shown=self._shown,
            passed=self._passed,
        )
        self._stack.callback(self._wire.close)
        self._pilot = PilotLink(vehicle.firmware, vehicle.ports[1], vehicle.system_id)
        self._stack.callback(self._pilot.close)

    # ------------------------------------------------------------ from the swarm

    def start(self) -> None:
        """Start to forward data."""
        self._thread.start()

    def set_companion(self, child: subprocess.Popen[str]) -> None:
        """Set the companion's process, which is the leader of its process group."""
        self._companion.child = child

    def rest(self) -> None:
        """Stop injecting faults and let the companion resume."""
        self._rests.set()
        self._resting.wait(_STOPS_S + 2.0 * _ANSWER_S)

    def close(self) -> None:
        """End the thread. A stopped companion resumes."""
        self._rests.set()
        self._ends.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._companion.resume()
        self._stack.close()

    @property
    def over(self) -> bool:
        """Whether a rule was broken, or the schedule has come to its end."""
        return bool(self._judge.breaches) or self.now_s - self._shift_s >= self.schedule.until_s

    def report(self) -> dict[str, Any]:
        """Injected faults and their results, for JSON."""
        choices = [done for done in self.done if done.fault.kind == "mode"]
        unknown = self.trouble
        if unknown is None and not any(done.held for done in choices):
            unknown = "no pilot selected a mode while the companion controlled the vehicle"
        return {
            "unknown": unknown,
            "link": self.schedule.link,
            "breaches": [self._row(breach) for breach in self._judge.first()],
            "breaches_in_all": len(self._judge.breaches),
            "setpoints": self._judge.setpoints,
            "choices": len(choices),
            "choices_while_held": sum(done.held for done in choices),
            "crossed": self._judge.crossed,
            "alike": self._judge.alike,
            "done": [done.to_json() for done in self.done],
            "router_late_s": round(self._wire.late_s, 3),
            "dropped": self._wire.dropped,
            "not_done": [to_json(fault) for fault in self._waiting],
        }

    def _row(self, breach: Breach) -> dict[str, Any]:
        at_s = breach.at_s - self._begins_s
        before = [done for done in self.done if done.at_s <= at_s]
        # The schedule's clock has run since the last fault, unless that fault gave the vehicle back.
        clock_s = at_s if not before else before[-1].fault.at_s + at_s - before[-1].at_s
        return {
            "at_s": round(at_s, 3),
            "schedule_s": round(clock_s, 3),
            "rule": breach.rule,
            "words": breach.words,
            "waited_for_cpu_s": self._companion.waited_s(breach.at_s),
        }

    # ------------------------------------------------------------ where faults happen

    @property
    def now_s(self) -> float:
        """Clock of the router and the judge."""
        return time.monotonic()

    @property
    def link(self) -> ModelledLink:
        """Modelled link of the router."""
        return self._wire.way

    @property
    def judge(self) -> Judge:
        """Judge of this companion."""
        return self._judge

    @property
    def traffic_hz(self) -> float:
        """Rate of foreign frames that are sent to the companion."""
        return self._wire.traffic_hz

    @traffic_hz.setter
    def traffic_hz(self, value: float) -> None:
        self._wire.traffic_hz = value

    def stop(self, for_s: float, *, in_step: bool) -> None:
        """Stop the companion's process group at any point of its step."""
        until_s = self.now_s + for_s
        if self._continue_s is not None:
            self._continue_s = max(self._continue_s, until_s)
            return
        if not self._companion.stop():
            return
        give_up_s = self.now_s + _STOPS_S
        while self._companion.still_runs and self.now_s < give_up_s:
            self._pump(0.001)
        self._wire.stopped()
        self._continue_s = until_s

    def set_trouble(self, name: str, value: Any) -> None:
        """See `Place.set_trouble`. A vehicle that has ended is reported elsewhere."""
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps({name: value}), file=self._vehicle.troubles, flush=True)

    def pilot_selects(self, *modes: VehicleMode) -> bool:
        """Select modes within one step of the vehicle, and wait for its answers.

        Only the last mode stays, so only that one is judged.
        """
        number, asked_s = self._pilot.modes[modes[-1]], self.now_s
        self._judge.selects(asked_s, number)
        self._entered.clear()
        self._pilot.ask_modes(*modes)
        give_up_s = asked_s + _ANSWER_S
        while len(self._pilot.mode_results) < len(modes) and self.now_s < give_up_s:
            self._pump(0.002)
        results = self._pilot.mode_results
        accepted = len(results) == len(modes) and results[-1] == 0
        if not accepted:
            answer = f"results {results}" if results else "no answer"
            self._judge.declined()
        else:
            answer = f"{self.now_s - asked_s:.3f} s"
            # Also use the modes that the vehicle reported on the companion's link, because it may have
            # changed its mode again since.
            if number in self._entered:
                self._judge.declined()
            else:
                self._show(self.now_s, number)
                self._judge.accepted(self.now_s)
        self.done[-1].answers += (answer,)
        return accepted

    def _give_back(self) -> None:
        """Disarm the vehicle in the air, wait until it reports this, and arm it again."""
        self._pilot.arm(armed=False)
        if self._arm_result() != 0:
            self.done[-1].answers += ("disarming was not accepted",)
            return
        self._pilot.ask_modes(self._start_mode)
        give_up_s = self.now_s + _ANSWER_S
        while self._armed and self.now_s < give_up_s and not self._rests.is_set():
            self._pump(_PUMP_S)
        self._pilot.arm(armed=True)
        self._arm_result()

    def _arm_result(self) -> int | None:
        """Result of arming or disarming; None if the vehicle does not answer."""
        give_up_s = self.now_s + _ANSWER_S
        while self.now_s < give_up_s:
            for number, result in self._pilot.answers:
                if number == ARM:
                    return result
            self._pump(0.002)
        return None

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        try:
            self._until_taken(math.inf)
            while not self._rests.is_set():
                self._next()
            self._finish_faults()
            self._resting.set()
            while not self._ends.is_set():
                self._pump(_PUMP_S)
        except Exception as error:
            # No other code sees an error of this thread. Unreported, it would look like "no rule broken".
            self.trouble = f"{type(error).__name__}: {error}"
        finally:
            self._resting.set()

    def _next(self) -> None:
        """Begin the next fault, or wait for it."""
        now_s = self.now_s
        due_s = self._waiting[0].at_s + self._shift_s if self._waiting else math.inf
        if now_s < due_s:
            self._pump(min(_PUMP_S, due_s - now_s))
            return
        fault = self._waiting.popleft()
        self.done.append(Done(now_s - self._begins_s, fault, held=self._judge.held))
        if fault.kind == GIVEN_BACK:
            self._give_back_and_wait()
            return
        begin_outside(self, fault)
        if fault.lasts_s > 0.0:
            heapq.heappush(self._lasting, (now_s + fault.lasts_s, len(self.done), fault))

    def _give_back_and_wait(self) -> None:
        """Give the vehicle back until the companion takes it. The schedule's clock stands still meanwhile."""
        began_s = self.now_s
        for _ in range(_GIVEN_TIMES):
            self._give_back()
            if self._until_taken(_TAKEN_S) or self._rests.is_set():
                break
        else:
            self.done[-1].answers += ("the companion did not take the vehicle",)
        self._shift_s += self.now_s - began_s

    def _until_taken(self, patience_s: float) -> bool:
        """Wait until the vehicle is in the setpoint mode and setpoints stream. Returns whether it
        happened.
        """
        give_up_s, since_s, taken = self.now_s + patience_s, math.inf, False
        while not taken and self.now_s < give_up_s and not self._rests.is_set():
            self._pump(_PUMP_S)
            now_s = self.now_s
            streams = self._judge.held and self._armed and now_s - self._judge.setpoint_s < _STREAMS_S
            since_s = min(since_s, now_s) if streams and now_s >= self._begins_s else math.inf
            taken = now_s - since_s >= _HELD_S
        if self._shift_s == math.inf:
            self._shift_s = self.now_s
        return taken

    def _pump(self, for_s: float) -> None:
        """Forward data, and end faults that are over."""
        now_s = self.now_s
        if self._continue_s is not None and now_s >= self._continue_s:
            self._go_on()
        while self._lasting and self._lasting[0][0] <= now_s:
            end_outside(self, heapq.heappop(self._lasting)[2])
        soon_s = min(now_s + for_s, self._continue_s or math.inf)
        # Read the pilot's link first. What the vehicle sent to the companion before it answered the pilot is
        # then read in the same turn.
        self._pilot.hear()
        self._wire.pump(max(0.0, soon_s - now_s))
        self._companion.note_waiting(now_s)

    def _go_on(self) -> None:
        self._continue_s = None
        self._wire.pump(0.0)
        self._wire.continues()
        self._companion.resume()

    def _finish_faults(self) -> None:
        while self._lasting:
            end_outside(self, heapq.heappop(self._lasting)[2])
        self.traffic_hz = 0.0
        if self._continue_s is not None:
            self._go_on()

    # ------------------------------------------------------------ what is seen

    def _shown(self, at_s: float, frame: Frame) -> None:
        if frame.system_id != self._vehicle.system_id or frame.component_id != 1:
            return
        told = mode_told(frame.message_id, frame.payload)
        if told is not None:
            self._armed = self._armed if told[1] is None else told[1]
            self._entered.add(told[0])
            self._show(at_s, told[0])

    def _show(self, at_s: float, custom_mode: int) -> None:
        self._judge.shows(at_s, custom_mode, armed=self._armed)

    def _passed(self, at_s: float, frames: list[bytes]) -> None:
        stamp = _STAMP.pack(round(1e6 * (time.time() - (time.monotonic() - at_s))))
        for frame in frames:
            self._file.write(stamp + frame)


def end_all(examinations: list[Examination], folder: Path) -> dict[str, Any]:
    """End the examinations and write schedules, injected faults and results. Returns reports by aircraft."""
    for one in examinations:
        one.close()
    reports = {one.name: one.report() for one in examinations}
    for one in examinations:
        schedule = to_file(one.schedule)
        write_json(folder / f"{one.name}.faults.json", {"schedule": schedule} | reports[one.name])
    return reports
