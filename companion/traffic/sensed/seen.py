"""Converts what sensors reported to places in the local frame, and groups them to objects and surfaces.

Neighbouring sectors of a scan with similar distances count as one thing. A thing that may fit into `OBJECT_M`
is an object: one place, which lies somewhere within its sectors. A wider thing is a surface, for which every
sector gives a place. An aircraft covers one or two sectors, or more when it is near; a wall covers many. The
least width of a thing follows from its inner sectors, because it may only touch the outer two.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from companion.config import SensedConfig
from companion.events import ObstaclePoint, ObstacleScan
from companion.events.sensed import NOTHING, UNKNOWN
from companion.geometry import Vec3
from companion.traffic.sensed.pose import SKEW_S, Pose

OBJECT_M: Final = 5.0
"""Things that may be narrower than this are objects, followed with a velocity. Others are surfaces, which
stand still."""
MOST_POINTS: Final = 48
"""Most points of OBSTACLE_DISTANCE_3D that are used in one step, the nearest ones."""
WIDE: Final = 0.15
"""Sectors whose half width is a larger share of the distance are wide: those of more than 17 degrees."""
_APART_M: Final = 2.0
"""Two places belong to two things if they are farther apart than this and than their sectors explain."""
_SLANT: Final = 2.5
"""A surface seen at a slant has places that are farther apart than its sectors are wide, by up to this
factor."""
_TALL_M: Final = 4.0
_PASSES_M: Final = 3.0
"""A sector that sees this much farther than a place shows that nothing is there."""


class Seen(NamedTuple):
    """One place where something is; local NED, m."""

    position: Vec3
    across_m: float
    """Half the width within which it lies, that of its sectors or points: a bound, not a standard
    deviation."""
    flat: bool
    """Its height is only that of the plane of the sensor."""
    tall: bool = False
    """It was seen at several heights, one above the other."""
    number: int | None = None
    """Number by which the sensor follows it."""
    velocity: Vec3 | None = None
    """As the sensor reports it."""
    vertical_known: bool = True


class Sight(NamedTuple):
    """What one scan, or the points of one step, show."""

    objects: list[Seen]
    surfaces: list[Seen]


def bearing_sigma_rad(pose: Pose, config: SensedConfig) -> float:
    """Error of a direction (rad), one standard deviation: mounting, heading, and the turn meanwhile."""
    return math.hypot(math.radians(config.bearing_sigma_deg), SKEW_S * pose.turn_rps)


def sight_of_scan(scan: ObstacleScan, pose: Pose, config: SensedConfig) -> Sight:
    """What an OBSTACLE_DISTANCE shows. The ground, the own vehicle, and what is too far are left out."""
    half_rad = 0.5 * math.radians(abs(scan.step_deg))
    sectors: list[_Sector | None] = []
    for number, cm in enumerate(scan.distances_cm):
        place = None
        if cm not in (UNKNOWN, NOTHING) and config.min_range_m <= 0.01 * cm <= config.max_range_m:
            distance = 0.01 * cm
            n, e, d = pose.position
            a, b, c = _ray(scan, number, pose)
            position = n + distance * a, e + distance * b, d + distance * c
            if not _is_ground(position, pose, config):
                across = distance * math.sin(min(half_rad, 0.5 * math.pi))
                place = _Sector(number, distance, Seen(position, across, flat=True))
        sectors.append(place)
    sight = Sight([], [])
    whole = len(sectors) * abs(scan.step_deg) > 360.0 - 0.5 * abs(scan.step_deg)
    runs = _runs(sectors, whole=whole, half_rad=half_rad)
    distances = {sector.number: sector.distance for sector in sectors if sector is not None}
    around = len(sectors) if whole else None
    for run in runs:
        if _is_wide(run, half_rad) or _is_coarse(run, half_rad) or _beside_nearer(run, distances, around):
            sight.surfaces.extend(sector.seen for sector in run)
        else:
            sight.objects.append(_object(run))
    return sight


def _ray(scan: ObstacleScan, number: int, pose: Pose) -> Vec3:
    """Direction (NED, of length 1) of the middle of a sector."""
    angle = math.radians(scan.first_deg + number * scan.step_deg)
    if scan.axes == "body":
        return pose.turned(math.cos(angle), math.sin(angle), 0.0)
    if scan.axes == "nose":
        angle += pose.yaw_rad
    return math.cos(angle), math.sin(angle), 0.0


def _is_ground(position: Vec3, pose: Pose, config: SensedConfig) -> bool:
    return pose.home_down_m - position[2] < config.ground_m


class _Sector(NamedTuple):
    """A sector that sees something."""

    number: int
    distance: float
    seen: Seen


def _runs(sectors: Sequence[_Sector | None], *, whole: bool, half_rad: float) -> list[list[_Sector]]:
    """Neighbouring sectors that see one thing. `whole`: the last sector lies beside the first one."""
    runs: list[list[_Sector]] = []
    before: _Sector | None = None
    for sector in sectors:
        if sector is not None:
            if before is not None and _joined(before, sector, half_rad):
                runs[-1].append(sector)
            else:
                runs.append([sector])
        before = sector
    first, last = sectors[0], sectors[-1]
    if whole and len(runs) > 1 and first is not None and last is not None and _joined(last, first, half_rad):
        runs[0] = runs.pop() + runs[0]
    return runs


def _joined(a: _Sector, b: _Sector, half_rad: float) -> bool:
    width = 2.0 * half_rad * min(a.distance, b.distance)
    return math.dist(a.seen.position, b.seen.position) <= _APART_M + _SLANT * width


def _is_wide(run: Sequence[_Sector], half_rad: float) -> bool:
    """Whether the thing that neighbouring sectors see is too wide, or too deep, for an object."""
    distances = [sector.distance for sector in run]
    least_m = (len(run) - 2) * 2.0 * half_rad * min(distances)
    return least_m > OBJECT_M or max(distances) - min(distances) > OBJECT_M


def _is_coarse(run: Sequence[_Sector], half_rad: float) -> bool:
    """Whether several wide sectors, each of them wider than an object, see one thing.

    Such a thing gets a place in each sector. A single place in the middle of all would have a margin larger
    than its distance, which would leave no way past it.
    """
    nearest = min(sector.distance for sector in run)
    return len(run) > 1 and math.sin(half_rad) > WIDE and 2.0 * half_rad * nearest > OBJECT_M


def _beside_nearer(run: Sequence[_Sector], distances: Mapping[int, float], around: int | None) -> bool:
    """Whether a neighbouring sector sees something nearer. This may then be another part of the same thing,
    seen at a slant or partly hidden by it. As the aircraft flies on, it would seem to move along the line of
    sight.

    Args:
        distances: what each sector sees, by its number.
        around: number of sectors of a full circle; None: it is none.
    """
    for sector, beside in ((run[0], run[0].number - 1), (run[-1], run[-1].number + 1)):
        distance = distances.get(beside if around is None else beside % around)
        if distance is not None and distance < sector.distance:
            return True
    return False


def _object(run: Sequence[_Sector]) -> Seen:
    """The object that neighbouring sectors see: in their middle, and somewhere within them."""
    position = _mean([sector.seen.position for sector in run])
    across = max(math.dist(position, sector.seen.position) + sector.seen.across_m for sector in run)
    return Seen(position, across, flat=True)


def _mean(positions: Sequence[Vec3]) -> Vec3:
    count = len(positions)
    n, e, d = (sum(axis) / count for axis in zip(*positions, strict=True))
    return n, e, d


def sight_of_points(points: Iterable[ObstaclePoint], pose: Pose, config: SensedConfig) -> Sight:
    """What the OBSTACLE_DISTANCE_3D of one component in one step show.

    A point with a number is an object of its own; the others are grouped by their distances.
    """
    found: list[tuple[float, Vec3, int | None]] = []
    for point in points:
        position = _placed(point, pose)
        if position is None:
            continue
        away = math.dist(position, pose.position)
        if config.min_range_m <= away <= config.max_range_m and not _is_ground(position, pose, config):
            found.append((away, position, point.number))
    found.sort(key=lambda one: one[0])
    found = found[:MOST_POINTS]
    sight = Sight(
        [Seen(p, 0.0, flat=False, number=number) for _, p, number in found if number is not None], []
    )
    for group in _groups([position for _, position, number in found if number is None]):
        norths, easts, downs = zip(*group, strict=True)
        wide = math.hypot(max(norths) - min(norths), max(easts) - min(easts))
        if wide > OBJECT_M:
            sight.surfaces.extend(Seen(position, _APART_M / 2.0, flat=False) for position in group)
            continue
        tall = max(downs) - min(downs) > _TALL_M
        sight.objects.append(Seen(_mean(group), 0.5 * wide, flat=False, tall=tall))
    return sight


def _placed(point: ObstaclePoint, pose: Pose) -> Vec3 | None:
    """Place of a point in our local frame; None if it cannot be known."""
    x, y, z = point.position_m
    if point.axes == "body":
        x, y, z = pose.turned(x, y, z)
    elif point.axes == "local":
        if pose.local is None:
            return None
        x, y, z = x - pose.local[0], y - pose.local[1], z - pose.local[2]
    n, e, d = pose.position
    return n + x, e + y, d + z


def _groups(positions: Sequence[Vec3]) -> list[list[Vec3]]:
    """Points that are connected by steps of less than OBJECT_M / 2 to the side."""
    groups: list[list[Vec3]] = []
    left = list(positions)
    while left:
        group, edge = [], [left.pop()]
        while edge:
            here = edge.pop()
            group.append(here)
            near = [p for p in left if math.hypot(p[0] - here[0], p[1] - here[1]) < 0.5 * OBJECT_M]
            left = [p for p in left if p not in near]
            edge += near
        groups.append(group)
    return groups


class View:
    """What one scan says about places where something was before.

    A scan whose sectors see past a place shows that nothing is there any more. The neighbouring sectors have
    to agree, because the direction of the place errs, too.
    """

    def __init__(self, scan: ObstacleScan, pose: Pose, config: SensedConfig) -> None:
        self._scan, self._pose = scan, pose
        self._error_rad = 2.0 * bearing_sigma_rad(pose, config)
        self._most_m = min(0.01 * scan.max_cm, config.max_range_m)

    def passes(self, position: Vec3, *, flat: bool) -> bool:
        """Whether the scan sees past a place (local NED, m). `flat`: its height is not known and is assumed
        to be ours, so a scan whose plane leans in that direction says nothing about it."""
        scan, pose = self._scan, self._pose
        away = tuple(q - p for p, q in zip(pose.position, position, strict=True))
        if flat:
            away = away[0], away[1], 0.0
        distance = math.hypot(*away)
        if not 1.0 < distance < 0.95 * self._most_m:
            return False
        if scan.axes == "body":
            x, y, z = (sum(r[k] * a for r, a in zip(pose.rows, away, strict=True)) for k in range(3))
        else:
            yaw = pose.yaw_rad if scan.axes == "nose" else 0.0
            x = math.cos(yaw) * away[0] + math.sin(yaw) * away[1]
            y = math.cos(yaw) * away[1] - math.sin(yaw) * away[0]
            z = away[2]
        if abs(z) > 1.0 + 0.05 * distance:
            return False
        angle = math.degrees(math.atan2(y, x))
        off = math.degrees(self._error_rad)
        free = [self._free(angle + turn, distance) for turn in (-off, 0.0, off)]
        return all(free)

    def _free(self, angle_deg: float, distance_m: float) -> bool:
        scan = self._scan
        width = abs(scan.step_deg)
        turned = (angle_deg - scan.first_deg) * math.copysign(1.0, scan.step_deg)
        number = int(((turned + 0.5 * width) % 360.0) / width)
        if number >= len(scan.distances_cm):
            return False
        cm = scan.distances_cm[number]
        return cm == NOTHING or (cm != UNKNOWN and 0.01 * cm > distance_m + _PASSES_M)
