"""Remote ID messages of our own aircraft: its state, and the position of its operator."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import msgspec

from companion.config import Config, IdentityConfig, RemoteIdConfig
from companion.events import Landed
from companion.ownship import Ownship
from companion.remote_id.identity import public_operator_id
from companion.remote_id.messages import (
    BasicId,
    ClassificationType,
    HeightType,
    IdType,
    Location,
    Message,
    OperatorId,
    OperatorLocationType,
    SelfId,
    Status,
    System,
)

OPERATOR_FRESH_S = 10.0
"""An operator position that has not been renewed for this long is no longer broadcast."""
_STAMPS = 8
"""Number of remembered position timestamps. This many ground stations may repeat their positions. If a clock
is set back by this many seconds, it has passed its old timestamps within `OPERATOR_FRESH_S`."""
_ALTITUDES = (-999.5, 31767.5)
_HOME_MOVED_M = 10.0
"""If the altitudes of home and of the take-off differ by more than this, home was set anew. Heights are then
above the take-off. A smaller difference may be PX4's correction of a GNSS altitude that has drifted since the
take-off: then the height above home is right, and the altitude is not."""
_UTC = (1_546_300_801.0, 1_546_300_800.0 + 2**32 - 1)
"""Range of a System timestamp, from 2019 on."""


class Operator:
    """Position of the operator as last reported by a ground station.

    A position counts as renewed when its timestamp is new, not when it is repeated. An autopilot goes on
    relaying the last position of a ground station that has fallen silent, and two senders repeat theirs in
    turn. A position without a timestamp always counts as renewed. A ground station that has no position does
    not remove the position of another.
    """

    def __init__(self) -> None:
        self._system: System | None = None
        self._renewed_s = -math.inf
        self._stamps: deque[float] = deque(maxlen=_STAMPS)
        self.self_id: SelfId | None = None
        self.operator_id: OperatorId | None = None

    def hear(self, messages: tuple[Message, ...], now_s: float) -> None:
        """Take messages of a ground station."""
        for message in messages:
            if isinstance(message, System):
                if message.operator_lat_deg is None or message.operator_lon_deg is None:
                    continue
                stamp = message.timestamp_utc_s
                if stamp not in self._stamps:
                    self._system, self._renewed_s = message, now_s
                if stamp is not None and stamp not in self._stamps:
                    self._stamps.append(stamp)
            elif isinstance(message, SelfId) and message.text:
                self.self_id = message
            elif isinstance(message, OperatorId) and message.operator_id:
                self.operator_id = message

    def system(self, now_s: float) -> System | None:
        """The ground station's System while its position is fresh, else None."""
        return self._system if now_s - self._renewed_s <= OPERATOR_FRESH_S else None


def basic_id_of(identity: IdentityConfig) -> BasicId:
    """Basic ID of our aircraft."""
    return BasicId(id_type=identity.id_type, ua_type=identity.ua_type, uas_id=identity.uas_id)


def messages_of(
    config: Config, own: Ownship, operator: Operator, now_s: float, *, failed: bool
) -> tuple[Message, ...]:
    """All messages to broadcast now: Basic ID, Location, System, and those that are configured or received in
    addition.

    Args:
        failed: our broadcast is known not to work; the Location reports it.
    """
    identity, remote_id = config.identity, config.remote_id
    messages: list[Message] = [basic_id_of(identity)]
    if identity.registration_id is not None:
        messages.append(
            BasicId(
                id_type=IdType.CAA_REGISTRATION, ua_type=identity.ua_type, uas_id=identity.registration_id
            )
        )
    location = location_of(own, now_s, config.region.location_max_age_s)
    if failed:
        location = msgspec.structs.replace(location, status=Status.REMOTE_ID_SYSTEM_FAILURE)
    system = system_of(own, remote_id, operator, now_s)
    return (*messages, location, system, *_further(remote_id, operator))


def kinds_of(config: RemoteIdConfig, operator: Operator) -> frozenset[type[Message]]:
    """Kinds of the messages that `messages_of` would return, without making them."""
    return frozenset((BasicId, Location, System, *map(type, _further(config, operator))))


def lacking(config: Config, own: Ownship, operator: Operator, now_s: float) -> str | None:
    """What the messages lack for take-off, in the words that ground stations know from Remote ID modules;
    None if nothing is missing."""
    region = config.region
    if config.identity.id_type is IdType.NONE:
        return "missing basic_id message"
    if not _is_located(own, now_s, region.location_max_age_s):
        return "missing location message"
    if operator.system(now_s) is None and own.takeoff is None:
        return "missing operator location"
    if region.operator_id_required and config.remote_id.operator_id is None and operator.operator_id is None:
        return "missing operator_id message"
    return None


def _further(config: RemoteIdConfig, operator: Operator) -> list[Message]:
    """Messages besides Basic ID, Location and System: the configured ones, else those of the operator."""
    found: list[Message] = []
    if config.self_id is not None:
        found.append(SelfId(description_type=0, text=config.self_id))
    elif operator.self_id is not None:
        found.append(operator.self_id)
    if config.operator_id is not None:
        found.append(OperatorId(operator_id_type=0, operator_id=public_operator_id(config.operator_id)))
    elif operator.operator_id is not None:
        found.append(operator.operator_id)
    return found


def _is_located(own: Ownship, now_s: float, max_age_s: float) -> bool:
    """Whether the own position is known well enough to be broadcast."""
    gnss = own.gnss
    return own.age_s(now_s) <= max_age_s and (gnss is None or gnss.fix_type >= 2)


def location_of(own: Ownship, now_s: float, max_age_s: float) -> Location:
    """Location message of our own state.

    The position is extrapolated along our velocity to the tenth of a second that the timestamp can hold, so
    that the timestamp's resolution adds no error. Without a timestamp it is extrapolated to now, because
    receivers then date it by its reception. A position that is too old is left out and the status reports a
    system failure: sending nothing would look like an empty sky.
    """
    position = own.position
    if position is None or not _is_located(own, now_s, max_age_s):
        return Location(status=Status.REMOTE_ID_SYSTEM_FAILURE)
    landed = own.landed(now_s)
    # The receiver's accuracies are not those of an estimate that does not follow it.
    accuracy = None if own.estimator_lost(now_s) else own.gnss_now(now_s)
    lat, lon, alt_msl = position.lat_deg, position.lon_deg, position.alt_msl_m
    height = position.height_above_home_m
    if own.takeoff is not None and abs(alt_msl - own.takeoff.alt_msl_m - height) > _HOME_MOVED_M:
        height = alt_msl - own.takeoff.alt_msl_m
    north, east, down = own.velocity_ned_mps
    timestamp, at_s = None, now_s
    if own.utc_offset_s is not None:
        tenth = math.floor((now_s + own.utc_offset_s) * 10.0) / 10.0
        at_s = tenth - own.utc_offset_s
        timestamp = round(tenth % 3600.0, 1)
    ahead = at_s - own.sample_s()
    lat += math.degrees(north * ahead / 6_378_137.0)
    lon += math.degrees(east * ahead / (6_378_137.0 * max(math.cos(math.radians(lat)), 1e-6)))
    lat, lon = min(max(lat, -90.0), 90.0), (lon + 180.0) % 360.0 - 180.0
    alt_msl -= down * ahead
    height -= down * ahead
    speed = math.hypot(north, east)
    in_air = landed in (Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING)
    status = Status.AIRBORNE if in_air else Status.GROUND if landed is Landed.ON_GROUND else Status.UNDECLARED
    return Location(
        status=status,
        lat_deg=lat,
        lon_deg=lon,
        alt_geodetic_m=None if own.separation_m is None else _within(alt_msl + own.separation_m, *_ALTITUDES),
        height_type=HeightType.ABOVE_TAKEOFF,
        height_m=_within(height, *_ALTITUDES),
        direction_deg=math.degrees(math.atan2(east, north)) % 360.0,
        speed_mps=_within(speed, 0.0, 254.25),
        vertical_speed_mps=_within(-down, -62.0, 62.0),
        horizontal_accuracy_m=None if accuracy is None else accuracy.horizontal_accuracy_m,
        vertical_accuracy_m=None if accuracy is None else accuracy.vertical_accuracy_m,
        speed_accuracy_mps=None if accuracy is None else accuracy.speed_accuracy_mps,
        timestamp_s=timestamp,
    )


def _within(value: float, low: float, high: float) -> float | None:
    """The value, or None (unknown) if the message cannot hold it."""
    return value if low <= value <= high else None


def system_of(own: Ownship, config: RemoteIdConfig, operator: Operator, now_s: float) -> System:
    """System message with the operator position: the ground station's while it is fresh, else the take-off
    point. The message shows which of the two it is. The position is unknown when there is neither."""
    told = operator.system(now_s)
    altitude, utc = None, None
    if own.utc_offset_s is not None:
        utc = _within(float(math.floor(now_s + own.utc_offset_s)), *_UTC)
    if told is not None:
        return msgspec.structs.replace(told, timestamp_utc_s=utc, **_classification(config))
    takeoff = own.takeoff
    if takeoff is not None and own.separation_m is not None:
        altitude = _within(takeoff.alt_msl_m + own.separation_m, *_ALTITUDES)
    return System(
        operator_location_type=OperatorLocationType.TAKEOFF,
        operator_lat_deg=None if takeoff is None else takeoff.lat_deg,
        operator_lon_deg=None if takeoff is None else takeoff.lon_deg,
        operator_alt_geodetic_m=altitude,
        timestamp_utc_s=utc,
        **_classification(config),
    )


def _classification(config: RemoteIdConfig) -> dict[str, Any]:
    if config.category_eu is None and config.class_eu is None:
        return {}
    return {
        "classification_type": ClassificationType.EU,
        "category_eu": config.category_eu or 0,
        "class_eu": config.class_eu or 0,
    }
