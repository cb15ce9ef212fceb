"""Flown senders for the tests of flags: an honest aircraft's messages, and ways to bend them."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

from companion.config import TrafficConfig
from companion.events import RemoteIdHeard, TrackFlagged
from companion.remote_id.codec import decode, encode
from companion.remote_id.messages import BasicId, IdType, Location, Message, Status, UaType
from companion.traffic.plausibility import Flag
from companion.traffic.tracks import Traffic
from tests.support.place import HOME

SEPARATION_M = 47.0
UTC_OFFSET_S = 1_767_225_600.0
"""A full hour: a timestamp equals the time since then."""

Motion = Callable[[float], tuple[float, float, float, float, float]]
"""Time (s) -> north, east (m), north and east velocity (m/s), height (m)."""


class Listener:
    """A Traffic with the arguments that do not change; it reports flags after every frame."""

    def __init__(self, utc_offset_s: float | None = UTC_OFFSET_S, own: str = "OWN", **config: object) -> None:
        self.traffic = Traffic(TrafficConfig(**config), own)  # type: ignore[arg-type]
        self.utc_offset_s = utc_offset_s
        self.reports: list[TrackFlagged] = []
        self.ever: set[Flag] = set()
        """Flags that any track ever had."""

    def hear(
        self, now_s: float, *messages: Message, address: str = "a", transport: str = "wifi", rssi=None
    ) -> None:
        heard = RemoteIdHeard(transport=transport, address=address, messages=messages, rssi_dbm=rssi)
        self.traffic.hear(heard, now_s, self.utc_offset_s, HOME, SEPARATION_M)
        for track in self.traffic.tracks.values():
            self.ever |= track.flags
        self.reports += self.traffic.flagged(now_s)

    def flags(self, track_id: str = "X") -> frozenset[Flag]:
        return self.traffic.tracks[track_id].flags


def basic(uas_id: str = "X", id_type: IdType = IdType.SERIAL_NUMBER) -> BasicId:
    return BasicId(id_type=id_type, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=uas_id)


def location(motion: Motion, at_s: float, noise: random.Random | None = None, **change: object) -> Location:
    """What a sound sender says about the moment, after coding; `noise` at its declared accuracies."""
    north, east, v_north, v_east, height = motion(at_s)
    if noise is not None:
        north, east = noise.gauss(north, 3.0), noise.gauss(east, 3.0)
        v_north, v_east = noise.gauss(v_north, 0.5), noise.gauss(v_east, 0.5)
        height = noise.gauss(height, 3.0)
    lat, lon, _ = HOME.to_geodetic(north, east, 0.0)
    values: dict[str, object] = {
        "status": Status.AIRBORNE,
        "lat_deg": lat,
        "lon_deg": lon,
        "alt_geodetic_m": 447.0 + height,
        "speed_mps": math.hypot(v_north, v_east),
        "direction_deg": math.degrees(math.atan2(v_east, v_north)) % 360.0,
        "vertical_speed_mps": 0.0,
        "horizontal_accuracy_m": 3.0,
        "vertical_accuracy_m": 3.0,
        "speed_accuracy_mps": 1.0,
        "timestamp_s": round(at_s % 3600.0, 1),
    }
    message = decode(encode(Location(**{**values, **change})))  # type: ignore[arg-type]
    assert isinstance(message, Location)
    return message


def fly(
    listener: Listener,
    motion: Motion,
    times_s: Sequence[float],
    delay_s: float = 0.2,
    identity: str = "X",
    address: str = "a",
    transport: str = "wifi",
    noise: random.Random | None = None,
    clock_s: float = 0.0,
    **change: object,
) -> None:
    """Messages of these moments, heard `delay_s` later; the sender's clock leads by `clock_s`."""
    for at_s in times_s:
        stamp = {"timestamp_s": round((at_s + clock_s) % 3600.0, 1)}
        message = location(motion, at_s, noise, **{**stamp, **change})
        listener.hear(at_s + delay_s, basic(identity), message, address=address, transport=transport)


def seconds(count: int, start_s: float = 10.0, rate_hz: float = 1.0) -> list[float]:
    """Moments of messages."""
    return [start_s + k / rate_hz for k in range(count)]


def straight(speed_mps: float = 15.0, north_m: float = 200.0, east_m: float = -300.0) -> Motion:
    """East, level."""
    return lambda t: (north_m, east_m + speed_mps * (t - 10.0), 0.0, speed_mps, 50.0)


def circle(speed_mps: float, acceleration_mps2: float) -> Motion:
    """A turn that never ends."""
    radius, rate = speed_mps**2 / acceleration_mps2, acceleration_mps2 / speed_mps
    return lambda t: (
        radius * math.sin(rate * t),
        radius * math.cos(rate * t),
        speed_mps * math.cos(rate * t),
        -speed_mps * math.sin(rate * t),
        50.0,
    )


def stop_and_go(
    speed_mps: float, deceleration_mps2: float, cruise_s: float = 6.0, hover_s: float = 3.0
) -> Motion:
    """A helicopter: cruises, brakes to a hover, goes on, for ever."""
    brake_s = speed_mps / deceleration_mps2
    period_s, ahead_m = cruise_s + 2.0 * brake_s + hover_s, speed_mps * (cruise_s + brake_s)

    def motion(t: float) -> tuple[float, float, float, float, float]:
        laps, u = divmod(t, period_s)
        x = min(u, cruise_s) * speed_mps
        v = speed_mps
        if u > cruise_s:
            b = min(u - cruise_s, brake_s)
            x, v = x + speed_mps * b - 0.5 * deceleration_mps2 * b * b, speed_mps - deceleration_mps2 * b
        if u > cruise_s + brake_s + hover_s:
            a = u - cruise_s - brake_s - hover_s
            x, v = x + 0.5 * deceleration_mps2 * a * a, deceleration_mps2 * a
        return 100.0, -2000.0 + laps * ahead_m + x, 0.0, v, 50.0

    return motion
