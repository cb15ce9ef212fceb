"""`sitl-mocks swarm --faults`: every companion is examined while something goes wrong around it.

Between each vehicle and its companion stands a router of ours (`takeover_wire`); companions are stopped
(SIGSTOP) and go on; pilots select modes on links of their own; the vehicle is disarmed for a moment, which
gives authority back, and the next round begins. A judge that sees nothing but the bytes at the vehicle's end
and the pilot's choices says which rules were broken.
"""

from __future__ import annotations

import contextlib
import heapq
import math
import os
import signal
import struct
import subprocess
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from rich.console import Console

from companion.autopilot.wire import Frame
from companion.config import LimitsConfig
from companion.events import Firmware
from companion.runtime.record.recorder import write_json
from sitl_mocks.examinations.faults import Fault, Interposer, begin_outside, drawn, end_outside, to_json
from sitl_mocks.examinations.modelled_link import ModelledLink
from sitl_mocks.examinations.pilot_link import ARM, SET_MODE, PilotLink, mode_told
from sitl_mocks.examinations.rule_judge import Judge
from sitl_mocks.examinations.takeover_cases import PILOTS, TROUBLES
from sitl_mocks.examinations.takeover_real import CAUSE_S, GRACE_S, state_of
from sitl_mocks.examinations.takeover_wire import Wire
from sitl_mocks.examinations.world import bounds_of
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

GIVEN_BACK: Final = "given back"
"""Disarmed and armed again, in the air: a pilot gives authority anew."""
_OTHERS: Final = (*(kind for kind in TROUBLES if kind != "stall"), "link")
_MANNERS: Final = ("disobeyed", "unanswered", "denied")
"""Of the vehicle's answers: they begin as the companion is about to take the vehicle."""
_MODES_AT_ONCE: Final = (0.6, 0.3, 0.1)
"""Shares of one, two and three modes within one step."""
_AROUND_S = 0.5
_LASTS_S: Final = (0.1, 10.0)
_FIRST_S: Final = (2.0, 5.0)
_AFTER_S: Final = (0.5, 4.0)
"""From the last event of a round to its end."""
_BETWEEN_S: Final = (0.5, 4.0)
"""From the vehicle in the companion's hands to the next round."""
_PUMP_S = 0.02
_STAMP = struct.Struct(">Q")
"""Of a record in a telemetry log."""
_ANSWER_S = 5.0
_TAKEN_S = 10.0
_GIVEN_TIMES = 3
"""A failsafe may have taken the vehicle before the companion did, and that ends authority too."""
_HELD_S = 0.4
"""Setpoints stream for so long before a round begins."""
_STREAMS_S = 0.2
_STOPS_S = 2.0
_WAITED_EVERY_S = 0.25
_AROUND_BREACH_S: Final = (1.5, 0.25)


def schedule_of(seed: int, number: int, duration_s: float) -> tuple[Fault, ...]:
    """What goes wrong for aircraft `number`, in the order of its times.

    Times count from the moment at which the companion first flies its vehicle, and stand still while the
    vehicle is given back and taken again.
    """
    rng = np.random.default_rng((seed, number, 7))
    found = [drawn("traffic", 0.0, duration_s, rng)]
    begins_s = float(rng.uniform(*_FIRST_S))
    back_s = 0.0
    while begins_s < duration_s:
        faults, ends_s = _round(back_s, begins_s, rng)
        back_s = round(ends_s + float(rng.uniform(*_AFTER_S)), 3)
        found += [*faults, Fault(GIVEN_BACK, back_s)]
        begins_s = back_s + float(rng.uniform(*_BETWEEN_S))
    return tuple(sorted((fault for fault in found if fault.at_s < duration_s), key=lambda fault: fault.at_s))


def _round(given_s: float, begins_s: float, rng: np.random.Generator) -> tuple[list[Fault], float]:
    """One trouble, mostly with a stall, and a pilot around it; and when all of it is over."""
    trouble = "stall" if rng.random() < 0.5 else str(rng.choice(_OTHERS))
    lasts_s = float(np.exp(rng.uniform(*np.log(_LASTS_S))))
    faults: list[Fault] = []
    if trouble in _MANNERS:
        faults.append(drawn(trouble, given_s, begins_s - given_s + lasts_s, rng))
    elif trouble != "modes":
        faults.append(drawn(trouble, begins_s, lasts_s, rng))
    if trouble not in ("stall", "modes") and rng.random() < 0.5:
        faults.append(drawn("stall", begins_s + float(rng.uniform(0.0, lasts_s)), 0.0, rng))
    ends_s = max([begins_s, *(fault.at_s + fault.lasts_s for fault in faults)])
    for _ in range(1 + int(rng.random() < 0.3)):
        selects_s = float(rng.uniform(max(0.0, begins_s - _AROUND_S), ends_s + _AROUND_S))
        count = 1 + int(rng.choice(len(_MODES_AT_ONCE), p=_MODES_AT_ONCE))
        modes = tuple(str(mode) for mode in rng.choice(PILOTS, count, replace=False))
        faults.append(Fault("mode", round(selects_s, 3), modes=modes))
        ends_s = max(ends_s, selects_s)
    return faults, ends_s


@dataclass(slots=True)
class Done:
    """What was done when (s of the timed paths), and what the pilot met."""

    at_s: float
    fault: Fault
    held: bool = False
    """The vehicle was in the companion's hands."""
    answers: tuple[str, ...] = ()
    """Of the vehicle to the pilot: after how long, or what else."""

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        row = to_json(self.fault) | {"at_s": round(self.at_s, 3), "held": self.held}
        return row | ({"answers": list(self.answers)} if self.answers else {})

    def words(self) -> str:
        """For people."""
        fault = self.fault
        numbers = "" if fault.kind == "stall" else ", ".join(f"{number:.3g}" for number in fault.numbers)
        words = " ".join(word for word in (fault.kind, ", ".join(fault.modes), numbers) if word)
        lasts = f" for {fault.lasts_s:.2f} s" if fault.lasts_s else ""
        held = "" if self.held or fault.kind in ("traffic", GIVEN_BACK) else " (not in the companion's hands)"
        return f"{words}{lasts}{held}"


class Examination:
    """One aircraft: the router, the pilot, the judge, and a thread in which all three are at work.

    It is the `Place` of its faults. Call `start`, `watch` as the companion has been started, `rest` before it
    is asked to end, and `close`.

    Args:
        ports: of the vehicle: for the companion, for the pilot.
        begins_s: time 0 of the timed paths on the monotonic clock.
        schedule: as `schedule_of` gives it.
        folder: where the bytes at the vehicle's end are written.
    """

    def __init__(
        self,
        name: str,
        firmware: Firmware,
        system_id: int,
        ports: tuple[int, int],
        limits: LimitsConfig,
        begins_s: float,
        schedule: tuple[Fault, ...],
        seed: int,
        folder: Path,
    ) -> None:
        self.name = name
        self.schedule = schedule
        self.done: list[Done] = []
        self.trouble: str | None = None
        """Why nothing can be said any more."""
        self._judge = Judge(bounds_of(firmware, "fly", limits), grace_s=GRACE_S, cause_s=CAUSE_S)
        self._system_id = system_id
        self._start_mode = VehicleMode.EXTERNAL if firmware is Firmware.ARDUPILOT else VehicleMode.HOLD
        self._begins_s = begins_s
        self._stack = contextlib.ExitStack()
        (folder / "wire").mkdir(exist_ok=True)
        self._file: IO[bytes] = self._stack.enter_context((folder / "wire" / f"{name}.tlog").open("wb"))
        self._wire = Wire(
            "udp", ports[0], self._judge, system_id=system_id,
            rng=np.random.default_rng((seed, system_id, 8)), shown=self._shown, passed=self._passed,
        )  # fmt: skip
        self._stack.callback(self._wire.close)
        self._pilot = PilotLink(firmware, ports[1], system_id)
        self._stack.callback(self._pilot.close)
        self.link_name = self._wire.name
        """What the companion is configured with."""
        self._armed = True
        self._mode: int | None = None
        self._entered: set[int] = set()
        """Modes that the vehicle has told since the pilot's last command."""
        self._child: subprocess.Popen[str] | None = None
        self._waited: deque[tuple[float, float]] = deque()
        self._continue_s: float | None = None
        self._lasting: list[tuple[float, int, Fault]] = []
        self._waiting = deque(schedule)
        self._shift_s = math.inf
        """From the schedule's clock to the monotonic one; it does not run before the companion flies."""
        self._rests = threading.Event()
        self._resting = threading.Event()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"faults-{name}")

    # ------------------------------------------------------------ from the swarm

    def start(self) -> None:
        """Begin to pass on what comes."""
        self._thread.start()

    def watch(self, child: subprocess.Popen[str]) -> None:
        """This is the companion, the leader of its process group."""
        self._child = child

    def rest(self) -> None:
        """Nothing goes wrong any more; the companion goes on."""
        self._rests.set()
        self._resting.wait(_STOPS_S + 2.0 * _ANSWER_S)

    def close(self) -> None:
        """End the thread; a companion that is stopped goes on."""
        self._rests.set()
        self._ends.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._send_signal(signal.SIGCONT)
        self._stack.close()

    def report(self) -> dict[str, Any]:
        """What was done and what came of it, for JSON."""
        choices = [done for done in self.done if done.fault.kind == "mode"]
        unknown = self.trouble
        if unknown is None and not any(done.held for done in choices):
            unknown = "no pilot chose while the vehicle was in the companion's hands"
        return {
            "unknown": unknown,
            "breaches": [
                {
                    "at_s": round(breach.at_s - self._begins_s, 3),
                    "rule": breach.rule,
                    "words": breach.words,
                    "waited_for_cpu_s": self._waited_for_cpu_s(breach.at_s),
                }
                for breach in self._judge.first()
            ],
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

    # ------------------------------------------------------------ where faults happen

    @property
    def now_s(self) -> float:
        """Of the router and the judge."""
        return time.monotonic()

    @property
    def link(self) -> ModelledLink:
        """The router's way."""
        return self._wire.way

    @property
    def judge(self) -> Judge:
        """Of this companion."""
        return self._judge

    @property
    def interposer(self) -> Interposer:
        """Between the router and the vehicle."""
        return self._wire.interposer

    @property
    def traffic_hz(self) -> float:
        """Frames of others down the companion's link."""
        return self._wire.traffic_hz

    @traffic_hz.setter
    def traffic_hz(self, value: float) -> None:
        self._wire.traffic_hz = value

    def stop(self, for_s: float, *, in_step: bool) -> None:
        """The companion's process group is stopped, wherever it is in its step."""
        until_s = self.now_s + for_s
        if self._continue_s is not None:
            self._continue_s = max(self._continue_s, until_s)
            return
        child = self._child
        if child is None or not self._send_signal(signal.SIGSTOP):
            return
        give_up_s = self.now_s + _STOPS_S
        while child.poll() is None and state_of(child.pid) not in "Tt" and self.now_s < give_up_s:
            self._pump(0.001)
        self._wire.stopped()
        self._continue_s = until_s

    def pilot_selects(self, mode: VehicleMode) -> bool:
        """Until the vehicle has answered."""
        number, asked_s = self._pilot.modes[mode], self.now_s
        self._judge.selects(asked_s, number)
        self._entered.clear()
        self._pilot.ask_mode(mode)
        result = self._answered(SET_MODE)
        answer = "no answer" if result is None else f"result {result}"
        if result != 0:
            self._judge.declined()
        else:
            answer = f"{self.now_s - asked_s:.3f} s"
            # What the vehicle has told on the companion's link counts: it may have been sent elsewhere since.
            if number in self._entered:
                self._judge.declined()
            else:
                self._show(self.now_s, number)
                self._judge.accepted(self.now_s)
        self.done[-1].answers += (answer,)
        return result == 0

    def _give_back(self) -> None:
        """Disarmed in the air until it has said so, and armed again."""
        self._pilot.arm(armed=False)
        if self._answered(ARM) != 0:
            self.done[-1].answers += ("not disarmed",)
            return
        self._pilot.ask_mode(self._start_mode)
        give_up_s = self.now_s + _ANSWER_S
        while self._armed and self.now_s < give_up_s and not self._rests.is_set():
            self._pump(_PUMP_S)
        self._pilot.arm(armed=True)
        self._answered(ARM)

    def _answered(self, command: int) -> int | None:
        """The result; None where the vehicle says nothing."""
        give_up_s = self.now_s + _ANSWER_S
        while self.now_s < give_up_s:
            for number, result in self._pilot.answers:
                if number == command:
                    return result
            self._pump(0.002)
        return None

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        try:
            self._until_taken(math.inf)
            while not self._rests.is_set():
                self._next()
            self._end_all()
            self._resting.set()
            while not self._ends.is_set():
                self._pump(_PUMP_S)
        except Exception as error:
            self.trouble = f"{type(error).__name__}: {error}"
        finally:
            self._resting.set()

    def _next(self) -> None:
        """The next fault, or the time until it."""
        now_s = self.now_s
        due_s = self._waiting[0].at_s + self._shift_s if self._waiting else math.inf
        if now_s < due_s:
            self._pump(min(_PUMP_S, due_s - now_s))
            return
        fault = self._waiting.popleft()
        self.done.append(Done(now_s - self._begins_s, fault, held=self._judge.held))
        if fault.kind == GIVEN_BACK:
            began_s = self.now_s
            for _ in range(_GIVEN_TIMES):
                self._give_back()
                if self._until_taken(_TAKEN_S) or self._rests.is_set():
                    break
            else:
                self.done[-1].answers += ("not taken",)
            self._shift_s += self.now_s - began_s
            return
        begin_outside(self, fault)
        if fault.lasts_s > 0.0:
            heapq.heappush(self._lasting, (now_s + fault.lasts_s, len(self.done), fault))

    def _until_taken(self, patience_s: float) -> bool:
        """Whether it came to be in the mode that flies setpoints, and they stream."""
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
        """Pass on, and end what is over."""
        now_s = self.now_s
        if self._continue_s is not None and now_s >= self._continue_s:
            self._go_on()
        while self._lasting and self._lasting[0][0] <= now_s:
            end_outside(self, heapq.heappop(self._lasting)[2])
        soon_s = min(now_s + for_s, self._continue_s or math.inf)
        # What the pilot has heard by now was sent after what the vehicle then had sent to the companion.
        self._pilot.hear()
        self._wire.pump(max(0.0, soon_s - now_s))
        self._note_waiting(now_s)

    def _go_on(self) -> None:
        self._continue_s = None
        self._wire.pump(0.0)
        self._wire.continues()
        self._send_signal(signal.SIGCONT)

    def _end_all(self) -> None:
        while self._lasting:
            end_outside(self, heapq.heappop(self._lasting)[2])
        self.traffic_hz = 0.0
        if self._continue_s is not None:
            self._go_on()

    def _send_signal(self, number: signal.Signals) -> bool:
        child = self._child
        if child is None or child.poll() is not None:
            return False
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, number)
        return True

    # ------------------------------------------------------------ what is seen

    def _shown(self, at_s: float, frame: Frame) -> None:
        if frame.system_id != self._system_id or frame.component_id != 1:
            return
        told = mode_told(frame.message_id, frame.payload)
        if told is not None:
            self._armed = self._armed if told[1] is None else told[1]
            self._entered.add(told[0])
            self._show(at_s, told[0])

    def _show(self, at_s: float, custom_mode: int) -> None:
        self._mode = custom_mode
        self._judge.shows(at_s, custom_mode, armed=self._armed)

    def _passed(self, at_s: float, frames: list[bytes]) -> None:
        stamp = _STAMP.pack(round(1e6 * (time.time() - (time.monotonic() - at_s))))
        for frame in frames:
            self._file.write(stamp + frame)

    def _note_waiting(self, now_s: float) -> None:
        """How long the companion's threads have waited for a processor so far."""
        if self._child is None or (self._waited and now_s - self._waited[-1][0] < _WAITED_EVERY_S):
            return
        waited_ns = 0
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{self._child.pid}/task").iterdir():
                with contextlib.suppress(OSError, ValueError, IndexError):
                    waited_ns += int((task / "schedstat").read_text().split()[1])
        self._waited.append((now_s, 1e-9 * waited_ns))

    def _waited_for_cpu_s(self, at_s: float) -> float:
        """Around a breach: of a companion that waits for a processor the machine is to blame."""
        before, after = _AROUND_BREACH_S
        around = [waited for t, waited in self._waited if at_s - before <= t <= at_s + after]
        return round(max(around) - min(around), 3) if around else 0.0


def end_all(examinations: list[Examination], folder: Path) -> dict[str, Any]:
    """End them, and write what was drawn, done and found; the reports by aircraft."""
    for one in examinations:
        one.close()
    reports = {one.name: one.report() for one in examinations}
    for one in examinations:
        schedule = [to_json(fault) for fault in one.schedule]
        write_json(folder / f"{one.name}.faults.json", {"schedule": schedule} | reports[one.name])
    return reports


def broken(reports: dict[str, Any]) -> bool:
    """Whether a rule was broken, or nothing is known of an aircraft."""
    return any(report["breaches"] or report["unknown"] for report in reports.values())


def judged(report: dict[str, object], reports: dict[str, Any]) -> dict[str, object]:
    """The swarm's report with that of the faults. What the verdict rests on without faults is reported and
    does not count: a companion that is stopped neither avoids nor sends nor hears."""
    ok = not report["ended_badly"] and not report["interrupted"] and not broken(reports)
    return report | {"ok": ok, "faults": reports}


def show(reports: dict[str, Any], console: Console) -> None:
    """For people: of each aircraft what was done, and which rules were broken."""
    for name, report in reports.items():
        console.print(f"[bold]{name}[/]: what was done", highlight=False)
        for row in report["done"]:
            given = {key: row[key] for key in ("kind", "lasts_s", "numbers", "modes") if key in row}
            fault = Fault(at_s=row["at_s"], **given)
            words = Done(row["at_s"], fault, row["held"]).words()
            answers = "; answered: " + ", ".join(row["answers"]) if "answers" in row else ""
            console.print(f"  {row['at_s']:7.2f} s  {words}{answers}", highlight=False, markup=False)
        console.print(
            f"  {report['setpoints']} setpoints; {report['choices']} choices, {report['choices_while_held']} "
            f"with the vehicle in the companion's hands; {report['crossed']} crossed a request, "
            f"{report['alike']} not judged; {len(report['not_done'])} of the schedule not reached; "
            f"{report['dropped']} datagrams found the companion's buffer full; the router was late by up to "
            f"{report['router_late_s']:.2f} s",
            highlight=False,
        )
        for breach in report["breaches"]:
            words = f"at {breach['at_s']:.3f} s: {breach['rule']}: {breach['words']}"
            waited = f"its threads waited {breach['waited_for_cpu_s']:.2f} s for a processor around it"
            console.print(f"  broken: {words} ({waited})", style="red", highlight=False, markup=False)
        if report["unknown"]:
            console.print(f"  nothing known: {report['unknown']}", style="red", highlight=False, markup=False)
        elif not report["breaches"]:
            console.print("  no rule broken", highlight=False)
    failed = [name for name, report in reports.items() if report["breaches"]]
    unknown = [name for name, report in reports.items() if report["unknown"]]
    console.print(
        f"{len(reports)} aircraft: rules broken by {', '.join(failed) or 'none'}; "
        f"nothing known of {', '.join(unknown) or 'none'}",
        highlight=False,
    )
