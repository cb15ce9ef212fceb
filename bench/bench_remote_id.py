"""Remote ID coding: messages and frames a second on one core."""

from __future__ import annotations

import time
from collections.abc import Callable

from companion.radio.frames_io import FrameReceiver, FrameSender, radio_address
from companion.remote_id import codec
from companion.remote_id.messages import BasicId, IdType, Location, Status, System, UaType

LOCATION = Location(
    status=Status.AIRBORNE,
    lat_deg=47.3971234,
    lon_deg=8.5451234,
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


NUMBER = 20_000


def rate(call: Callable[[], object]) -> float:
    """Calls a second; the best of three."""
    best = float("inf")
    for _ in range(3):
        began = time.perf_counter()
        for _ in range(NUMBER):
            call()
        best = min(best, time.perf_counter() - began)
    return NUMBER / best


def main() -> None:
    """Print the table."""
    data = codec.encode(LOCATION)
    sender, receiver = FrameSender(radio_address("A")), FrameReceiver()
    messages = (BASIC, LOCATION, System())
    (frame,) = sender.frames("wifi", messages)
    for name, call in (
        ("Location encoded", lambda: codec.encode(LOCATION)),
        ("Location decoded", lambda: codec.decode(data)),
        ("pack of three to a beacon", lambda: sender.frames("wifi", messages)),
        ("beacon to a pack of three", lambda: receiver.receive("wifi", "a", frame)),
    ):
        print(f"{name:34}{rate(call):12,.0f} a second")


if __name__ == "__main__":
    main()
