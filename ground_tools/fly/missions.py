"""Missions to upload, from QGroundControl .plan files, "QGC WPL 110" text, and a scenario's timed paths.

A file with an item that is not supported is refused with the item's number, because leaving an item out would
change the mission. Items are numbered from 1, as in ground stations; ArduPilot's item 0 (home) is left out.

Formats: QGroundControl's developer guide, "Plan File Format"; MAVLink's guide, "Mission Plain-Text File
Format".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.lists.list_download import GLOBAL_FRAMES
from companion.autopilot.lists.mission import (
    DO_CHANGE_SPEED,
    NAV_DELAY,
    NAV_RETURN_TO_LAUNCH,
    NAV_TAKEOFF,
    NAV_WAYPOINT,
)
from companion.errors import ConfigError
from companion.events import MissionItem
from companion.geometry import LocalFrame, Vec3
from sitl_mocks.encounters.lockstep import paths_of
from sitl_mocks.encounters.scenario_file import Scenario

GATE_S = 3600.0
"""Hold time at the beginning of a path, where a vehicle waits for the others (s)."""
_DO_JUMP = mavlink.MAV_CMD_DO_JUMP
_NAV_LAST = mavlink.MAV_CMD_NAV_LAST
"""Commands with greater numbers do not move the vehicle."""
_GLOBAL, _MISSION = mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_MISSION
_SAME_FRAME = {
    mavlink.MAV_FRAME_GLOBAL_INT: mavlink.MAV_FRAME_GLOBAL,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT,
}
"""Maps a MAV_FRAME with integer coordinates to the same frame with float coordinates."""
_STOPS = "a mission that stops after an item is not supported; allowed: one that continues by itself"
_ACCEPTANCE_M = 1.0
_SAME_PLACE_M = 0.01
_WPL = "QGC WPL 110"
_WPL_FIELDS = 12


class _Simple(msgspec.Struct, frozen=True):
    """A SimpleItem of a .plan."""

    command: int
    frame: int
    params: tuple[
        float | None, float | None, float | None, float | None, float | None, float | None, float | None
    ]
    auto_continue: bool = msgspec.field(default=True, name="autoContinue")


class _MissionPart(msgspec.Struct, frozen=True):
    items: list[dict[str, object]]


class _Fence(msgspec.Struct, frozen=True):
    polygons: tuple[object, ...] = ()
    circles: tuple[object, ...] = ()


class _Rally(msgspec.Struct, frozen=True):
    points: tuple[object, ...] = ()


class _Plan(msgspec.Struct, frozen=True, rename="camel"):
    """A .plan file, without the fields that only the ground station uses."""

    file_type: Literal["Plan"]
    mission: _MissionPart
    geo_fence: _Fence = _Fence()
    rally_points: _Rally = _Rally()


def load(path: Path) -> tuple[MissionItem, ...]:
    """Read a mission file in either format.

    Raises:
        ConfigError: The file is invalid; the message names the file, the item and what is allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: this is not a mission file: byte {error.start} is not UTF-8") from error
    items = _read_wpl(text, path) if text.startswith("QGC WPL") else _read_plan(text, path)
    if not items:
        raise ConfigError(f"{path}: the mission has no item")
    for item in items:
        why = _fault(item)
        if why is not None:
            raise ConfigError(f"{path}: item {item.seq}: command {item.command}: {why}")
    return items


def first_moving(items: Sequence[MissionItem]) -> MissionItem | None:
    """The first item that moves the vehicle."""
    return next((item for item in items if item.command < _NAV_LAST), None)


def begins_with_takeoff(items: Sequence[MissionItem]) -> bool:
    """Whether the first item that moves the vehicle is a NAV_TAKEOFF."""
    first = first_moving(items)
    return first is not None and first.command == NAV_TAKEOFF


def scenario_missions(scenario: Scenario, seed: int, origin: Vec3) -> list[tuple[MissionItem, ...]]:
    """Make one mission for each aircraft of a scenario.

    Item 1 is the beginning of the path, where the vehicle waits for the others. A path that begins later than
    others is held there for that time. Each leg follows at the speed that the times of the path require.

    Args:
        scenario: The scenario.
        seed: Seed of randomly drawn geometries.
        origin: Latitude, longitude (deg) and altitude above mean sea level (m) of the scenario's (0, 0, 0).

    Raises:
        ConfigError: A path is not above the ground.
    """
    frame = LocalFrame(*origin)
    paths = [[tuple(map(float, row)) for row in path] for path in paths_of(scenario, seed)]
    begins_s = min(rows[0][0] for rows in paths)
    return [_path_mission(number, rows, frame, begins_s) for number, rows in enumerate(paths)]


def difference(sent: Sequence[MissionItem], back: Sequence[MissionItem]) -> str | None:
    """Describe the first difference between an uploaded mission and its download; None if they are the same.

    The comparison covers commands, the datum of the frames, positions and altitudes, hold times to the second
    (ArduPilot stores no fractions) and speeds. A vehicle may store all other fields differently.
    """
    if len(sent) != len(back):
        return f"{len(sent)} items were sent, but {len(back)} came back"
    for ours, theirs in zip(sent, back, strict=True):
        if _essence(ours, theirs):
            continue
        return f"item {ours.seq}: {_words(ours)} was sent, but {_words(theirs)} came back"
    return None


def _read_plan(text: str, path: Path) -> tuple[MissionItem, ...]:
    try:
        plan = msgspec.json.decode(text, type=_Plan)
    except msgspec.DecodeError as error:
        raise ConfigError(
            f"{path}: this is neither a QGroundControl plan nor a {_WPL!r} file: {error}".replace("\n", " ")
        ) from error
    if plan.geo_fence.polygons or plan.geo_fence.circles:
        raise ConfigError(f"{path}: geoFence: this command uploads no fence; allowed: a plan without one")
    if plan.rally_points.points:
        raise ConfigError(
            f"{path}: rallyPoints: this command uploads no rally points; allowed: a plan without any"
        )
    items = []
    for number, raw in enumerate(plan.mission.items, start=1):
        kind = raw.get("type")
        if kind != "SimpleItem":
            what = raw.get("complexItemType", kind)
            raise ConfigError(f"{path}: item {number}: {what!r} is not supported; allowed: SimpleItem")
        try:
            simple = msgspec.convert(raw, _Simple)
        except msgspec.ValidationError as error:
            raise ConfigError(f"{path}: item {number}: {error}") from error
        if not simple.auto_continue:
            raise ConfigError(f"{path}: item {number}: autoContinue: {_STOPS}")
        items.append(_item(number, simple.frame, simple.command, simple.params))
    return tuple(items)


def _read_wpl(text: str, path: Path) -> tuple[MissionItem, ...]:
    """Read rows of INDEX, CURRENT, FRAME, COMMAND, PARAM1-4, X, Y, Z, AUTOCONTINUE; row 0 is home."""
    first, *rows = text.splitlines()
    if first.split() != _WPL.split():
        raise ConfigError(f"{path}: line 1: {first.strip()!r} is not allowed; allowed: {_WPL!r}")
    items: list[MissionItem] = []
    for line, row in enumerate(rows, start=2):
        fields = row.split()
        if not fields:
            continue
        if len(fields) != _WPL_FIELDS:
            raise ConfigError(f"{path}: line {line}: it has {len(fields)} fields; allowed: {_WPL_FIELDS}")
        try:
            index, _, frame, command = map(int, fields[:4])
            numbers = [float(field) for field in fields[4:11]]
            continues = float(fields[11]) != 0.0
        except ValueError as error:
            raise ConfigError(f"{path}: line {line}: a field is not a number: {error}") from error
        if index != len(items):
            raise ConfigError(f"{path}: line {line}: index {index} is not allowed; allowed: {len(items)}")
        if not items and (frame, command) != (_GLOBAL, NAV_WAYPOINT):
            raise ConfigError(
                f"{path}: line {line}: command {command} in MAV_FRAME {frame} is not home; allowed in row 0: "
                f"home (command {NAV_WAYPOINT} in MAV_FRAME {_GLOBAL}), which is not uploaded"
            )
        if items and not continues:
            raise ConfigError(f"{path}: line {line}: AUTOCONTINUE: {_STOPS}")
        params = [None if math.isnan(number) else number for number in numbers]
        items.append(_item(index, frame, command, params))
    return tuple(items[1:])


def _item(number: int, frame: int, command: int, params: Sequence[float | None]) -> MissionItem:
    p1, p2, p3, p4, x, y, z = params
    return MissionItem(
        seq=number, command=command, frame=frame, params=(p1, p2, p3, p4), lat_deg=x, lon_deg=y, alt_m=z
    )


def _fault(item: MissionItem) -> str | None:
    """Reason why an item of a file cannot be uploaded as intended; None if it can."""
    values = (*item.params, item.lat_deg, item.lon_deg, item.alt_m)
    if not all(value is None or math.isfinite(value) for value in values):
        return "a parameter is not finite; allowed: finite numbers"
    if item.command == _DO_JUMP:
        return "DO_JUMP is not supported: the end of a mission that repeats itself is not recognised"
    if item.frame == _MISSION:
        return (
            "MAV_FRAME 2 has no position; allowed for a waypoint: a global frame"
            if item.command == NAV_WAYPOINT
            else None
        )
    if item.frame not in GLOBAL_FRAMES:
        return f"MAV_FRAME {item.frame}; allowed: {', '.join(map(str, (2, *sorted(GLOBAL_FRAMES))))}"
    if item.command >= _NAV_LAST or item.command in (NAV_RETURN_TO_LAUNCH, NAV_DELAY):
        return None
    if item.lat_deg is None or item.lon_deg is None or item.alt_m is None:
        return "latitude, longitude or altitude is missing; all three are needed"
    if abs(item.lat_deg) > 90.0 or abs(item.lon_deg) > 180.0:
        return f"latitude {item.lat_deg:g}, longitude {item.lon_deg:g}; allowed: -90 to 90 and -180 to 180"
    if item.command == NAV_WAYPOINT and item.lat_deg == item.lon_deg == 0.0:
        return "latitude 0, longitude 0 means the current position; allowed: a position"
    return None


def _path_mission(
    number: int, rows: Sequence[tuple[float, ...]], frame: LocalFrame, begins_s: float
) -> tuple[MissionItem, ...]:
    items: list[MissionItem] = []

    def add(row: tuple[float, ...], hold_s: float) -> None:
        _, north, east, down = row
        if down >= 0.0:
            raise ConfigError(
                f"path[{number}]: a point is {down:g} m down; allowed: less than 0, above the ground"
            )
        lat, lon, alt = frame.to_geodetic(north, east, down)
        items.append(_item(len(items) + 1, _GLOBAL, NAV_WAYPOINT,
                           (hold_s, _ACCEPTANCE_M, 0.0, None, lat, lon, alt)))  # fmt: skip

    add(rows[0], GATE_S)
    if rows[0][0] > begins_s:
        add(rows[0], rows[0][0] - begins_s)
    speed_mps = 0.0
    for a, b in itertools.pairwise(rows):
        length_m, lasts_s = math.dist(a[1:], b[1:]), b[0] - a[0]
        if length_m < _SAME_PLACE_M:
            add(b, lasts_s)
            continue
        if not math.isclose(speed_mps, length_m / lasts_s, rel_tol=1e-3):
            speed_mps = length_m / lasts_s
            items.append(_item(len(items) + 1, _MISSION, DO_CHANGE_SPEED,
                               (1.0, speed_mps, -1.0, 0.0, 0.0, 0.0, 0.0)))  # fmt: skip
        add(b, 0.0)
    return tuple(items)


def _placed(item: MissionItem) -> bool:
    """Whether the item's latitude, longitude and altitude are a position."""
    moves = item.command < _NAV_LAST and item.command not in (NAV_RETURN_TO_LAUNCH, NAV_DELAY)
    return moves and item.frame in GLOBAL_FRAMES


def _essence(ours: MissionItem, theirs: MissionItem) -> bool:
    """Whether two items make the vehicle fly the same."""
    if ours.command != theirs.command:
        return False
    if ours.command == NAV_WAYPOINT and not _near(ours.params[0], theirs.params[0], 1.0):
        return False
    if ours.command == DO_CHANGE_SPEED and not _near(ours.params[1], theirs.params[1], 0.01):
        return False
    if not _placed(ours):
        return True
    frames = [_SAME_FRAME.get(item.frame, item.frame) for item in (ours, theirs)]
    # ArduPilot stores altitudes in cm.
    return frames[0] == frames[1] and all(
        _near(a, b, limit)
        for a, b, limit in (
            (ours.lat_deg, theirs.lat_deg, 1.5e-7),
            (ours.lon_deg, theirs.lon_deg, 1.5e-7),
            (ours.alt_m, theirs.alt_m, 0.02),
        )
    )


def _near(a: float | None, b: float | None, limit: float) -> bool:
    if a is None or b is None:
        return a is b
    return abs(a - b) < limit


def _words(item: MissionItem) -> str:
    place = f", {item.lat_deg}, {item.lon_deg}, {item.alt_m} m in frame {item.frame}" if _placed(item) else ""
    return f"command {item.command} {item.params[0]}, {item.params[1]}{place}"
