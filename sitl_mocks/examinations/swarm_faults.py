"""`sitl-mocks swarm --faults`: examine every companion while faults are injected around it.

A router of ours (`takeover_wire`) stands between each vehicle and its companion. Companions are stopped
(SIGSTOP) and resumed. Pilots select modes on links of their own. The vehicle is then disarmed for a moment,
which gives authority back, and the next round begins. A judge that uses only the bytes at the vehicle's end
and the pilot's choices reports which rules were broken.
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
"""Kind of event: disarmed and armed again in the air, by which a pilot gives authority anew."""
_OTHERS: Final = (*(kind for kind in TROUBLES if kind != "stall"), "link")
_MANNERS: Final = ("disobeyed", "unanswered", "denied")
"""Faults of the vehicle's answers. They begin before the companion takes the vehicle."""
_MODES_AT_ONCE: Final = (0.6, 0.3, 0.1)
"""Probabilities of one, two and three modes within one step."""
_AROUND_S = 0.5
_LASTS_S: Final = (0.1, 10.0)
_FIRST_S: Final = (2.0, 5.0)
_AFTER_S: Final = (0.5, 4.0)
"""Time from the last event of a round to its end."""
_BETWEEN_S: Final = (0.5, 4.0)
"""Time from the companion taking the vehicle to the next round."""
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
"""Setpoints must stream for this long before a round begins."""
_STREAMS_S = 0.2
_STOPS_S = 2.0
_WAITED_EVERY_S = 0.25
_AROUND_BREACH_S: Final = (1.5, 0.25)


def schedule_of(seed: int, number: int, duration_s: float) -> tuple[Fault, ...]:
    """Schedule of faults for aircraft `number`, in the order of their times.

    Times count from the moment at which the companion first flies its vehicle. The clock stands still while
    the vehicle is given back and taken again.
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
    """Draw one trouble, mostly with a stall, and a pilot around it; and the time when all is over."""
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
    """A fault that was injected, its time (s of the timed paths), and the answers to the pilot."""

    at_s: float
    fault: Fault
    held: bool = False
    """Whether the companion controlled the vehicle."""
    answers: tuple[str, ...] = ()
    """Answers of the vehicle to the pilot: the time until acceptance, or another result."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        row = to_json(self.fault) | {"at_s": round(self.at_s, 3), "held": self.held}
        return row | ({"answers": list(self.answers)} if self.answers else {})

    def words(self) -> str:
        """Text for people."""
        fault = self.fault
        numbers = "" if fault.kind == "stall" else ", ".join(f"{number:.3g}" for number in fault.numbers)
        words = " ".join(word for word in (fault.kind, ", ".join(fault.modes), numbers) if word)
        lasts = f" for {fault.lasts_s:.2f} s" if fault.lasts_s else ""
        held = "" if self.held or fault.kind in ("traffic", GIVEN_BACK) else " (not in the companion's hands)"
        return f"{words}{lasts}{held}"


class Examination:
    """Examination of one aircraft: the router, the pilot and the judge, which all run in one thread.

    It is the `Place` of its faults. Call `start`, then `watch` when the companion has been started, `rest`
    before the companion is asked to end, and `close`.

    Args:
        ports: ports of the vehicle: for the companion and for the pilot.
        begins_s: time 0 of the timed paths on the monotonic clock.
        schedule: result of `schedule_of`.
        folder: folder for the bytes at the vehicle's end.
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
        """Reason why no result is known; None if there is none."""
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
        """Link name for the companion's configuration."""
        self._armed = True
        self._mode: int | None = None
        self._entered: set[int] = set()
        """Modes that the vehicle has reported since the pilot's last command."""
        self._child: subprocess.Popen[str] | None = None
        self._waited: deque[tuple[float, float]] = deque()
        self._continue_s: float | None = None
        self._lasting: list[tuple[float, int, Fault]] = []
        self._waiting = deque(schedule)
        self._shift_s = math.inf
        """Offset from the schedule's clock to the monotonic clock. The schedule's clock starts when the
        companion first flies.
        """
        self._rests = threading.Event()
        self._resting = threading.Event()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"faults-{name}")

    # ------------------------------------------------------------ from the swarm

    def start(self) -> None:
        """Start to forward data."""
        self._thread.start()

    def watch(self, child: subprocess.Popen[str]) -> None:
        """Set the companion's process, which is the leader of its process group."""
        self._child = child

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
        self._send_signal(signal.SIGCONT)
        self._stack.close()

    def report(self) -> dict[str, Any]:
        """Injected faults and their results, for JSON."""
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
    def interposer(self) -> Interposer:
        """Interposer between the router and the vehicle."""
        return self._wire.interposer

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
        child = self._child
        if child is None or not self._send_signal(signal.SIGSTOP):
            return
        give_up_s = self.now_s + _STOPS_S
        while child.poll() is None and state_of(child.pid) not in "Tt" and self.now_s < give_up_s:
            self._pump(0.001)
        self._wire.stopped()
        self._continue_s = until_s

    def pilot_selects(self, mode: VehicleMode) -> bool:
        """Select a mode and wait for the vehicle's answer."""
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
            # Also use the modes that the vehicle reported on the companion's link, because it may have
            # changed its mode again since.
            if number in self._entered:
                self._judge.declined()
            else:
                self._show(self.now_s, number)
                self._judge.accepted(self.now_s)
        self.done[-1].answers += (answer,)
        return result == 0

    def _give_back(self) -> None:
        """Disarm the vehicle in the air, wait until it reports this, and arm it again."""
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
        """Result of a command; None if the vehicle does not answer."""
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
        """Begin the next fault, or wait for it."""
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
        # Read the pilot's link first: everything on it was sent after what the vehicle had then sent to the
        # companion.
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
        """Record how long the companion's threads have waited for a processor so far."""
        if self._child is None or (self._waited and now_s - self._waited[-1][0] < _WAITED_EVERY_S):
            return
        waited_ns = 0
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{self._child.pid}/task").iterdir():
                with contextlib.suppress(OSError, ValueError, IndexError):
                    waited_ns += int((task / "schedstat").read_text().split()[1])
        self._waited.append((now_s, 1e-9 * waited_ns))

    def _waited_for_cpu_s(self, at_s: float) -> float:
        """Time that the threads waited for a processor around a breach. If long, the machine is the cause."""
        before, after = _AROUND_BREACH_S
        around = [waited for t, waited in self._waited if at_s - before <= t <= at_s + after]
        return round(max(around) - min(around), 3) if around else 0.0


def end_all(examinations: list[Examination], folder: Path) -> dict[str, Any]:
    """End the examinations and write schedules, injected faults and results. Returns reports by aircraft."""
    for one in examinations:
        one.close()
    reports = {one.name: one.report() for one in examinations}
    for one in examinations:
        schedule = [to_json(fault) for fault in one.schedule]
        write_json(folder / f"{one.name}.faults.json", {"schedule": schedule} | reports[one.name])
    return reports


def broken(reports: dict[str, Any]) -> bool:
    """Whether a rule was broken, or an aircraft has no result."""
    return any(report["breaches"] or report["unknown"] for report in reports.values())


def judged(report: dict[str, object], reports: dict[str, Any]) -> dict[str, object]:
    """The swarm's report with the results of the faults.

    The criteria of a run without faults are reported but do not count, because a stopped companion neither
    avoids nor sends nor receives.
    """
    ok = not report["ended_badly"] and not report["interrupted"] and not broken(reports)
    return report | {"ok": ok, "faults": reports}


def show(reports: dict[str, Any], console: Console) -> None:
    """Print, for each aircraft, the injected faults and the broken rules."""
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
