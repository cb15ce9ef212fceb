"""Converts steps of one aircraft to columns that a recording draws.

A `StepColumns` takes an aircraft's steps piece by piece, in order. Of earlier pieces it keeps only the data
to which later ones are compared: modes, conflicts, names. Times in the result are on the common time line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from companion.arrays import Floats
from companion.autopilot.dialect import in_mode
from companion.avoidance.alerts import Level
from companion.event_record import Step
from companion.events import (
    AdsbVehicle,
    AlertChanged,
    AnyCommand,
    AnyEvent,
    AuthorityChanged,
    BroadcastChanged,
    CurrentMode,
    Decision,
    EstimatorState,
    FenceRefused,
    GlobalPosition,
    Heartbeat,
    LandedState,
    MissionRefused,
    ModeRefused,
    RadioState,
    RemoteIdHeard,
    RemoteIdModule,
    Say,
    Settings,
    Severity,
    TrackFlagged,
    TransportsChosen,
    TwoAutopilots,
    VehicleText,
    VelocitySetpoint,
)
from companion.geometry import Vec3
from companion.remote_id.messages import BasicId, Location
from ground_tools.inspect.explain.why import Explainer, HalfSpace
from ground_tools.inspect.read.flown import from_frame, to_ned
from ground_tools.inspect.read.modes import mode_name
from ground_tools.inspect.viewer.pieces import Bound, Note, Piece, Places
from ground_tools.inspect.viewer.scene import Aircraft

HELD_S = 5.0
"""A conflict that returns within this time is the same conflict."""
LOST_S = 3.0
"""The link is lost after this time without an autopilot's heartbeat: three heartbeats are missing."""
BOUNDS_S = 1.0
"""Minimum time between two computations of the half-spaces. Each one repeats a decision of the law."""
UNKNOWN = ""
"""State of a lane if nothing is known, or if there is nothing to show."""


@dataclass(slots=True)
class _Rows:
    own: list[tuple[float, ...]] = field(default_factory=list)
    decisions: list[tuple[float, Decision]] = field(default_factory=list)
    setpoints: list[tuple[float, float]] = field(default_factory=list)
    heard: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    bounds: list[tuple[float, Decision, tuple[HalfSpace, ...]]] = field(default_factory=list)


class StepColumns:
    """Converts the steps of one aircraft, piece by piece."""

    def __init__(self, aircraft: Aircraft, origin: Vec3) -> None:
        self._aircraft = aircraft
        self._origin = origin
        self._explainer = None if aircraft.config is None else Explainer(aircraft.config)
        self._bound_s = -math.inf
        self._names: dict[str, str] = {}
        self._last: dict[object, object] = {}
        self._beat: Heartbeat | None = None
        self._beat_s = math.inf
        """Time of the last heartbeat. A lost link is reported only for a companion's record."""
        self._lost = False
        self._start_s: float | None = None
        self._levels: dict[str, int] = {}
        self._conflict_s: dict[str, float] = {}
        """Time of the last conflict with each track."""
        self._infeasible_s = self._doubt_s = -math.inf
        self._notes: list[Note] = []
        self._states: dict[str, list[tuple[float, str]]] = {}

    def piece_of(self, steps: Iterable[Step]) -> Piece:
        """Convert the next steps."""
        rows = _Rows()
        self._notes, self._states = [], {}
        for step in steps:
            time = step.now_s + self._aircraft.offset_s
            if self._start_s is None:
                self._start_s = time
                if self._aircraft.config is not None:  # show the lane of alerts even if there are none
                    self._state(time, "alert", UNKNOWN)
            self._link(time, step)
            for event in step.events:
                self._event(time, event, rows)
            for command in step.commands:
                self._command(time, command, rows)
        return self._piece(rows)

    def _event(self, time: float, event: AnyEvent, rows: _Rows) -> None:
        match event:
            case GlobalPosition():
                place = (event.lat_deg, event.lon_deg, event.alt_msl_m)
                if self._explainer is not None:
                    self._explainer.note(time, event.velocity_ned_mps)
                rows.own.append((time, *place, math.hypot(*event.velocity_ned_mps)))
            case RemoteIdHeard():
                self._hear(time, event, rows)
            case AdsbVehicle():
                self._names[f"adsb {event.icao:06X}"] = event.callsign or f"{event.icao:06X}"
                above = self._aircraft.undulation_m if event.alt_geometric else 0.0
                altitude = self._origin[2] if event.alt_m is None else event.alt_m - above
                row = (time - event.age_s, event.lat_deg, event.lon_deg, altitude, math.nan)
                rows.heard.setdefault(f"adsb {event.icao:06X}", []).append(row)
            case Heartbeat():
                self._beat = event
                name = mode_name(event)
                self._mode(time, name if event.armed else f"{name}, disarmed")
            case CurrentMode():
                if self._beat is not None:
                    self._event(time, in_mode(self._beat, event.custom_mode), rows)
            case LandedState():
                if self._changed(LandedState, event.landed):
                    self._note(time, "INFO", event.landed.value.replace("_", " "))
            case EstimatorState():
                known = EstimatorState in self._last
                if self._changed(EstimatorState, event.usable) and (known or not event.usable):
                    words = f"the autopilot's estimator is {'usable again' if event.usable else 'not usable'}"
                    self._note(time, "INFO" if event.usable else "ERROR", words, marked=True)
            case RemoteIdModule():
                key = RemoteIdModule, event.component_id
                known = key in self._last
                if self._changed(key, (event.ready, event.text)) and (known or not event.ready):
                    words = f"Remote ID module {event.component_id} is " + ("" if event.ready else "not ")
                    words += "ready" + (f": {event.text}" if event.text else "")
                    self._note(time, "INFO" if event.ready else "WARN", words, marked=True)
            case TwoAutopilots():
                self._note(time, "ERROR", event.reason, marked=True)
            case ModeRefused():
                self._note(time, "ERROR", f"mode {event.mode.value} was refused: {event.reason}", marked=True)
            case MissionRefused() | FenceRefused():
                what = "mission" if isinstance(event, MissionRefused) else "fence"
                self._note(time, "ERROR", f"{what} was refused: {event.reason}", marked=True)
            case RadioState():
                if event.text:
                    self._note(time, "WARN", f"radio: {event.text}", marked=True)
            case VehicleText():
                level = _level(event.severity)
                self._note(time, level, f"autopilot: {event.text}", marked=level != "INFO")
            case Settings():
                self._note(time, "INFO", "settings from the ground: " + _settings(event), marked=True)
            case _:
                pass

    def _command(self, time: float, command: AnyCommand, rows: _Rows) -> None:
        match command:
            case VelocitySetpoint():
                rows.setpoints.append((time, math.hypot(*command.velocity_ned_mps)))
            case Decision():
                rows.decisions.append((time, command))
                self._conflicts(time, command)
                self._bounds(time, command, rows)
            case AuthorityChanged():
                self._before("authority", command.previous)
                self._state(time, "authority", command.state)
                level = "WARN" if command.state in ("fault", "yielded") else "INFO"
                words = f"authority {command.previous} -> {command.state} on {command.trigger}: "
                self._note(time, level, words + command.reason, marked=True)
            case AlertChanged():
                self._levels[command.track_id] = command.level
                highest = Level(max(self._levels.values()))
                if not command.level:
                    del self._levels[command.track_id]
                self._state(time, "alert", highest.name.lower() if highest else UNKNOWN)
                self._note(time, "WARN" if command.level == Level.WARNING else "INFO", command.reason)
            case BroadcastChanged():
                sent = rates_text(command.rates) or "silent"
                self._state(time, "protocol", sent)
                words = f"on the air: {sent}" + (f" ({command.reason})" if command.reason else "")
                self._note(time, "INFO" if command.legal else "WARN", words, marked=True)
            case TransportsChosen():
                self._state(time, "choice", f"{command.by}: {rates_text(command.rates) or 'none'}")
                by = "" if command.by == "fixed" else f" by {command.by}"
                words = f"transports chosen{by}: {rates_text(command.rates)} ({command.reason})"
                self._note(time, "WARN" if command.by == "fallback" else "INFO", words, marked=True)
            case TrackFlagged():
                words = f"{command.track_id} is doubted, {command.flag}: {command.text}"
                # False traffic can raise many doubts at once, so only the first one is marked.
                marked = time - self._doubt_s > HELD_S
                self._note(time, "WARN", words, marked=marked)
                self._doubt_s = time if marked else self._doubt_s
            case Say():
                level = _level(command.severity)
                self._note(time, level, f"to the pilot: {command.text}", marked=level != "INFO")
            case _:
                pass

    def _link(self, time: float, step: Step) -> None:
        """Note when the link to the autopilot is lost, and when it returns."""
        if self._aircraft.config is None:
            return
        silent_s = time - self._beat_s
        if any(isinstance(event, Heartbeat) for event in step.events):
            if self._lost:
                words = f"the link to the autopilot returned after {silent_s:.1f} s"
                self._note(time, "INFO", words, marked=True)
            self._beat_s, self._lost = time, False
        elif silent_s > LOST_S and not self._lost:
            self._lost = True
            words = f"the link to the autopilot is lost: no heartbeat for {silent_s:.1f} s"
            self._note(time, "WARN", words, marked=True)

    def _hear(self, time: float, event: RemoteIdHeard, rows: _Rows) -> None:
        rssi = math.nan if event.rssi_dbm is None else event.rssi_dbm
        for message in event.messages:
            match message:
                case BasicId() if message.uas_id:
                    self._names[event.address] = message.uas_id
                case Location() if message.lat_deg is not None and message.lon_deg is not None:
                    altitude = message.alt_geodetic_m
                    # Without an altitude it is drawn at the altitude of the origin.
                    msl = self._origin[2] if altitude is None else altitude - self._aircraft.undulation_m
                    row = (time, message.lat_deg, message.lon_deg, msl, rssi)
                    rows.heard.setdefault(event.address, []).append(row)
                case _:
                    pass

    def _conflicts(self, time: float, decision: Decision) -> None:
        """Note when a conflict begins, and when no velocity keeps all half-spaces."""
        for track in decision.tracks:
            if not track.conflict:
                continue
            if time - self._conflict_s.get(track.track_id, -math.inf) > HELD_S:
                words = f"conflict with {track.track_id}: {track.closest_m:.0f} m in "
                words += f"{track.time_to_closest_s:.0f} s, received {track.age_s:.1f} s ago"
                self._note(time, "WARN", words, marked=True)
            self._conflict_s[track.track_id] = time
        if not decision.feasible:
            if time - self._infeasible_s > HELD_S:
                words = "no velocity keeps every half-space; the law chose the least violation"
                self._note(time, "ERROR", words, marked=True)
            self._infeasible_s = time

    def _bounds(self, time: float, decision: Decision, rows: _Rows) -> None:
        bound = any(track.active for track in decision.tracks)
        if self._explainer is None or not bound or time - self._bound_s < BOUNDS_S:
            return
        self._bound_s = time
        found = self._explainer.look(time, decision).half_spaces
        rows.bounds.append((time, decision, tuple(one for one in found if one.active and one.track)))

    def _mode(self, time: float, name: str) -> None:
        known = self._last.get(Heartbeat)
        if self._changed(Heartbeat, name):
            self._state(time, "mode", name)
            if known is not None:
                self._note(time, "INFO", f"mode {known} -> {name}", marked=True)

    def _changed(self, key: object, value: object) -> bool:
        if self._last.get(key) == value:
            return False
        self._last[key] = value
        return True

    def _note(self, time: float, level: str, text: str, *, marked: bool = False) -> None:
        self._notes.append(Note(time, level, text, marked))

    def _before(self, lane: str, state: str) -> None:
        """Set the state before the first change of a lane, which is known from that change."""
        if self._changed(("lane", lane), True):
            assert self._start_s is not None
            self._state(self._start_s, lane, state)

    def _state(self, time: float, lane: str, state: str) -> None:
        self._states.setdefault(lane, []).append((time, state))

    def _piece(self, rows: _Rows) -> Piece:
        times = np.array([time for time, _ in rows.decisions])
        made = [decision for _, decision in rows.decisions]
        here = self._in_scene(made, [d.position_ned_m for d in made])
        on_path = [(time, d, d.path_ned_m) for time, d in rows.decisions if d.path_ned_m is not None]
        owners = [d for d in made for _ in d.tracks]
        own = _last_of_each(np.array(rows.own).reshape(-1, 5))
        setpoints = np.array(rows.setpoints).reshape(-1, 2)
        return Piece(
            own_s=own[:, 0],
            own_geodetic=own[:, 1:4],
            own_ned_m=to_ned(own[:, 1:4], self._origin),
            speed_mps=own[:, 4],
            decided_s=times,
            decided_ned_m=here,
            wanted_ned_mps=np.array([d.wanted_ned_mps for d in made]).reshape(-1, 3),
            chosen_ned_mps=np.array([d.chosen_ned_mps for d in made]).reshape(-1, 3),
            path_s=np.array([time for time, _, _ in on_path]),
            path_ned_m=self._in_scene([d for _, d, _ in on_path], [point for _, _, point in on_path]),
            seen=tuple(d.tracks for d in made),
            seen_ned_m=self._in_scene(owners, [t.position_ned_m for d in made for t in d.tracks]),
            setpoint_s=setpoints[:, 0],
            setpoint_mps=setpoints[:, 1],
            bounds=tuple(
                Bound(time, self._in_scene([d], [d.position_ned_m])[0], np.array(d.chosen_ned_mps), spaces)
                for time, d, spaces in rows.bounds
            ),
            heard={address: self._places(address, found) for address, found in rows.heard.items()},
            notes=self._notes,
            states=self._states,
        )

    def _places(self, address: str, found: list[tuple[float, ...]]) -> Places:
        table = np.array(sorted(found))
        name = self._names.get(address, address)
        label = f"{name} as {self._aircraft.name} heard it"
        return Places(label, table[:, 0], to_ned(table[:, 1:4], self._origin), table[:, 4])

    def _in_scene(self, made: list[Decision], points: list[Vec3]) -> Floats:
        """Convert points from the decisions' frames to the scene's frame, (n, 3).

        Velocities are not rotated, because the frames of one flight differ by less than a thousandth of a
        radian.
        """
        table = np.array(points, dtype=np.float64).reshape(-1, 3)
        frames = [d.origin for d in made]
        for frame in dict.fromkeys(frames):
            rows = np.array([one == frame for one in frames])
            table[rows] = from_frame(table[rows], frame, self._origin)
        return table


def rates_text(rates: Iterable[tuple[str, float]]) -> str:
    """Format transports with their messages per second."""
    return ", ".join(f"{name} {rate:g}/s" for name, rate in rates)


def _settings(event: Settings) -> str:
    words = ["enabled" if event.enable else "disabled"]
    words += [
        f"{name} {value:g}"
        for name in ("conflict_radius_m", "horizon_s", "max_speed_mps")
        if (value := getattr(event, name)) is not None
    ]
    return ", ".join(words)


def _last_of_each(table: Floats) -> Floats:
    """Keep the rows with rising times. Of several rows at one time, keep the last."""
    return table[np.append(np.diff(table[:, 0]) > 0.0, True)] if len(table) else table


def _level(severity: int) -> str:
    if severity <= Severity.CRITICAL:
        return "CRITICAL"
    return {Severity.ERROR: "ERROR", Severity.WARNING: "WARN"}.get(Severity(min(severity, 6)), "INFO")
