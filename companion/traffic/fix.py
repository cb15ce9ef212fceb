"""Converts a received Location into our local frame and to our clock.

The Location timestamp counts tenths of a second after the full UTC hour. Of all hours, the one is taken that
brings the message nearest to our own UTC.
"""

from __future__ import annotations

import math

import msgspec

from companion.geometry import LocalFrame, Vec3
from companion.remote_id.messages import Location

SIGMA_UNKNOWN_M = 5.0
"""Horizontal standard deviation assumed for a sender that declares no accuracy."""
SIGMA_MOST_M = 15.0
"""Largest horizontal standard deviation that is used. With a volume of kilometres every velocity would be in
conflict."""
SIGMA_MOST_MPS = 0.5
"""Standard deviation of a velocity whose accuracy is not declared, and the largest that is used otherwise.
Receivers measure velocity by Doppler, far more accurately than the bounds that they declare."""
SIGMA_CLOCKLESS_M = 5.0
"""Standard deviation added (in quadrature) for a message that is dated by its reception."""
VERTICAL_ACCURACY_M = 10.0
"""With a worse declared vertical accuracy, the height counts as unknown."""
ALTITUDES_M = (-500.0, 20_000.0)
"""A height beyond these altitudes is impossible and counts as unknown. Otherwise its aircraft, which may be
at our height, would be avoided nowhere."""


class Fix(msgspec.Struct):
    """A Location converted into our local frame (NED) and to our clock."""

    position: Vec3
    velocity: Vec3 | None
    sigma_m: float
    sigma_mps: float
    vertical_known: bool
    stamp_s: float | None
    """Our monotonic time of the message by the sender's clock; None if that clock is not trusted."""
    lead_s: float | None
    """How far the timestamp lies in our future, trusted or not; None without a timestamp or without our
    UTC."""
    content: Location
    too_fast: bool = False
    """Whether the message declares an impossible speed. `velocity` is then unknown: the place may be true."""


def make_fix(
    message: Location,
    now_s: float,
    utc_offset_s: float | None,
    frame: LocalFrame,
    separation_m: float | None,
    max_clock_offset_s: float,
) -> Fix | None:
    """The fix of one Location; None if it has no position.

    Args:
        utc_offset_s: our UTC minus `now_s`; None while unknown.
        frame: local frame (its altitude datum is mean sea level).
        separation_m: height of the geoid above the ellipsoid here; None while unknown.
        max_clock_offset_s: a timestamp farther than this from our UTC is not trusted.
    """
    if message.lat_deg is None or message.lon_deg is None:
        return None
    altitude_m = message.alt_geodetic_m
    if altitude_m is not None and not ALTITUDES_M[0] <= altitude_m <= ALTITUDES_M[1]:
        altitude_m = None
    vertical_known = altitude_m is not None and separation_m is not None
    if message.vertical_accuracy_m is not None and message.vertical_accuracy_m > VERTICAL_ACCURACY_M:
        vertical_known = False
    alt_msl_m = frame.alt_m
    if altitude_m is not None and separation_m is not None:
        alt_msl_m = altitude_m - separation_m
    # Senders declare their GNSS receiver's own estimate, which is nearer to one sigma than to the 95 % bound.
    accuracy = message.horizontal_accuracy_m
    sigma = SIGMA_UNKNOWN_M if accuracy is None else min(accuracy, SIGMA_MOST_M)
    lead_s = _lead(message, now_s, utc_offset_s)
    stamp_s = None
    if lead_s is not None and abs(lead_s) <= max_clock_offset_s:
        stamp_s = now_s + lead_s
    else:
        sigma = math.hypot(sigma, SIGMA_CLOCKLESS_M)
    return Fix(
        position=frame.to_ned(message.lat_deg, message.lon_deg, alt_msl_m),
        velocity=_velocity(message),
        sigma_m=sigma,
        sigma_mps=min(message.speed_accuracy_mps or SIGMA_MOST_MPS, SIGMA_MOST_MPS),
        vertical_known=vertical_known,
        stamp_s=stamp_s,
        lead_s=lead_s,
        content=message,
    )


def _lead(message: Location, now_s: float, utc_offset_s: float | None) -> float | None:
    """The timestamp minus our UTC (s), with the hour that brings both nearest."""
    if message.timestamp_s is None or utc_offset_s is None:
        return None
    utc_now = now_s + utc_offset_s
    hours = round((utc_now - message.timestamp_s) / 3600.0)
    return message.timestamp_s + 3600.0 * hours - utc_now


def _velocity(message: Location) -> Vec3 | None:
    """Velocity (local NED, m/s) that a Location declares; None if speed or direction is unknown."""
    down = -(message.vertical_speed_mps or 0.0)
    if message.speed_mps is None:
        return None
    if message.direction_deg is None:
        return (0.0, 0.0, down) if message.speed_mps == 0.0 else None
    course = math.radians(message.direction_deg)
    return message.speed_mps * math.cos(course), message.speed_mps * math.sin(course), down


# ---------------------------------------------------------------- what a fix says of its aircraft


class Belief(msgspec.Struct, frozen=True):
    """A state in which a track was reported; NED."""

    at_s: float
    told_s: float
    """When it was received (our monotonic time)."""
    agreed_s: float
    """When a message that agrees with it was last received."""
    position: Vec3
    velocity: Vec3
    sigma_m: float
    sigma_mps: float
    vertical_known: bool
    height_m: float
    """Error of the height that the sender declared."""

    def agrees(self, other: Belief) -> bool:
        """Whether this state predicts the other one, apart from noise and a gentle manoeuvre.

        A forged state that agrees with the true one replaces it. The allowed noise is therefore well within
        the margin that the law keeps for the same declared error (`law.SIGMAS`).
        """
        passed_s = other.at_s - self.at_s
        (n, e, d), (vn, ve, vd) = self.position, self.velocity
        (on, oe, od), (ovn, ove, ovd) = other.position, other.velocity
        # Timestamps are the sender's: only the time that passed here leaves room for a manoeuvre.
        room_s = min(abs(passed_s), abs(other.told_s - self.told_s))
        bent_m = 2.0 + 0.5 * _GENTLE_MPS2 * room_s * room_s
        noise_m = _NOISE * math.sqrt(self.sigma_m * self.sigma_m + other.sigma_m * other.sigma_m)
        if math.hypot(on - n - passed_s * vn, oe - e - passed_s * ve) > bent_m + noise_m:
            return False
        if self.vertical_known and other.vertical_known:
            noise_m = 2.0 * (self.height_m + other.height_m)
            if abs(od - d - passed_s * vd) > bent_m + noise_m:
                return False
        return math.hypot(ovn - vn, ove - ve, ovd - vd) <= _GENTLE_MPS + _GENTLE_MPS2 * room_s


def hold(
    beliefs: list[Belief], told: Belief, now_s: float, least_s: float, agreeing: Belief | None = None
) -> None:
    """Add a belief, or replace one that agrees with it and was received at least `least_s` earlier. An
    agreeing belief that is kept counts as confirmed.

    Args:
        agreeing: a belief that is known to agree; None if none is.
    """
    for number, belief in enumerate(beliefs):
        if belief is agreeing or belief.agrees(told):
            news = told.told_s - belief.told_s >= least_s
            kept = told if news else belief
            beliefs[number] = (
                kept if kept.agreed_s == now_s else msgspec.structs.replace(kept, agreed_s=now_s)
            )
            return
    beliefs.append(told)


_GENTLE_MPS2, _GENTLE_MPS = 5.0, 2.5
_NOISE = 2.0
"""Two states may agree if they differ by up to this many standard deviations of both positions."""


def belief_of(fix: Fix, velocity: Vec3, now_s: float) -> Belief:
    """The belief that follows from a fix that is received now.

    Args:
        velocity: the aircraft's velocity, used if the fix declares none.
    """
    return Belief(
        at_s=now_s if fix.stamp_s is None else min(fix.stamp_s, now_s),
        told_s=now_s,
        agreed_s=now_s,
        position=fix.position,
        velocity=fix.velocity or velocity,
        sigma_m=fix.sigma_m,
        sigma_mps=fix.sigma_mps,
        vertical_known=fix.vertical_known,
        height_m=height_error_m(fix.content),
    )


def height_error_m(content: Location) -> float:
    """Error of a height (m) that its sender declares; a default if it declares none."""
    return content.vertical_accuracy_m or _HEIGHT_UNKNOWN_M


_HEIGHT_UNKNOWN_M = 10.0
