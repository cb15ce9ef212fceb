"""Remote ID: messages and frames per second on one core, and the time from a frame to its track."""

from __future__ import annotations

import time
from collections.abc import Callable

import msgspec

from bench.measuring.place import FRAME
from companion.config import TrafficConfig
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame
from companion.radio.frames_io import FrameReceiver, FrameSender, radio_address
from companion.remote_id import codec
from companion.remote_id.messages import (
    BasicId,
    IdType,
    Location,
    OperatorId,
    SelfId,
    Status,
    System,
    UaType,
)
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN
from companion.traffic.tracks import Traffic

LOCATION = Location(
    status=Status.AIRBORNE,
    lat_deg=FRAME.lat_deg + 0.0001234,
    lon_deg=FRAME.lon_deg + 0.0001234,
    alt_geodetic_m=497.5,
    height_m=50.0,
    direction_deg=123.0,
    speed_mps=4.25,
    vertical_speed_mps=-0.5,
    horizontal_accuracy_m=3.0,
    timestamp_s=1234.5,
)
BASIC = BasicId(
    id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="1596F0000DMUCA01"
)

OTHERS = (
    System(
        operator_lat_deg=FRAME.lat_deg + 0.0001234,
        operator_lon_deg=FRAME.lon_deg + 0.0001234,
        operator_alt_geodetic_m=450.0,
    ),
    SelfId(description_type=0, text="survey"),
    OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
)
"""The messages that, with Basic ID and Location, make up everything that the rules of a region require."""

NUMBER = 4_000
"""Number of calls in a round."""
AIRCRAFT = 20
_UTC_S = 3600.0 * 450_000
_TICKS = 600
_TICK_S = 0.1


def rate(call: Callable[[], object]) -> float:
    """Calls per second: the best of ten rounds, each so short that one of them is likely to be
    undisturbed."""
    best = float("inf")
    for _ in range(10):
        began = time.perf_counter()
        for _ in range(NUMBER):
            call()
        best = min(best, time.perf_counter() - began)
    return NUMBER / best


class Reception:
    """A receiver that has tracks of `AIRCRAFT` aircraft. Each frame brings a new position of one of them."""

    def __init__(self, transport: str) -> None:
        self._transport = transport
        self._frames: list[tuple[str, bytes]] = []
        senders = [FrameSender(radio_address(str(number))) for number in range(AIRCRAFT)]
        for tick in range(_TICKS):
            for number, sender in enumerate(senders):
                self._frames.append((sender.address, self._frame(sender, number, tick)))
        self._count = 0
        self._begin()

    def _frame(self, sender: FrameSender, number: int, tick: int) -> bytes:
        moved = {"lat_deg": 47.4 + 1e-3 * number + 4e-6 * tick, "timestamp_s": round(tick * _TICK_S, 1)}
        location = msgspec.structs.replace(LOCATION, direction_deg=0.0, **moved)
        if self._transport == BLE4:
            return sender.frames(BLE4, (location,))[0]
        basic_id = msgspec.structs.replace(BASIC, uas_id=f"1596B0000DMUCA{number:02}")
        return sender.frames(self._transport, (basic_id, location, *OTHERS))[-1]

    def _begin(self) -> None:
        self.receiver = FrameReceiver()
        self.traffic = Traffic(TrafficConfig(), "OWN")
        self._frame_of_reference = LocalFrame(47.4, FRAME.lon_deg + 0.0001234, 450.0)

    def take(self) -> RemoteIdHeard | None:
        """Process the next frame, from its bytes to the track."""
        at = self._count % len(self._frames)
        if at == 0:
            self._begin()
        self._count += 1
        address, frame = self._frames[at]
        event = self.receiver.receive(self._transport, address, frame, -60.0)
        if event is not None:
            now_s = at // AIRCRAFT * _TICK_S
            self.traffic.hear(event, now_s, _UTC_S, self._frame_of_reference, 48.0)
        return event

    def check(self) -> None:
        """Assert that every frame has updated a track."""
        taken = (self._count - 1) % len(self._frames) + 1
        if (self.traffic.counts.updates, len(self.traffic.tracks)) != (taken, min(taken, AIRCRAFT)):
            raise RuntimeError(f"{self._transport}: {self.traffic.counts} after {taken} frames")


def main() -> None:
    """Print the tables."""
    data = codec.encode(LOCATION)
    sender, receiver = FrameSender(radio_address("A")), FrameReceiver()
    messages = (BASIC, LOCATION, System())
    (frame,) = sender.frames("wifi", messages)
    for name, call in (
        ("Location: encode", lambda: codec.encode(LOCATION)),
        ("Location: decode", lambda: codec.decode(data)),
        ("pack of three messages: encode", lambda: sender.frames("wifi", messages)),
        ("pack of three messages: decode", lambda: receiver.receive("wifi", "a", frame)),
    ):
        print(f"{name:34}{rate(call):12,.0f} per second")
    print(f"\ntime from a received frame to the track update, {AIRCRAFT} aircraft")
    for transport in (BLE4, BLE5, WIFI_BEACON, WIFI_NAN):
        reception = Reception(transport)
        per_s = rate(reception.take)
        reception.check()
        messages = "1 message" if transport == BLE4 else f"{2 + len(OTHERS)} messages"
        print(f"{transport:8}{messages:26}{1e6 / per_s:12.1f} us")


if __name__ == "__main__":
    main()
