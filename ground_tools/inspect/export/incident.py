"""Writes an incident as a scenario file that `sitl-mocks demo --scenario` can fly again.

- As flown: the tracks of the aircraft around the closest approach become their timed paths, and the simulated
  vehicles follow them closely (no lag, no wind, no navigation error). The demo's flight without avoidance
  then reproduces the incident, and its flight with avoidance shows what avoidance would have changed.
- As planned: the timed paths that the companions were to fly, with the limits, avoidance and radio channel of
  the run. The folder of a simulated run also contains everything else, so the same seed gives the same run.
  The effects of wind and navigation on real aircraft cannot be reproduced.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from companion.arrays import Floats
from companion.authority.table import State
from companion.config import AvoidanceConfig, LimitsConfig, TrajectoryFile
from companion.errors import ConfigError
from companion.events import AuthorityChanged, GlobalPosition, RemoteIdHeard
from companion.geometry import LocalFrame
from companion.remote_id.messages import Location
from companion.toml_reader import without_none
from ground_tools.inspect.read.flown import MAX_GAP_S, Flown, Separation, at, separations
from ground_tools.inspect.read.flown import Path as FlownPath
from ground_tools.inspect.read.read_run import AircraftRecord, Run, is_regular, read_json
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.channel.simple import MAX_DELAY_S
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario, VehicleSettings
from sitl_mocks.vehicle.options import HOME

AROUND_S = 60.0
"""Longest time before, and after, the closest approach that the scenario covers."""
NEAR = 5.0
"""Other aircraft take part if they come closer to one of the two than this many required separations."""
PERIOD_S = 0.5
"""Time between two points of a flown track. At 2 m/s2 the straight line between them is off by 6 cm."""
LOWEST_M = 20.0
"""The whole incident is lifted until its lowest point is this high, so that the simulated ground has no
effect."""
_EXACT = VehicleSettings(
    lag_s=0.01,
    max_acceleration_mps2=100.0,
    gnss_horizontal_sigma_m=0.0,
    gnss_vertical_sigma_m=0.0,
    gnss_velocity_sigma_mps=0.0,
)
_ACCELERATION_MPS2 = 20.0
_RECOVERY_S = 1.0
_ROOM = 1.05
_MOST_SPEED_MPS, _MOST_CLIMB_MPS = 50.0, 20.0
"""Largest values that `LimitsConfig` allows."""
_LEAST_S = 5.0
_DIGITS = 6
_IN_CONTROL = (State.GUARDING.value, State.AVOIDING.value, State.RECOVERING.value)


@dataclass(frozen=True, slots=True)
class Incident:
    """A scenario and its origin."""

    scenario: Scenario
    words: tuple[str, ...]
    """Description of the scenario and how to fly it, one line each. These lines become the file's header."""


def write(incident: Incident, path: Path) -> None:
    """Write a scenario file.

    Raises:
        ConfigError: The file cannot be written.
    """
    head = "".join(f"# {line}\n" for line in incident.words)
    body = tomli_w.dumps(without_none(msgspec.to_builtins(incident.scenario)))
    try:
        path.write_text(f"{head}\n{body}", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def flown_again(run: Run, ways: Flown) -> Incident:
    """Return the closest approach of a run as it was flown.

    Raises:
        ConfigError: No two aircraft were in the air at the same time, the pair's positions are not known for
            long enough around the closest approach, or an aircraft was faster than a scenario allows.
    """
    pairs = [pair for pair in separations(ways.paths) if pair.minimum_m is not None]
    if not pairs:
        raise ConfigError(
            f"{run.folder}: no two aircraft have positions at the same time; a scenario needs a pair"
        )
    closest = pairs[0]
    at_s = closest.minimum_time_s or 0.0
    by_name = {path.name: path for path in ways.paths}
    start, end = _window(by_name[closest.first], by_name[closest.second], at_s, run)
    names = _taking_part(closest, pairs, by_name, start, end)
    times = np.arange(start, end + 0.5 * PERIOD_S, PERIOD_S)
    tracks = _lifted([at(by_name[name], times) for name in names])
    records = {record.name: record for record in run.aircraft}
    limits, avoidance = _configured([records[name] for name in names])
    scenario = Scenario(
        aircraft=len(names),
        path=tuple(_path(times - start, track) for track in tracks),
        vehicle=_EXACT,
        air=_air(run),
        limits=_fast_enough(limits, tracks, run),
        avoidance=msgspec.structs.replace(avoidance, law="none", recovery_time_s=_RECOVERY_S),
    )
    return Incident(
        scenario,
        (
            f"The encounter of {closest.first} and {closest.second} in {run.name}, as flown.",
            f"Closest approach: {closest.minimum_m:.2f} m from {ways.positions}, "
            f"at {at_s - start:.1f} s of these paths.",
            f"Paths in order: {', '.join(names)}.",
            "The vehicles follow the flown paths without lag, wind, navigation error and avoidance.",
            "To fly them with avoidance, add --law dmuca and replace these with a real vehicle's values: "
            f"recovery_time_s was {avoidance.recovery_time_s:g}, "
            f"max_acceleration_mps2 {limits.max_acceleration_mps2:g}.",
        ),
    )


def planned_again(run: Run) -> Incident:
    """Return the timed paths of all aircraft of a run, to fly them with avoidance again.

    Raises:
        ConfigError: There are fewer than two aircraft, or an aircraft's record has no timed path or no start
            time of it.
    """
    if len(run.aircraft) < 2:
        raise ConfigError(f"{run.folder}: the run has one aircraft; a scenario needs at least two")
    given = _simulated(run)
    # A simulated run uses the local frame of the scenarios.
    frame = HOME if given is not None else _frame(run.aircraft[0], run)
    points = [_planned(record, frame, run) for record in run.aircraft]
    starts = [_start_utc_s(record, run) for record in run.aircraft]
    tracks = [rows[:, 1:] for rows in points]
    if given is None:
        tracks = _lifted(tracks)
    times = [rows[:, 0] + start - min(starts) for rows, start in zip(points, starts, strict=True)]
    limits, avoidance = _configured(run.aircraft)
    base, seed = (Scenario(air=_air(run)), None) if given is None else given
    scenario = msgspec.structs.replace(
        base,
        geometry=None,
        aircraft=len(tracks),
        path=tuple(map(_path, times, tracks)),
        limits=msgspec.structs.replace(limits, fence=None),
        avoidance=avoidance,
    )
    return Incident(
        scenario,
        (
            f"The planned paths of {run.name}.",
            f"Paths in order: {', '.join(record.name for record in run.aircraft)}.",
            "They do not contain the effects of wind and navigation on the real aircraft."
            if seed is None
            else f"To repeat the run: sitl-mocks demo --scenario THIS_FILE --seed {seed}",
        ),
    )


def _window(first: FlownPath, second: FlownPath, at_s: float, run: Run) -> tuple[float, float]:
    """Return the span around a time in which both positions are known without a gap, at most `AROUND_S` each
    way."""
    spans = [_known_around(path, at_s) for path in (first, second)]
    start = max(at_s - AROUND_S, *(span[0] for span in spans))
    end = min(at_s + AROUND_S, *(span[1] for span in spans))
    if end - start < _LEAST_S:
        raise ConfigError(
            f"{run.folder}: {first.name} and {second.name} have positions for {end - start:.1f} s around "
            f"their closest approach; a scenario needs {_LEAST_S:g} s"
        )
    return start, end


def _known_around(path: FlownPath, at_s: float) -> tuple[float, float]:
    """Return the span without a gap that contains a time."""
    breaks = np.flatnonzero(np.diff(path.time_s) > MAX_GAP_S)
    starts = path.time_s[np.append(0, breaks + 1)]
    ends = path.time_s[np.append(breaks, len(path.time_s) - 1)]
    held = int(np.searchsorted(starts, at_s, side="right")) - 1
    return float(starts[max(held, 0)]), float(ends[max(held, 0)])


def _taking_part(
    closest: Separation,
    pairs: list[Separation],
    by_name: dict[str, FlownPath],
    start_s: float,
    end_s: float,
) -> list[str]:
    """Return the closest pair, and every aircraft that comes near one of them and is known all the time."""
    two = {closest.first, closest.second}
    names = set(two)
    for pair in pairs:
        other = {pair.first, pair.second} - two
        inside = (pair.time_s >= start_s) & (pair.time_s <= end_s)
        if len(other) != 1 or not (pair.distance_m[inside] < NEAR * pair.required_m).any():
            continue
        name = other.pop()
        known = _known_around(by_name[name], 0.5 * (start_s + end_s))
        if known[0] <= start_s and known[1] >= end_s:
            names.add(name)
    return sorted(names)


def _lifted(tracks: list[Floats]) -> list[Floats]:
    """Move all tracks, each (n, 3) NED, up by the same height."""
    lowest = min(float(-track[:, 2].max()) for track in tracks)
    return [track - np.array([0.0, 0.0, max(LOWEST_M - lowest, 0.0)]) for track in tracks]


def _path(times_s: Floats, position_ned_m: Floats) -> PathSettings:
    rows = np.column_stack([times_s, position_ned_m]).round(_DIGITS).tolist()
    return PathSettings(points=tuple((t, n, e, d) for t, n, e, d in rows))


def _configured(records: Sequence[AircraftRecord]) -> tuple[LimitsConfig, AvoidanceConfig]:
    """Return the configuration of the first companion, to be used for all; the defaults if there is none."""
    for record in records:
        if record.header is not None:
            return record.header.config.limits, record.header.config.avoidance
    return LimitsConfig(), AvoidanceConfig()


def _fast_enough(limits: LimitsConfig, tracks: list[Floats], run: Run) -> LimitsConfig:
    """Return limits with which the tracks can be followed.

    Raises:
        ConfigError: The tracks are faster than limits may be.
    """
    steps = np.concatenate([np.diff(track, axis=0) for track in tracks]) / PERIOD_S
    needed = {
        "max_speed_mps": (float(np.linalg.norm(steps, axis=1).max()), _MOST_SPEED_MPS),
        "max_climb_mps": (float(-steps[:, 2].min()), _MOST_CLIMB_MPS),
        "max_descent_mps": (float(steps[:, 2].max()), _MOST_CLIMB_MPS),
    }
    for what, (speed, most) in needed.items():
        if speed * _ROOM > most:
            raise ConfigError(
                f"{run.folder}: the flown {speed:.1f} m/s are too fast for a scenario; allowed: "
                f"limits.{what} up to {most:g}, {100 * _ROOM - 100:.0f} % above the flown speed"
            )
    return msgspec.structs.replace(
        limits,
        fence=None,
        floor_height_m=None,
        ceiling_height_m=None,
        max_acceleration_mps2=_ACCELERATION_MPS2,
        **{what: max(getattr(limits, what), speed * _ROOM) for what, (speed, _) in needed.items()},
    )


def _simulated(run: Run) -> tuple[Scenario, int | None] | None:
    """Return the scenario and seed of a simulated run; None if its folder has none.

    The parent folder is searched, too, because the flight without avoidance is in a subfolder of its run.
    """
    for folder in (run.folder, run.folder.parent):
        if not is_regular(folder / "config.toml"):
            continue
        try:
            scenario = scenario_file.load(folder / "config.toml")
        except ConfigError:
            continue
        manifest, _ = read_json(folder / "manifest.json")
        seed = (manifest or {}).get("seed")
        return scenario, seed if isinstance(seed, int) else None
    return None


def _air(run: Run) -> AirSettings:
    """Return the message delays: those configured in the simulation, otherwise those found in the records."""
    given = _simulated(run)
    if given is not None and given[0].air.model == "interval":
        return given[0].air
    delays = np.concatenate([_delays(record) for record in run.aircraft])
    if not len(delays):
        return AirSettings()
    low, high = np.clip(np.percentile(delays, (5, 95)), 0.0, MAX_DELAY_S)
    return AirSettings(delay_s=(round(float(low), 2), round(float(high), 2)))


def _delays(record: AircraftRecord) -> Floats:
    """Return the delays (n,) in seconds from the timestamp of a received Location to its reception."""
    offset = record.facts.utc_offset_s
    found = array("d")
    if offset is not None:
        for step in record.steps():
            for event in step.events:
                if isinstance(event, RemoteIdHeard):
                    of_hour = (step.now_s + offset) % 3600.0
                    found.extend(
                        (of_hour - place.timestamp_s + 1800.0) % 3600.0 - 1800.0
                        for place in event.messages
                        if isinstance(place, Location) and place.timestamp_s is not None
                    )
    return np.array(found)


def _path_of(record: AircraftRecord, run: Run) -> TrajectoryFile:
    path = None if record.header is None else record.header.config.path
    if path is None:
        raise ConfigError(f"{run.folder}: {record.name}: its record has no timed path; leave out --planned")
    return path


def _frame(record: AircraftRecord, run: Run) -> LocalFrame:
    """Return the local frame at the aircraft's first waypoint, at sea level."""
    first = _path_of(record, run).waypoint[0]
    return LocalFrame(first.lat_deg, first.lon_deg, 0.0)


def _planned(record: AircraftRecord, frame: LocalFrame, run: Run) -> Floats:
    """Return the timed path as (n, 4): time (s) on the path's own clock, north, east, down (m)."""
    path = _path_of(record, run)
    datum_m = 0.0
    if path.altitude == "geodetic":
        datum_m = -record.facts.undulation_m
    elif path.altitude == "home":
        datum_m = _home_m(record)
    return np.array([(p.t_s, *frame.to_ned(p.lat_deg, p.lon_deg, p.alt_m + datum_m)) for p in path.waypoint])


def _start_utc_s(record: AircraftRecord, run: Run) -> float:
    """Return the UTC of the path's time 0."""
    flight = None if record.header is None else record.header.config.flight
    if flight is not None and flight.start == "utc" and flight.start_utc_s is not None:
        return flight.start_utc_s
    offset = record.facts.utc_offset_s
    for now_s, what in record.facts.rare:
        if offset is not None and isinstance(what, AuthorityChanged) and what.state in _IN_CONTROL:
            return now_s + offset
    raise ConfigError(f"{run.folder}: {record.name}: the start time of its timed path is not known")


def _home_m(record: AircraftRecord) -> float:
    """Return the height of the vehicle's home above mean sea level; 0 if the record has no position."""
    for step in record.steps():
        for event in step.events:
            if isinstance(event, GlobalPosition):
                return event.alt_msl_m - event.height_above_home_m
    return 0.0
