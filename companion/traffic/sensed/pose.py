"""Position and attitude of the own vehicle at the time of a measurement.

A measurement is used only with an attitude and a position that are recent enough: a wrong heading of ten
degrees moves an obstacle 40 m away by 7 m.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

from companion.events import Attitude, LocalPosition
from companion.geometry import Vec3
from companion.ownship import Ownship

ATTITUDE_S: Final = 0.25
"""Largest difference in time of a measurement and the attitude that it is used with."""
MOST_TILT_RAD: Final = math.radians(45.0)
MOST_TURN_RPS: Final = math.radians(90.0)
"""Measurements of a vehicle that leans more, or turns faster, are not used."""
SKEW_S: Final = 0.05
"""Error of the time of a measurement relative to that of an attitude."""
_KEPT_S: Final = 2.0
_KEPT: Final = 64
_TURN_OVER_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Pose:
    """The own vehicle at the time of a measurement."""

    at_s: float
    """Our monotonic time of the measurement."""
    position: Vec3
    """Local NED, m."""
    velocity: Vec3
    """NED, m/s."""
    rows: tuple[Vec3, Vec3, Vec3]
    """Rows of the matrix that turns body axes (forward, right, down) into NED."""
    yaw_rad: float
    turn_rps: float
    """Magnitude of its turn rate."""
    home_down_m: float
    """NED down of home."""
    local: Vec3 | None
    """The own position in the autopilot's local frame, NED, m; None: not known."""

    def turned(self, forward: float, right: float, down: float) -> Vec3:
        """Rotate a vector from body axes to NED."""
        a, b, c = self.rows
        return (
            a[0] * forward + a[1] * right + a[2] * down,
            b[0] * forward + b[1] * right + b[2] * down,
            c[0] * forward + c[1] * right + c[2] * down,
        )


class _Turned(NamedTuple):
    at_s: float
    roll: float
    pitch: float
    yaw: float


class Poses:
    """The latest attitudes, by which measurements are placed."""

    def __init__(self) -> None:
        self._attitudes: deque[_Turned] = deque(maxlen=_KEPT)
        self._local: tuple[float, Vec3] | None = None

    def clear(self) -> None:
        """Forget everything."""
        self._attitudes.clear()
        self._local = None

    def note_attitude(self, event: Attitude, now_s: float) -> None:
        """Take in an attitude that arrived now."""
        kept = self._attitudes
        while kept and (now_s - kept[0].at_s > _KEPT_S or kept[0].at_s > now_s):
            kept.popleft()
        kept.append(_Turned(now_s, event.roll_rad, event.pitch_rad, event.yaw_rad))

    def note_local(self, event: LocalPosition, now_s: float) -> None:
        """Take in a position in the autopilot's local frame that arrived now."""
        self._local = now_s, event.position_ned_m

    def at(self, at_s: float, now_s: float, own: Ownship, stale_after_s: float) -> Pose | str:
        """The pose at a time up to now, or why there is none, in words."""
        unfit = own.unfit(now_s, stale_after_s)
        if unfit is not None:
            return unfit
        if own.frame is None or own.position is None:
            return "no own position"
        near = min(self._attitudes, key=lambda a: abs(a.at_s - at_s), default=None)
        if near is None or abs(near.at_s - at_s) > ATTITUDE_S:
            return "no attitude" if near is None else f"attitude older than {ATTITUDE_S:g} s"
        if math.acos(max(-1.0, min(1.0, math.cos(near.roll) * math.cos(near.pitch)))) > MOST_TILT_RAD:
            return f"leaning more than {math.degrees(MOST_TILT_RAD):.0f} deg"
        turn_rps = self._turn_rps(near)
        if turn_rps > MOST_TURN_RPS:
            return f"turning faster than {math.degrees(MOST_TURN_RPS):.0f} deg/s"
        here = own.position_ned_m(at_s)
        local = self._local
        return Pose(
            at_s=at_s,
            position=here,
            velocity=own.velocity_ned_mps,
            rows=_rows(near.roll, near.pitch, near.yaw),
            yaw_rad=near.yaw,
            turn_rps=turn_rps,
            home_down_m=own.position.height_above_home_m - (own.position.alt_msl_m - own.frame.alt_m),
            local=local[1] if local is not None and now_s - local[0] <= stale_after_s else None,
        )

    def _turn_rps(self, near: _Turned) -> float:
        """Magnitude of the vehicle's turn rate at an attitude, from the nearest attitudes some time before or
        after it."""
        fastest = 0.0
        for side in (-1.0, 1.0):
            apart = [a for a in self._attitudes if side * (a.at_s - near.at_s) >= _TURN_OVER_S - 1e-6]
            other = min(apart, key=lambda a: abs(a.at_s - near.at_s), default=None)
            if other is not None and abs(other.at_s - near.at_s) <= 2.0 * ATTITUDE_S:
                turned = math.remainder(other.yaw - near.yaw, math.tau)
                fastest = max(fastest, abs(turned / (other.at_s - near.at_s)))
        return fastest


def _rows(roll: float, pitch: float, yaw: float) -> tuple[Vec3, Vec3, Vec3]:
    """Rotation from body axes to NED: yaw, then pitch, then roll."""
    sr, cr, sp, cp, sy, cy = (
        math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch), math.sin(yaw), math.cos(yaw),
    )  # fmt: skip
    return (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )
