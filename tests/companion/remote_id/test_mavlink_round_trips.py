"""OPEN_DRONE_ID_*: there and back, of drawn values and of recordings of real autopilots."""

from __future__ import annotations

import gzip
import io
import math
import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.autopilot.tlog import read_tlog
from companion.autopilot.wire import Frame, FrameScanner
from companion.errors import PeerDataError
from companion.remote_id import codec, mavlink
from companion.remote_id.mavlink import (
    NO_ID,
    Odid,
    SystemUpdate,
    decode_odid,
    encode_odid,
)
from companion.remote_id.messages import (
    BasicId,
    Location,
    OperatorId,
    SelfId,
    System,
)
from tests.companion.remote_id.odid import EPOCH, LAST_SECOND, MAC, REPOSITORY

THINNED = REPOSITORY / "tests" / "data"
FULL = REPOSITORY.parent / "shared" / "data" / "mavlink"
TIMESTAMP = slice(20, 24)
"""Of a LOCATION's payload."""


# ---------------------------------------------------------------- properties

LATIN = st.characters(min_codepoint=1, max_codepoint=255)
# A payload for every layout that may hold anything at all.
SIZES = {i: struct.calcsize(dialect.mavlink_map[i].unpacker.format) for i in mavlink.READABLE}


@st.composite
def payloads(draw: st.DrawFn) -> tuple[int, bytes]:
    message_id = draw(st.sampled_from(sorted(SIZES)))
    # Small numbers pass the limits of enumerations more often.
    byte = st.integers(0, 255) | st.integers(0, 3)
    size = SIZES[message_id]
    return message_id, bytes(draw(st.lists(byte, max_size=size + 3)))


@given(payloads())
def test_whatever_is_read_can_go_on_the_air_and_back(given_payload: tuple[int, bytes]) -> None:
    message_id, payload = given_payload
    try:
        odid = decode_odid(message_id, payload)
    except PeerDataError:
        return
    for message in odid.messages:
        codec.encode(message)
        if message_id == mavlink.MESSAGE_PACK:
            continue  # from the air: see the next test
        sent = encode_odid(message, odid.target_system, odid.target_component, odid.id_or_mac)
        assert decode_odid(*sent) == odid


@st.composite
def air_bytes(draw: st.DrawFn) -> bytes:
    """25 bytes that may be any message."""
    head = draw(st.integers(0, 5)) << 4 | 2
    return bytes((head, *draw(st.lists(st.integers(0, 255), min_size=24, max_size=24))))


@given(air_bytes())
def test_a_message_from_the_air_goes_through_mavlink_unaltered(data: bytes) -> None:
    try:
        message = codec.decode(data)
    except PeerDataError:
        return
    timestamp = getattr(message, "timestamp_utc_s", None)
    if timestamp is not None and timestamp > EPOCH + LAST_SECOND:
        with pytest.raises(ValueError, match="timestamp_utc_s"):
            encode_odid(message, 1, 236, MAC)
        return
    assert decode_odid(*encode_odid(message, 1, 236, MAC)) == Odid(1, 236, MAC, (message,))


ALTITUDES = st.none() | st.floats(-1000.0, 31767.5, exclude_min=True)


@given(ALTITUDES, st.none() | st.floats(0, 360), st.none() | st.floats(0, 254.25))
def test_fine_values_come_back_within_half_of_mavlinks_step(
    altitude: float | None, direction: float | None, speed: float | None
) -> None:
    sent = Location(height_m=altitude, direction_deg=direction, speed_mps=speed)
    (heard,) = decode_odid(*encode_odid(sent, 1, 1)).messages
    assert isinstance(heard, Location)
    assert (heard.height_m is None) == (altitude is None)
    assert (heard.direction_deg is None) == (direction is None)
    assert (heard.speed_mps is None) == (speed is None)
    if altitude is not None and heard.height_m is not None:
        assert heard.height_m == pytest.approx(altitude, rel=6.1e-8, abs=1.6e-4)
    if direction is not None and heard.direction_deg is not None:
        assert abs(math.remainder(heard.direction_deg - direction, 360.0)) <= 0.005 + 1e-9
    if speed is not None:
        assert heard.speed_mps == pytest.approx(speed, abs=0.005 + 1e-9)


@given(st.none() | st.floats(-62, 62), st.none() | st.floats(0, 3600), st.floats(0, 2550))
def test_more_fine_values_come_back(climb: float | None, time_s: float | None, radius: float) -> None:
    sent = Location(vertical_speed_mps=climb, timestamp_s=time_s)
    (heard,) = decode_odid(*encode_odid(sent, 1, 1)).messages
    assert isinstance(heard, Location)
    assert heard.vertical_speed_mps == (None if climb is None else pytest.approx(climb, abs=0.005 + 1e-9))
    assert heard.timestamp_s == (None if time_s is None else pytest.approx(time_s, abs=0.00065))
    (system,) = decode_odid(*encode_odid(System(area_radius_m=radius), 1, 1)).messages
    assert isinstance(system, System)
    assert system.area_radius_m == pytest.approx(radius, abs=0.5)


# ---------------------------------------------------------------- recordings


def recorded(name: str) -> list[Frame]:
    """OPEN_DRONE_ID_* frames of a recording: the full one where it is, else the thinned one."""
    full = FULL / f"{name}.tlog"
    data = full.read_bytes() if full.exists() else gzip.decompress((THINNED / f"{name}.tlog.gz").read_bytes())
    scanner = FrameScanner()
    frames = [f for _, raw in read_tlog(io.BytesIO(data), name) for f in scanner.frames(raw)]
    return [f for f in frames if f.message_id in mavlink.READABLE]


def test_what_ardupilot_sent_and_was_sent_re_encodes_to_the_same_bytes() -> None:
    frames = recorded("ardupilot_sitl_odid_adsb")
    kinds: Counter[type] = Counter()
    for frame in frames:
        odid = decode_odid(frame.message_id, frame.payload)
        assert odid.id_or_mac == NO_ID
        for message in odid.messages:
            kinds[type(message)] += 1
            message_id, payload = encode_odid(message, odid.target_system, odid.target_component)
            assert message_id == frame.message_id
            recorded_payload = frame.payload.ljust(len(payload), b"\0")
            if isinstance(message, Location):
                # ArduPilot computes the time in 32-bit floats, and is one step off the nearest to the tenth.
                ours, theirs = payload[TIMESTAMP], recorded_payload[TIMESTAMP]
                assert abs(int.from_bytes(ours, "little") - int.from_bytes(theirs, "little")) <= 1
                recorded_payload = recorded_payload.replace(theirs, ours)
            assert payload == recorded_payload, message
        if odid.system_update is not None:
            kinds[SystemUpdate] += 1
    assert set(kinds) == {BasicId, Location, SelfId, System, OperatorId, SystemUpdate}
    assert min(kinds.values()) > 30


def test_px4_without_gnss_time_says_so() -> None:
    frames = recorded("px4_sih_offboard")
    times = set()
    locations = 0
    for frame in frames:
        (message,) = decode_odid(frame.message_id, frame.payload).messages
        if isinstance(message, System):
            times.add(message.timestamp_utc_s)
            assert message.operator_lat_deg == pytest.approx(47.397, abs=0.01)
        elif isinstance(message, Location):
            times.add(message.timestamp_s)
            locations += 1
        else:
            assert isinstance(message, BasicId)
            assert message.uas_id == "1006554d49534954414"
    assert times == {None}
    assert locations > 100
