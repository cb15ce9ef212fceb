"""The heart: observe -> orient -> decide (the paper's Section 2), pure.

`step(now, events) -> commands`: no clock, socket, file or random source inside. The same object runs on the
aircraft, in lock-step simulation and in replay; the same events at the same times give the same commands,
bit for bit.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from companion.autopilot.mission import path_from_mission
from companion.avoidance.authority import HOLDING, State, Trigger, next_state
from companion.avoidance.law import Law, LawResult, Situation, make_law
from companion.avoidance.path import local_path
from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.config import Config, TrajectoryFile
from companion.errors import ConfigError
from companion.events import (
    AuthorityChanged,
    Broadcast,
    Command,
    Decision,
    DownloadMission,
    Event,
    FlightMode,
    Landed,
    MissionDownloaded,
    MissionRefused,
    ModeRefused,
    RemoteIdHeard,
    Say,
    SetMode,
    Severity,
    Vec3,
    VelocitySetpoint,
)
from companion.ownship import Ownship
from companion.remote_id.messages import Location
from companion.remote_id.schedule import Schedule
from companion.traffic.tracks import Traffic

_TAKE_FROM = frozenset({FlightMode.EXTERNAL, FlightMode.HOLD, FlightMode.MISSION})
"""Modes that the companion may take the vehicle from; a pilot on the sticks is left alone."""
_LATE_S = 0.5
"""A longer gap between two steps means the loop was late: what it would command is not fresh."""
_HEALTHY_AFTER_S = 2.0
_REFUSED_PAUSE_S = 8.0
"""After a refused mode change, before the vehicle is asked again."""
_CLEAR_AFTER_S = 3.0
_QUIET_LOG_S = 1.0
"""Decisions are logged at least this often; while avoiding or recovering each one is."""
_ECHOES = 32


class Companion:
    """One aircraft's mind. Build it, then call `step` with rising times."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.own = Ownship()
        self.traffic = Traffic(config.traffic, config.identity.uas_id)
        self.state = State.STANDBY
        self._schedule = Schedule(config.identity, config.remote_id)
        self._sent: deque[tuple[float | None, float | None, float | None]] = deque(maxlen=_ECHOES)
        self._path = config.path
        self._law: Law | None = None
        self._path_refused = False
        self._mission_asked = False
        self._path_start_s: float | None = None
        self._last_step_s: float | None = None
        self._decided_s = float("-inf")
        self._logged_s = float("-inf")
        self._result: LawResult | None = None
        self._mode_confirmed = False
        self._mode_asked_s: float | None = None
        self._mode_before: FlightMode | None = None
        self._unfit_s = float("-inf")
        self._conflict_s = float("-inf")
        self._refused: str | None = None
        self._left_external = False

    def step(self, now_s: float, events: Sequence[Event]) -> list[Command]:
        """Take in what happened since the last step; return what to do now.

        Args:
            now_s: monotonic time (s), not before the last step's.
            events: in order of arrival.

        Raises:
            ValueError: time runs backwards.
        """
        if self._last_step_s is not None and now_s < self._last_step_s:
            raise ValueError(f"step at {now_s} s after one at {self._last_step_s} s")
        commands: list[Command] = []
        late = self._last_step_s is not None and now_s - self._last_step_s > _LATE_S
        self._last_step_s = now_s
        self._observe(now_s, events, commands)
        self._orient(now_s, commands)
        self._decide(now_s, late, commands)
        return commands

    # ------------------------------------------------------------ observe

    def _observe(self, now_s: float, events: Sequence[Event], commands: list[Command]) -> None:
        """Own state, heard messages; tell others about ourselves."""
        heard: list[RemoteIdHeard] = []
        for event in events:
            match event:
                case RemoteIdHeard():
                    heard.append(event)
                case MissionDownloaded():
                    self._take_mission(event, commands)
                case ModeRefused():
                    self._refused = event.reason
                case MissionRefused():
                    self._refuse_path(event.reason, commands)
                case _:
                    self.own.take(event, now_s)
        own = self.own
        if own.frame is not None and heard:
            position = own.position_ned_m(now_s)
            sent = frozenset(self._sent)
            for frame in heard:
                self.traffic.hear(frame, now_s, own.utc_offset_s, own.frame, own.separation_m, position, sent)
        broadcast = self._schedule.due(own, now_s)
        if broadcast is not None:
            self._remember(broadcast)
            commands.append(broadcast)

    def _remember(self, broadcast: Broadcast) -> None:
        for message in broadcast.messages:
            if isinstance(message, Location) and message.lat_deg is not None and message.lon_deg is not None:
                # As they come back off the air: rounded to what the message holds.
                self._sent.append((message.timestamp_s, round(message.lat_deg, 7), round(message.lon_deg, 7)))

    def _take_mission(self, event: MissionDownloaded, commands: list[Command]) -> None:
        own = self.own
        speed = self.config.flight.mission_speed_mps
        if self._law is not None or speed is None or own.position is None:
            return
        try:
            self._path = path_from_mission(
                event.items,
                speed_mps=speed,
                start=(own.position.lat_deg, own.position.lon_deg, own.position.height_above_home_m),
                home_alt_msl_m=own.home_alt_msl_m,
            )
        except ConfigError as error:
            self._refuse_path(str(error), commands)

    # ------------------------------------------------------------ orient

    def _orient(self, now_s: float, commands: list[Command]) -> None:
        """Tracks that are still alive; a path in our frame as soon as there is one."""
        self.traffic.expire(now_s)
        flight = self.config.flight
        if flight.use != "fly" or self._law is not None or self._path_refused:
            return
        if self._path is None and flight.trajectory == "mission" and not self._mission_asked:
            if self.own.position is not None:
                self._mission_asked = True
                commands.append(DownloadMission())
            return
        if self._path is not None and self.own.frame is not None:
            try:
                trajectory = self._local_path(self._path)
                if trajectory is not None:
                    check_speeds(trajectory, self.config.limits)
                    self._law = make_law(self.config.avoidance, self.config.limits, trajectory)
            except ConfigError as error:
                self._refuse_path(str(error), commands)

    def _local_path(self, path: TrajectoryFile) -> Trajectory | None:
        """The path in the local frame; None while the datum of its altitudes is still unknown."""
        own = self.own
        assert own.frame is not None
        datum = {
            "msl": 0.0,
            "home": own.home_alt_msl_m,
            "geodetic": None if own.separation_m is None else -own.separation_m,
        }[path.altitude]
        return None if datum is None else local_path(path, own.frame, datum)

    def _refuse_path(self, reason: str, commands: list[Command]) -> None:
        self._path_refused = True
        commands.append(Say(severity=Severity.ERROR, text=f"DMUCA: path refused: {reason}"))

    # ------------------------------------------------------------ decide

    def _decide(self, now_s: float, late: bool, commands: list[Command]) -> None:
        """Who flies, and with what velocity."""
        unfit = "loop late" if late else self.own.unfit(now_s, self.config.vehicle.stale_after_s)
        if unfit is not None:
            self._unfit_s = now_s
        elif self._refused is not None:
            self._unfit_s = now_s + _REFUSED_PAUSE_S
        self._move(now_s, self._triggers(now_s, unfit), unfit, commands)
        law = self._law
        if law is not None:
            law.note_velocity(now_s, self.own.velocity_ned_mps)
        if self.state not in HOLDING or law is None:
            return
        if now_s - self._decided_s >= self.config.avoidance.period_s - 1e-6 or self._result is None:
            self._decided_s = now_s
            self._result = law.decide(self._situation(now_s))
            if self._result.conflict:
                self._conflict_s = now_s
            self._move(now_s, self._law_triggers(now_s), None, commands)
            self._log(now_s, commands)
        self._ask_mode(now_s, commands)
        commands.append(self._setpoint(self._result.chosen_ned_mps))

    def _triggers(self, now_s: float, unfit: str | None) -> frozenset[Trigger]:
        """What the vehicle's state says about authority."""
        own, flight = self.own, self.config.flight
        found = set()
        if unfit is not None or self._refused is not None:
            found.add(Trigger.UNFIT)
        if self._pilot_took_over():
            found.add(Trigger.PILOT)
        if not own.armed or own.landed is Landed.ON_GROUND:
            found.add(Trigger.RELEASE)
        if now_s - self._unfit_s > _HEALTHY_AFTER_S:
            found.add(Trigger.HEALTHY)
        if own.mode is not None and own.mode is not FlightMode.EXTERNAL:
            self._left_external = True
        if (flight.rearm == "disarm" and own.heartbeat is not None and not own.armed) or (
            flight.rearm == "mode" and self._left_external and own.mode is FlightMode.EXTERNAL
        ):
            found.add(Trigger.REARM)
        if (
            flight.use == "fly"
            and self._law is not None
            and unfit is None
            and own.armed
            and own.landed is Landed.IN_AIR
            and own.mode in _TAKE_FROM
            and (flight.start != "utc" or own.utc_offset_s is not None)
        ):
            found.add(Trigger.READY)
        return frozenset(found)

    def _pilot_took_over(self) -> bool:
        mode = self.own.mode
        if mode is FlightMode.EXTERNAL or mode is None:
            return False
        # Before the first confirmation the vehicle is still in the mode that we take it from.
        return self._mode_confirmed or mode is not self._mode_before

    def _law_triggers(self, now_s: float) -> frozenset[Trigger]:
        """What the law's last result says about authority."""
        result = self._result
        assert result is not None
        if result.conflict:
            return frozenset({Trigger.CONFLICT})
        if now_s - self._conflict_s < _CLEAR_AFTER_S:
            return frozenset()
        found = {Trigger.CLEAR}
        deviation = math.dist(self._path_point(now_s), self.own.position_ned_m(now_s))
        if deviation <= self.config.avoidance.regained_m:
            found.add(Trigger.REGAINED)
        return frozenset(found)

    def _move(
        self, now_s: float, triggers: frozenset[Trigger], unfit: str | None, commands: list[Command]
    ) -> None:
        moved = next_state(self.state, triggers)
        if moved is None:
            return
        previous, (self.state, trigger) = self.state, moved
        reason = self._reason(trigger, unfit)
        commands.append(
            AuthorityChanged(
                previous=previous.value, state=self.state.value, trigger=trigger.value, reason=reason
            )
        )
        if trigger is Trigger.READY:
            self._take_control(now_s)
        if trigger in (Trigger.PILOT, Trigger.UNFIT, Trigger.READY, Trigger.RELEASE):
            severity = Severity.WARNING if trigger in (Trigger.PILOT, Trigger.UNFIT) else Severity.INFO
            commands.append(Say(severity=severity, text=f"DMUCA {self.state.value}: {reason}"))
        if self.state not in HOLDING:
            self._result = None
            self._refused = None
            self._left_external = False
            self._decided_s = float("-inf")

    def _reason(self, trigger: Trigger, unfit: str | None) -> str:
        mode = self.own.mode.value if self.own.mode is not None else "unknown"
        return {
            Trigger.PILOT: f"mode changed to {mode}, not by us",
            Trigger.UNFIT: unfit or f"mode not entered: {self._refused}",
            Trigger.RELEASE: "vehicle disarmed or on the ground",
            Trigger.REARM: "authority given anew",
            Trigger.HEALTHY: "own state fit again",
            Trigger.READY: f"taking the vehicle from mode {mode}",
            Trigger.CONFLICT: "conflict with " + ", ".join(self._in_conflict()),
            Trigger.CLEAR: "no conflict",
            Trigger.REGAINED: "back on the timed path",
        }[trigger]

    def _in_conflict(self) -> list[str]:
        return [] if self._result is None else [t.track_id for t in self._result.tracks if t.conflict]

    def _take_control(self, now_s: float) -> None:
        self._mode_confirmed = False
        self._mode_asked_s = None
        self._mode_before = self.own.mode
        self._conflict_s = float("-inf")
        if self._path_start_s is None:
            self._path_start_s = now_s

    def _ask_mode(self, now_s: float, commands: list[Command]) -> None:
        """Get the vehicle to take setpoints. PX4 wants to see them before it is asked."""
        if self.own.mode is FlightMode.EXTERNAL:
            self._mode_confirmed = True
        elif not self._mode_confirmed and self._mode_asked_s is None:
            self._mode_asked_s = now_s
        elif self._mode_asked_s is not None and now_s - self._mode_asked_s >= 0.5:
            self._mode_asked_s = float("inf")
            commands.append(SetMode(mode=FlightMode.EXTERNAL))

    def _setpoint(self, velocity: Vec3) -> VelocitySetpoint:
        """The last gate: nothing outside the limits leaves, whatever the law says.

        Raises:
            RuntimeError: our bug; the process must not go on commanding.
        """
        limits, (north, east, down) = self.config.limits, velocity
        slack = 1e-6
        if not (
            math.hypot(north, east, down) <= limits.max_speed_mps + slack
            and -limits.max_climb_mps - slack <= down <= limits.max_descent_mps + slack
        ):
            raise RuntimeError(f"velocity {velocity} m/s is outside the limits {limits}")
        return VelocitySetpoint(velocity_ned_mps=velocity)

    def _situation(self, now_s: float) -> Situation:
        own, limits = self.own, self.config.limits
        assert own.frame is not None
        home_alt = own.home_alt_msl_m
        assert home_alt is not None

        def down_of(height_m: float | None) -> float | None:
            return None if height_m is None else own_frame_alt - home_alt - height_m

        own_frame_alt = own.frame.alt_m
        return Situation(
            now_s=now_s,
            path_time_s=self._path_time_s(now_s),
            position_ned_m=own.position_ned_m(now_s),
            velocity_ned_mps=own.velocity_ned_mps,
            sigma_m=own.sigma_m,
            neighbours=self.traffic.neighbours(now_s),
            floor_down_m=down_of(limits.floor_height_m),
            ceiling_down_m=down_of(limits.ceiling_height_m),
        )

    def _path_time_s(self, now_s: float) -> float:
        flight = self.config.flight
        if flight.start == "utc" and flight.start_utc_s is not None and self.own.utc_offset_s is not None:
            return now_s + self.own.utc_offset_s - flight.start_utc_s
        assert self._path_start_s is not None
        return now_s - self._path_start_s

    def _path_point(self, now_s: float) -> Vec3:
        """The timed path's point for now (local NED, m)."""
        assert self._law is not None
        return self._law.trajectory.position(self._path_time_s(now_s))

    def _log(self, now_s: float, commands: list[Command]) -> None:
        result = self._result
        assert result is not None
        assert self.own.frame is not None
        if self.state is State.GUARDING and now_s - self._logged_s < _QUIET_LOG_S - 1e-6:
            return
        self._logged_s = now_s
        frame = self.own.frame
        commands.append(
            Decision(
                origin=(frame.lat_deg, frame.lon_deg, frame.alt_m),
                position_ned_m=self.own.position_ned_m(now_s),
                velocity_ned_mps=self.own.velocity_ned_mps,
                wanted_ned_mps=result.wanted_ned_mps,
                chosen_ned_mps=result.chosen_ned_mps,
                feasible=result.feasible,
                path_ned_m=self._path_point(now_s),
                tracks=result.tracks,
            )
        )
