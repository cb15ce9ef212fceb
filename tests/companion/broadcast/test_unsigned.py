"""The frames of an aircraft without a signing key are pinned: what is added for signing must not change them.

The digests are those of the version in which Basic ID began to go with the first Locations on BLE 4. Before,
they were those of the version before signatures.
"""

from __future__ import annotations

import hashlib

import msgspec
import pytest

from companion.broadcast.broadcaster import asked_rates
from companion.core import Companion
from companion.events import Broadcast, OperatorData, RadioState
from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import OperatorLocationType, SelfId, System
from companion.remote_id.region import Region
from tests.companion.conftest import Bench, config

US = Region(
    name="us",
    transport_sets=(("wifi",), ("ble4", "ble5")),
    location_period_s=1.0,
    location_max_age_s=1.0,
    basic_id_period_s=1.0,
    system_period_s=1.0,
    other_period_s=3.0,
    beacon_channels=(6, 149),
    beacon_period_elsewhere_s=0.2,
)
ALL = ("wifi", "ble4", "ble5", "nan")
CASES = {
    "us, Bluetooth": (US, ("ble4", "ble5"), 1, ("ble4", "ble5"), None),
    "us, a beacon elsewhere": (US, ("wifi",), 1, ("wifi",), 11),
    "no region, everything": (Region(), ALL, 10, ALL, 6),
    "us, one radio is lost": (US, ("wifi", "ble4"), 3, ALL, 6),
}
DIGESTS = {
    "us, Bluetooth": "42b6ce6f50c44fd47d8e1f7807941d85",
    "us, a beacon elsewhere": "e06a064403a996737d09154a6390c9d2",
    "no region, everything": "55c093388d9c14cc0bac673c9c0dc77c",
    "us, one radio is lost": "cbc8a1f793db8f3ed3acfad0b0c50275",
}


def flown(region, transports, rate, can_send, channel) -> tuple[int, str]:
    """Number of frames of a flight, and the digest of times, transports and bytes."""
    made = config(use="watch")
    remote_id = msgspec.structs.replace(
        made.remote_id, transports=transports, rate=rate, self_id="survey", operator_id="FIN87astrdge12k8"
    )
    made = msgspec.structs.replace(made, region=region, remote_id=remote_id)
    bench = Bench(Companion(made))
    bench.core.broadcaster.ask(asked_rates(made))
    bench.extra = [RadioState(can_send=can_send, wifi_channel=channel)]
    sender = FrameSender(radio_address("OWN"))
    digest, frames = hashlib.sha256(), 0
    for number in range(600):
        bench.north_m, bench.velocity_ned_mps = 0.3 * number, (6.0, 0.1 * (number % 7), -0.2)
        bench.armed = number >= 40
        if number == 100:
            operator = System(
                operator_location_type=OperatorLocationType.LIVE_GNSS,
                operator_lat_deg=47.5,
                operator_lon_deg=8.5,
                timestamp_utc_s=1_767_225_605.0,
            )
            bench.extra.append(OperatorData(messages=(operator, SelfId(description_type=0, text="other"))))
        if number == 300 and len(can_send) > 2:
            bench.extra.append(RadioState(can_send=("ble4", "ble5"), wifi_channel=None))
        for command in bench.step(1, 0.05 if number % 11 else 0.2):
            if isinstance(command, Broadcast):
                for frame in sender.frames(command.transport, command.messages):
                    digest.update(f"{bench.now_s:.3f} {command.transport} {frame.hex()}\n".encode())
                    frames += 1
    return frames, digest.hexdigest()[:32]


@pytest.mark.parametrize("name", CASES)
def test_unsigned_frames_are_the_same_as_before(name):
    frames, digest = flown(*CASES[name])
    assert frames > 30
    assert digest == DIGESTS[name]
