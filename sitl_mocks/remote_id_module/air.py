"""Transmissions of a module with ArduRemoteID firmware, and their timing.

The facts are from the firmware's main loop and its two drivers (BLE_TX, WiFi_TX), version 1.14. A transport
with rate 0 gets no new payload, but its last payload stays on the air: the radio repeats an advertisement or
a beacon element by itself. Only NAN frames are sent one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from companion.remote_id.codec import PACK_HEADER_SIZE, encode, read_payload
from companion.remote_id.frames import build_beacon, build_ble4, build_ble5, build_nan_action
from companion.remote_id.messages import BasicId, Location, Message, OperatorId, SelfId, System
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

RATES = {BLE4: "BT4_RATE", BLE5: "BT5_RATE", WIFI_BEACON: "WIFI_BCN_RATE", WIFI_NAN: "WIFI_NAN_RATE"}
BEACON_INTERVAL_S = 0.1024
"""Beacon interval of the access point, 100 TU. It does not depend on WIFI_BCN_RATE."""
_LEGACY_ORDER: tuple[type[Message], ...] = (Location, BasicId, SelfId, System, OperatorId)
_LEGACY_SLOTS_PER_CYCLE = 7


@dataclass(frozen=True, slots=True)
class OnAir:
    """Transmission of one transport that a receiver can hear now."""

    transport: str
    payload: bytes
    """A message (BLE 4) or a message pack, which may be empty. No bytes for a BLE 4 name or an empty slot."""
    frame: bytes | None
    """AdvData or management frame; None if the payload contains no message."""
    age_s: float
    """Time since the payload was last refreshed."""
    interval_s: float
    """Time between two transmissions of the payload; for NAN, time between two payloads."""

    @property
    def messages(self) -> tuple[Message, ...]:
        """Messages in the payload."""
        return read_payload(self.payload).messages if self.payload else ()


@dataclass(slots=True)
class _Slot:
    """The latest payload of a transport."""

    payload: bytes
    counter: int
    at_s: float


@dataclass(slots=True)
class Air:
    """The transmitters of a module from one start to the next."""

    address: str
    _slots: dict[str, _Slot] = field(default_factory=dict)
    _ble_interval_s: dict[str, float] | None = None
    """Advertising intervals, computed from the rates when Bluetooth is first used and fixed from then on."""
    _phase: int = 0
    _channel: int | None = None

    @property
    def wifi_channel(self) -> int | None:
        """Wi-Fi channel, fixed when Wi-Fi is first used; None before."""
        return self._channel

    def advance(
        self, messages: Sequence[Message], params: Mapping[str, float], now_s: float
    ) -> frozenset[str]:
        """Refresh the payloads that are due. Return the transports refreshed."""
        due = frozenset(
            transport
            for transport, name in RATES.items()
            if params[name] > 0.0 and self._is_due(transport, params[name], messages, now_s)
        )
        if due & {BLE4, BLE5} and self._ble_interval_s is None:
            cycles = {BLE4: params["BT4_RATE"] * _LEGACY_SLOTS_PER_CYCLE, BLE5: params["BT5_RATE"]}
            # With a rate of 0 the interval is not a number, and that advertising set never goes on the air.
            self._ble_interval_s = {t: 1.0 / rate for t, rate in cycles.items() if rate > 0.0}
        if due & {WIFI_BEACON, WIFI_NAN} and self._channel is None:
            self._channel = int(params["WIFI_CHANNEL"])
        for transport in due:
            payload = self._legacy(messages) if transport == BLE4 else _pack(messages)
            before = self._slots.get(transport)
            counter = 0 if before is None else (before.counter + 1) & 0xFF
            self._slots[transport] = _Slot(payload, counter, now_s)
        return due

    def on_air(self, params: Mapping[str, float], now_s: float) -> list[OnAir]:
        """Return the transmissions that can be received now."""
        found = []
        for transport, slot in self._slots.items():
            interval_s = self._interval_s(transport, params)
            if interval_s is None:
                continue
            age_s = now_s - slot.at_s
            if transport == WIFI_NAN and age_s > 2.0 * interval_s:
                continue
            found.append(OnAir(transport, slot.payload, self._frame(transport, slot), age_s, interval_s))
        return found

    def _is_due(self, transport: str, rate: float, messages: Sequence[Message], now_s: float) -> bool:
        slot = self._slots.get(transport)
        if slot is None:
            return True
        interval_s = 1.0 / rate
        if transport == BLE4:
            interval_s /= self._phases(messages)
        return now_s - slot.at_s > interval_s

    def _interval_s(self, transport: str, params: Mapping[str, float]) -> float | None:
        if transport in (BLE4, BLE5):
            return (self._ble_interval_s or {}).get(transport)
        if transport == WIFI_BEACON:
            return BEACON_INTERVAL_S
        rate = params[RATES[WIFI_NAN]]
        return 1.0 / rate if rate > 0.0 else None

    @staticmethod
    def _phases(messages: Sequence[Message]) -> int:
        return 7 if sum(isinstance(m, BasicId) for m in messages) > 1 else 6

    def _legacy(self, messages: Sequence[Message]) -> bytes:
        """Return the next BLE 4 payload: the messages in turn, a second Basic ID if any, then the name."""
        phase = self._phase
        self._phase = (phase + 1) % self._phases(messages)
        second = phase == len(_LEGACY_ORDER)
        if phase > len(_LEGACY_ORDER):
            return b""  # the slot of the BLE 4 name
        kind: type[Message] = BasicId if second else _LEGACY_ORDER[phase]
        fitting = [m for m in messages if isinstance(m, kind)][int(second) :]
        return encode(fitting[0]) if fitting else b""

    def _frame(self, transport: str, slot: _Slot) -> bytes | None:
        if len(slot.payload) <= PACK_HEADER_SIZE:
            return None
        if transport == BLE4:
            return build_ble4(slot.payload, slot.counter)
        if transport == BLE5:
            return build_ble5(slot.payload, slot.counter)
        build = build_beacon if transport == WIFI_BEACON else build_nan_action
        return build(slot.payload, slot.counter, self.address)


def _pack(messages: Sequence[Message]) -> bytes:
    """Build a message pack. Before the firmware has any data, it sends a pack without messages."""
    return bytes((0xF2, 25, len(messages))) + b"".join(map(encode, messages))
