"""Everything that sensors aboard see, as neighbours for the law.

A sensed track transmits nothing and is assumed not to avoid us, so the law does all of the avoidance. It
counts as proven, because it was measured and not reported: it is avoided however long it has held us. Poles
and walls stand still, and are passed only to the side, because their height is not known.

The table of sensed tracks is its own: however many there are, no transmitted track is displaced, and there
are never more of them than `objects.MOST` and `surfaces.MOST`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from companion.avoidance.law import SIGMAS, Neighbour
from companion.config import SensedConfig
from companion.events import (
    Attitude,
    Command,
    Event,
    LocalPosition,
    ObstaclePoint,
    ObstacleScan,
    Say,
    SensedAircraft,
    Severity,
)
from companion.events.sensed import SENSED, SENSED_WALL
from companion.geometry import Vec3
from companion.ownship import Ownship
from companion.traffic.sensed import objects as followed
from companion.traffic.sensed import surfaces as walls
from companion.traffic.sensed.fusing import Fusing
from companion.traffic.sensed.objects import Followed, Objects
from companion.traffic.sensed.pose import Pose, Poses
from companion.traffic.sensed.seen import WIDE, Seen, View, sight_of_points, sight_of_scan
from companion.traffic.sensed.surfaces import Patch, Surfaces

LEVEL_M: Final = 10.0
"""Obstacles within this height of ours are passed to the side only, because it is not known how tall they
are."""
_LEANS: Final = 0.15
"""Share of the distance by which the plane of a scan may miss the height of what it sees."""
MOST_SPAN_S: Final = 0.2
"""Measurements that may have waited longer than this before they were read are not used."""
_MOST_SCANS: Final = 4
"""Most scans that are used in one step."""
_ERRORS: Final = 3.0
"""Standard deviations of a measurement in the margin, in addition to the width of the sectors."""
_DRIFT_MPS: Final = 0.5
"""Assumed rate at which the error of the own position changes. A measurement relative to the own vehicle is
affected only by the change since it was made."""
_REFUSED_S, _SILENT_S, _AGAIN_S = 2.0, 3.0, 10.0
"""Time without usable measurements, and time without scans, after which the pilot is told; and least time
between two such texts."""


@dataclass(slots=True)
class SensedCounts:
    """What was received so far."""

    scans: int = 0
    points: int = 0
    aircraft: int = 0
    refused: int = 0
    """Measurements of these that were not used, because attitude or position was unknown or too old, the
    vehicle leaned or turned too much, or the input was late."""


class SensedTraffic:
    """What sensors aboard see. Times never decrease.

    Args:
        stale_after_s: an own position older than this is not used (`vehicle.stale_after_s`).
    """

    def __init__(self, config: SensedConfig, stale_after_s: float) -> None:
        self.counts = SensedCounts()
        self.trouble: str | None = None
        """Why the last measurement was not used, in words; None: it was used."""
        self._config = config
        self._stale_after_s = stale_after_s
        self._poses = Poses()
        self._objects = Objects(config)
        self._surfaces = Surfaces()
        self._fusing = Fusing()
        self._refused_since_s = math.inf
        self._scan_s: float | None = None
        self._said_s = -math.inf

    def clear(self) -> None:
        """Forget all tracks, because the local frame of their positions is no longer valid."""
        self._objects.clear()
        self._surfaces.clear()
        self._fusing.clear()
        self._poses.clear()

    def hear(self, events: Sequence[Event], now_s: float, own: Ownship, *, sent_s: float) -> None:
        """Take in the attitudes and measurements of one step.

        Args:
            sent_s: the earliest time at which they can have been sent.
        """
        late = now_s - sent_s > MOST_SPAN_S
        measured: list[Event] = []
        for event in events:
            match event:
                case Attitude() if not late:
                    self._poses.note_attitude(event, now_s)
                case LocalPosition() if not late:
                    self._poses.note_local(event, now_s)
                case ObstacleScan() | ObstaclePoint() | SensedAircraft():
                    measured.append(event)
        if own.unfit(now_s, self._stale_after_s) is not None:
            # If the own position has jumped, all stored places are wrong.
            self._objects.clear()
            self._surfaces.clear()
        if not measured:
            return
        self._count(measured, now_s)
        at_s = now_s - self._config.latency_s
        pose = "input is behind" if late else self._poses.at(at_s, now_s, own, self._stale_after_s)
        if isinstance(pose, str):
            self.counts.refused += len(measured)
            self.trouble = pose
            self._refused_since_s = min(self._refused_since_s, now_s)
            return
        self.trouble, self._refused_since_s = None, math.inf
        self._see(measured, pose, own)

    def _count(self, measured: Sequence[Event], now_s: float) -> None:
        for event in measured:
            self.counts.scans += isinstance(event, ObstacleScan)
            self.counts.points += isinstance(event, ObstaclePoint)
            self.counts.aircraft += isinstance(event, SensedAircraft)
            if isinstance(event, ObstacleScan):
                self._scan_s = now_s

    def _see(self, measured: Sequence[Event], pose: Pose, own: Ownship) -> None:
        # Scans of the same sectors in one step are dated alike, so that only the newest one counts.
        scans = {(e.component, e.axes, e.first_deg): e for e in measured if isinstance(e, ObstacleScan)}
        for scan in list(scans.values())[-_MOST_SCANS:]:
            sight, view = sight_of_scan(scan, pose, self._config), View(scan, pose, self._config)
            self._objects.see(scan.component, sight.objects, pose, view)
            self._surfaces.see(scan.component, sight.surfaces, pose, view)
        points: dict[int, list[ObstaclePoint]] = {}
        for event in measured:
            if isinstance(event, ObstaclePoint):
                points.setdefault(event.component, []).append(event)
        for component, some in points.items():
            sight = sight_of_points(some, pose, self._config)
            self._objects.see(component, sight.objects, pose, None)
            self._surfaces.see(component, sight.surfaces, pose, None)
        aircraft = {(e.component, e.report.icao): e for e in measured if isinstance(e, SensedAircraft)}
        for (component, _), told in aircraft.items():
            place = self._aircraft(told, pose, own)
            if place is not None:
                self._objects.see(component, [place], pose, None)

    def _aircraft(self, event: SensedAircraft, pose: Pose, own: Ownship) -> Seen | None:
        """Place of an aircraft that the sensor follows; None if it is not where a sensor sees, or old.

        Its altitude is above mean sea level, as the message defines it.
        """
        report = event.report
        if own.frame is None or report.age_s > followed.EXPIRE_S:
            return None
        down = pose.position[2]
        if report.alt_m is not None:
            down = own.frame.alt_m - report.alt_m
        n, e, _ = own.frame.to_ned(report.lat_deg, report.lon_deg, own.frame.alt_m - down)
        away = math.dist((n, e, down), pose.position)
        if not self._config.min_range_m <= away <= self._config.max_range_m:
            return None
        velocity = report.velocity_ned_mps
        if velocity is not None and math.hypot(*velocity) > followed.MOST_MPS:
            return None
        return Seen(
            (n, e, down), 0.0, flat=False, number=report.icao, velocity=velocity,
            vertical_known=report.alt_m is not None,
        )  # fmt: skip

    # ------------------------------------------------------------ what the law is given

    def expire(self, now_s: float) -> None:
        """Remove what was not seen for too long."""
        self._objects.expire(now_s)
        self._surfaces.expire(now_s)

    @property
    def fused(self) -> dict[tuple[bool, str], str]:
        """Transmitted tracks that are left out because they are also sensed. Key: whether the track is from
        ADS-B, and its id. Value: id of the sensed track."""
        return {key: SENSED + name for key, name in self._fusing.fused.items()}

    def joined(self, now_s: float, own: Ownship, heard: Sequence[Neighbour]) -> list[Neighbour]:
        """The transmitted tracks that are not sensed, and all that is sensed, as input of the law.

        Args:
            heard: all transmitted tracks.
        """
        left = self._fusing.look(now_s, heard, self._confirmed(now_s), own.sigma_m)
        return left + self.look(now_s, own)

    def look(self, now_s: float, own: Ownship) -> list[Neighbour]:
        """All that is sensed, without a change of state."""
        here, sigma_m = own.position_ned_m(now_s), own.sigma_m
        found = [self._object(one, now_s, here, sigma_m) for one in self._confirmed(now_s)]
        return found + [
            self._patch(patch, now_s, here)
            for patch in self._surfaces.held.values()
            if patch.measured >= walls.CONFIRMED and 0.0 <= now_s - patch.at_s <= walls.EXPIRE_S
        ]

    def _confirmed(self, now_s: float) -> list[Followed]:
        return [one for one in self._objects.held if one.confirmed and 0.0 <= now_s - one.at_s <= one.kept_s]

    def _object(self, one: Followed, now_s: float, here: Vec3, own_sigma_m: float) -> Neighbour:
        """One object. Its position is relative to ours, with two exceptions, whose margin holds the larger of
        both errors, that of the measurement and that of the own position: an aircraft that the sensor follows
        itself is reported by its latitude and longitude, and a sensed object that stands for a transmitted
        track, too, is the same aircraft by inference only. If that is wrong, the other aircraft is where its
        track says, so the margin also holds the distance to there."""
        level = abs(one.position[2] - here[2]) <= _level_m(one.flat, one.distance_m)
        known = one.vertical_known and not one.tall and (not level or (one.moves and not one.flat))
        error_m = followed.TRACKED_SIGMA_M if one.tracked else self._error_m(one.distance_m)
        off = self._fusing.off.get(one.name)
        relative = not one.tracked and off is None
        margin_m = one.across_m + _ERRORS * error_m
        if off is not None:
            margin_m = max(margin_m, SIGMAS * own_sigma_m) + math.hypot(
                off[0], off[1], off[2] if known else 0.0
            )
        return Neighbour(
            track_id=SENSED + one.name,
            position_ned_m=one.position,
            velocity_ned_mps=one.seen_from(here),
            age_s=now_s - one.at_s,
            sigma_m=_sigma_m(margin_m, 0.0 if relative else own_sigma_m),
            sigma_mps=max(one.sigma_mps, _DRIFT_MPS) if one.moves else _DRIFT_MPS,
            share=1.0,
            vertical_known=known,
            proven=True,
            relative=relative,
        )

    def _patch(self, patch: Patch, now_s: float, here: Vec3) -> Neighbour:
        place = patch.place
        error_m = self._error_m(patch.distance_m)
        return Neighbour(
            track_id=f"{SENSED_WALL}{patch.name}",
            position_ned_m=place.position,
            velocity_ned_mps=(0.0, 0.0, 0.0),
            age_s=now_s - patch.at_s,
            sigma_m=_sigma_m(_aside_m(place, patch.distance_m) + _ERRORS * error_m, 0.0),
            sigma_mps=_DRIFT_MPS,
            share=1.0,
            vertical_known=abs(place.position[2] - here[2])
            > _level_m(place.flat, math.dist(place.position, here)),
            proven=True,
            relative=True,
        )

    def _error_m(self, distance_m: float) -> float:
        aim_m = distance_m * math.radians(self._config.bearing_sigma_deg)
        return math.hypot(self._config.range_sigma_m, aim_m)

    # ------------------------------------------------------------ what the pilot is told

    def told(self, now_s: float, *, armed: bool) -> list[Command]:
        """Texts for the pilot: measurements that cannot be used, scans that stopped."""
        if not armed or now_s - self._said_s < _AGAIN_S:
            return []
        text = None
        if self.trouble is not None and now_s - self._refused_since_s >= _REFUSED_S:
            text = f"obstacle sensor not used: {self.trouble}"
        elif self._scan_s is not None and now_s - self._scan_s >= _SILENT_S:
            text, self._scan_s = "obstacle sensor is silent", None
        if text is None:
            return []
        self._said_s = now_s
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {text}")]


def _level_m(flat: bool, distance_m: float) -> float:
    """Largest difference of heights (m) at which an object counts as being at our height."""
    return LEVEL_M + (_LEANS * distance_m if flat else 0.0)


def _aside_m(place: Seen, distance_m: float) -> float:
    """Margin (m) for the width of the sector, or points, in which a place of a surface was seen.

    The margin is half the width, but a quarter of it for a wide sector. The distance to the surface is
    measured in every sector, whatever its width: passing the middle of a sector of 45 degrees at 12 m keeps
    11 m or more from the true place. With half the width there would be no way around a wall, because the
    sectors beside the nearest one would block free space.
    """
    wide = place.flat and place.across_m > WIDE * distance_m
    return 0.5 * place.across_m if wide else place.across_m


def _sigma_m(margin_m: float, own_sigma_m: float) -> float:
    """Position error (m) to declare, so that the law keeps at least a margin in addition to its separation.

    Args:
        own_sigma_m: error of the own position, if the law adds it; otherwise 0.
    """
    return math.sqrt(max(0.0, (margin_m / SIGMAS) ** 2 - own_sigma_m**2))
