"""One cycle of the law: its input, and the reports on its result (alerts, log, a delayed path)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from companion.authority.course import Course
from companion.authority.influence.allowance import Allowances
from companion.authority.influence.containment import Containment
from companion.authority.table import HOLDING, State
from companion.avoidance.alerts import Alerts
from companion.avoidance.law import LawResult, Neighbour, Situation
from companion.config import Config
from companion.events import AlertChanged, Command, Decision, Say, Severity
from companion.events.sensed import SENSED_WALL
from companion.geometry import Vec3
from companion.ownship import Ownship
from companion.traffic.adsb import AdsbTraffic
from companion.traffic.sensed import SensedTraffic
from companion.traffic.tracks import Traffic

_LATE_STEP_S = 30.0
"""The pilot is informed each time the path's delay has grown by this much."""
_WALL_S = 10.0
"""Least time between two messages to the pilot about sensed surfaces. One surface gives many tracks."""
_QUIET_LOG_S = 1.0
"""Time between logged decisions in quiet states. While avoiding or recovering, every decision is logged."""


class Decider:
    """Runs the law of one aircraft.

    Args:
        config: configuration in effect; `configure` replaces it.
    """

    def __init__(
        self,
        config: Config,
        own: Ownship,
        course: Course,
        traffic: Traffic,
        adsb: AdsbTraffic,
        sensed: SensedTraffic | None = None,
    ) -> None:
        self.alerts = Alerts(config.avoidance)
        self.allowances = Allowances(config)
        self._containment = Containment(config, own, course)
        self._config = config
        self._own = own
        self._course = course
        self._traffic = traffic
        self._adsb = adsb
        self._sensed = sensed
        self._neighbours: list[Neighbour] = []
        """All neighbours. The law is given those that their allowances admit."""
        self._heights_m: tuple[float, float] | None = None
        """Floor and ceiling of the containment, as heights above home; None while we do not control the
        vehicle."""
        self._decided_s = self._logged_s = self._said_wall_s = -math.inf
        self._told_late_s: float | None = None
        """Delay of the path (s) at its last report, or when we took control; None while we do not control the
        vehicle."""

    def configure(self, config: Config) -> None:
        """Use another configuration from now on."""
        self._config = config
        self.alerts.configure(config.avoidance)
        self.allowances.configure(config)
        self._containment.configure(config)

    @property
    def hold(self) -> str | None:
        """Why the latest decision requires that the vehicle is asked to hold, in words; None if it does
        not."""
        return self.allowances.hold

    def due(self, now_s: float) -> bool:
        """Whether the law's period since the last cycle is over."""
        return now_s - self._decided_s >= self._config.avoidance.period_s - 1e-6

    def decide(self, now_s: float, state: State) -> LawResult:
        """Decide what the law would fly now. Needs a law."""
        law = self._course.law
        assert law is not None
        self._decided_s = now_s
        if state in HOLDING and self._told_late_s is None:
            self._told_late_s = self._course.late_s
        held = state in HOLDING
        self._heights_m = self._containment.keep(now_s) if held else None
        here, velocity = self._own.position_ned_m(now_s), self._own.velocity_ned_mps
        self._neighbours = self._heard(now_s, here)
        admitted = self.allowances.admitted(now_s, here, velocity, self._neighbours)
        situation = self._situation(now_s, here, admitted)
        result = law.decide(situation)
        back = state is State.GUARDING
        self.allowances.charge(now_s, here, velocity, result, held=held, back=back)
        crewed = {(other.adsb, other.track_id) for other in admitted if other.crewed}
        conflicts = any(view.conflict and (view.adsb, view.track_id) in crewed for view in result.tracks)
        self._containment.note_conflict(now_s, crewed=conflicts)
        return result

    def note(self, now_s: float, result: LawResult, state: State) -> list[Command]:
        """Return alerts, messages and log entries about the decision just made."""
        told = self.allowances.told()
        if state not in HOLDING:
            return told + self._alert(now_s, None) + self._log(now_s, result, state)
        told += self._alert(now_s, result) + self._tell_late(result)
        return told + self._log(now_s, result, state)

    def look(self, now_s: float) -> list[Command]:
        """Run a cycle that only judges alerts, while the law does not decide."""
        self._decided_s = now_s
        self._neighbours = self._heard(now_s, self._own.position_ned_m(now_s))
        return self._alert(now_s, None)

    def let_go(self) -> None:
        """Note that we do not control the vehicle: path delays count from the next time that we take control,
        and nothing contains it."""
        self._told_late_s = None
        self._containment.let_go()

    def _heard(self, now_s: float, here: Vec3) -> list[Neighbour]:
        heard = self._traffic.neighbours(now_s) + self._adsb.neighbours(now_s, here[2])
        return heard if self._sensed is None else self._sensed.joined(now_s, self._own, heard)

    def _situation(self, now_s: float, here: Vec3, neighbours: Sequence[Neighbour]) -> Situation:
        own, limits, course = self._own, self._config.limits, self._course
        floor_m, ceiling_m = course.floor_height_m(limits), course.ceiling_height_m(limits)
        if self._heights_m is not None:
            floor_m, ceiling_m = self._heights_m
        return Situation(
            now_s=now_s,
            path_time_s=course.path_time_s(now_s),
            position_ned_m=here,
            velocity_ned_mps=own.velocity_ned_mps,
            sigma_m=own.sigma_m,
            neighbours=neighbours,
            floor_down_m=course.boundary_down_m(floor_m, own, now_s),
            ceiling_down_m=course.boundary_down_m(ceiling_m, own, now_s),
        )

    def _alert(self, now_s: float, result: LawResult | None) -> list[Command]:
        position, velocity = self._own.position_ned_m(now_s), self._own.velocity_ned_mps
        told = self.alerts.look(now_s, position, velocity, self._neighbours, result)
        if self._sensed is None:
            return told
        return [_with_fused_reason(c, self._sensed.fused) for c in told if not self._repeats_wall(now_s, c)]

    def _repeats_wall(self, now_s: float, command: Command) -> bool:
        """Whether a message about a sensed surface follows another such message too soon."""
        if not isinstance(command, Say) or SENSED_WALL not in command.text:
            return False
        again = now_s - self._said_wall_s < _WALL_S
        self._said_wall_s = self._said_wall_s if again else now_s
        return again

    def _tell_late(self, result: LawResult) -> list[Command]:
        """Report a growing delay of the path.

        An aircraft that a fence stops, or that is kept off its path for long, is not where it is expected.
        """
        late_s = self._course.late_s
        assert self._told_late_s is not None
        if late_s - self._told_late_s < _LATE_STEP_S:
            return []
        self._told_late_s = late_s
        bounds = f"; limited by {', '.join(result.limits)}" if result.limits else ""
        return [Say(severity=Severity.NOTICE, text=f"DMUCA: path {late_s:.0f} s late{bounds}")]

    def _log(self, now_s: float, result: LawResult, state: State) -> list[Command]:
        quiet = state in (State.GUARDING, State.WATCHING)
        if quiet and now_s - self._logged_s < _QUIET_LOG_S - 1e-6:
            return []
        self._logged_s = now_s
        frame = self._own.frame
        assert frame is not None
        return [
            Decision(
                origin=(frame.lat_deg, frame.lon_deg, frame.alt_m),
                position_ned_m=self._own.position_ned_m(now_s),
                velocity_ned_mps=self._own.velocity_ned_mps,
                wanted_ned_mps=result.wanted_ned_mps,
                chosen_ned_mps=result.chosen_ned_mps,
                feasible=result.feasible,
                path_ned_m=self._course.point(now_s),
                late_s=self._course.late_s,
                limits=result.limits,
                tracks=result.tracks,
            )
        ]


def _with_fused_reason(command: Command, fused: Mapping[tuple[bool, str], str]) -> Command:
    """Set the reason of an alert that ends because its aircraft is avoided as a sensed track from now on."""
    if not isinstance(command, AlertChanged) or command.level:
        return command
    seen_as = fused.get((False, command.track_id)) or fused.get((True, command.track_id))
    if seen_as is None:
        return command
    return msgspec.structs.replace(
        command, reason=f"clear {command.track_id}: the same aircraft is avoided as {seen_as}"
    )
