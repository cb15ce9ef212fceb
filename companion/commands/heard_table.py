"""The aircraft that were received lately, and their texts, as `companion remote-id listen` shows them.

All data comes from received messages and is not trusted: the table is bounded, and no text holds a character
that could control a terminal.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Final

import msgspec

from companion.events import RemoteIdHeard
from companion.radio.radio import Health
from companion.remote_id.messages import BasicId, IdType, Location, OperatorId, SelfId, System

MAX_AIRCRAFT: Final = 200
FORGET_S: Final = 300.0
"""Aircraft that were not received for this long are removed from the table."""
_RATE_OVER_S: Final = 10.0
_MAX_SAMPLES: Final = 200
_MAX_ADDRESSES: Final = 4
_TEXT_IDS: Final = (IdType.SERIAL_NUMBER, IdType.CAA_REGISTRATION)


@dataclass(slots=True)
class Aircraft:
    """Messages and reception data of one aircraft."""

    basic_id: BasicId | None = None
    """The first Basic ID with an identity. A second one (a registration in addition to the serial number)
    does not replace it."""
    addresses: dict[str, None] = field(default_factory=dict)
    transports: dict[str, None] = field(default_factory=dict)
    rssi_dbm: float | None = None
    last_s: float = 0.0
    location: Location | None = None
    system: System | None = None
    operator_id: OperatorId | None = None
    self_id: SelfId | None = None
    messages: int = 0
    arrivals: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=_MAX_SAMPLES))
    """Arrival time and number of messages of each frame, the latest `_MAX_SAMPLES` frames."""

    def rate_per_s(self, now_s: float) -> float:
        """Messages per second over the last ten seconds."""
        recent = [(at_s, count) for at_s, count in self.arrivals if now_s - at_s < _RATE_OVER_S]
        # If the samples do not reach back ten seconds, the rate is taken over the time since the first
        # sample.
        over_s = max(1.0, now_s - self.arrivals[0][0]) if self.arrivals else 1.0
        return sum(count for _, count in recent) / min(over_s, _RATE_OVER_S)


class HeardTable:
    """The aircraft that were received lately, at most `MAX_AIRCRAFT`.

    Frames are assigned to an aircraft by their radio address until it has sent its identity, then by its
    identity. An aircraft that sends from several addresses is therefore one row. Two transmitters that claim
    the same identity share a row, which shows both addresses.
    """

    def __init__(self) -> None:
        self._by_key: dict[tuple[str, str], Aircraft] = {}
        """Aircraft in order of last reception. Keys: ("id", identity) or ("at", address)."""
        self._names: dict[str, tuple[str, str]] = {}
        """Address -> key of the aircraft that sent its identity from it and still holds the address."""

    def __len__(self) -> int:
        return len(self._by_key)

    def newest_first(self) -> list[Aircraft]:
        """All aircraft, the most recently received first."""
        return list(reversed(self._by_key.values()))

    def add(self, event: RemoteIdHeard, now_s: float) -> Aircraft:
        """Add a received frame. Returns the aircraft to which it belongs."""
        key = self._key_of(event)
        aircraft = self._by_key.pop(key, None) or Aircraft()
        self._by_key[key] = aircraft
        aircraft.transports[event.transport] = None
        aircraft.addresses.pop(event.address, None)
        aircraft.addresses[event.address] = None
        if len(aircraft.addresses) > _MAX_ADDRESSES:
            oldest = next(iter(aircraft.addresses))
            del aircraft.addresses[oldest]
            self._names.pop(oldest, None)
        aircraft.rssi_dbm, aircraft.last_s = event.rssi_dbm, now_s
        aircraft.messages += len(event.messages)
        aircraft.arrivals.append((now_s, len(event.messages)))
        for message in event.messages:
            match message:
                case BasicId() if aircraft.basic_id is None and _names(message):
                    aircraft.basic_id = message
                case Location():
                    aircraft.location = message
                case System():
                    aircraft.system = message
                case OperatorId():
                    aircraft.operator_id = message
                case SelfId():
                    aircraft.self_id = message
        while len(self._by_key) > MAX_AIRCRAFT:
            self._drop(next(iter(self._by_key)))
        return aircraft

    def forget(self, now_s: float) -> None:
        """Remove aircraft that were not received for `FORGET_S`."""
        while self._by_key:
            key = next(iter(self._by_key))
            if now_s - self._by_key[key].last_s <= FORGET_S:
                return
            self._drop(key)

    def _key_of(self, event: RemoteIdHeard) -> tuple[str, str]:
        known = self._names.get(event.address)
        if known is not None:
            return known
        unnamed = ("at", event.address)
        identity = next((m.uas_id for m in event.messages if isinstance(m, BasicId) and _names(m)), None)
        if identity is None:
            return unnamed
        key = ("id", identity)
        before = self._by_key.pop(unnamed, None)
        if before is not None and key not in self._by_key:
            self._by_key[key] = before
        self._names[event.address] = key
        return key

    def _drop(self, key: tuple[str, str]) -> None:
        for address in self._by_key.pop(key).addresses:
            self._names.pop(address, None)


def _names(message: BasicId) -> bool:
    return message.id_type is not IdType.NONE and bool(message.uas_id)


# ---------------------------------------------------------------- in words


def plain(text: str) -> str:
    """Text that cannot control a terminal: unprintable characters are replaced by their code."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def identity_words(basic_id: BasicId | None) -> str:
    """The identity as text; raw identities (UUID, session id) in hexadecimal; "?" if unknown."""
    if basic_id is None:
        return "?"
    if basic_id.id_type in _TEXT_IDS:
        return plain(basic_id.uas_id)
    return basic_id.uas_id.encode("latin-1", "replace").hex()


def cells(aircraft: Aircraft, now_s: float) -> dict[str, str]:
    """Row of the table for an aircraft: text by column name. "-" means unknown."""
    location = aircraft.location or Location()
    system = aircraft.system or System()
    basic = aircraft.basic_id
    altitude, datum = location.alt_geodetic_m, ""
    if altitude is None:
        altitude, datum = location.alt_baro_m, " baro"
    return {
        "identity": identity_words(basic),
        "type": "-" if basic is None else basic.ua_type.name.lower().replace("_", " "),
        "on": "+".join(sorted(aircraft.transports)),
        "address": " ".join(plain(address) for address in aircraft.addresses),
        "dBm": _number(aircraft.rssi_dbm, 0),
        "age s": f"{max(0.0, now_s - aircraft.last_s):.1f}",
        "position": _place(location.lat_deg, location.lon_deg),
        "alt m": _number(altitude, 1) + (datum if altitude is not None else ""),
        "m/s": _number(location.speed_mps, 1),
        "track": "-" if location.direction_deg is None else f"{location.direction_deg:.0f}°",
        "status": location.status.name.lower().replace("_", " ") if aircraft.location else "-",
        "operator": "-" if aircraft.operator_id is None else plain(aircraft.operator_id.operator_id),
        "operator at": _place(system.operator_lat_deg, system.operator_lon_deg),
        "about": "" if aircraft.self_id is None else plain(aircraft.self_id.text),
        "msg/s": f"{aircraft.rate_per_s(now_s):.1f}",
    }


def health_words(health: Health, aircraft: int) -> str:
    """State of the radios and counts of what they received, in one line."""
    state = "" if health.ok else "NOT OK: "
    return (
        f"{state}{plain(health.text)}; {aircraft} aircraft, {health.frames_heard} frames heard, "
        f"{health.bad_frames} bad"
    )


def json_line(event: RemoteIdHeard, utc_s: float) -> str:
    """A received frame as one line of JSON; characters that could control a terminal are escaped."""
    fields = msgspec.to_builtins(event)
    del fields["type"]
    text = msgspec.json.encode({"time_utc_s": round(utc_s, 3), **fields}).decode()
    return "".join(c if c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    units = character.encode("utf-16-be")
    return "".join(f"\\u{units[at : at + 2].hex()}" for at in range(0, len(units), 2))


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _place(lat_deg: float | None, lon_deg: float | None) -> str:
    return "-" if lat_deg is None or lon_deg is None else f"{lat_deg:.6f} {lon_deg:.6f}"


COLUMNS: Final = tuple(cells(Aircraft(), 0.0))
