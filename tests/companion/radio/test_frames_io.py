"""Messages to frames and back: what each transport carries, counters, addresses, hostile frames."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.events import RemoteIdHeard
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender, radio_address
from companion.remote_id.codec import encode, encode_pack
from companion.remote_id.frames import build_ble4, build_nan_sync_beacon, build_vendor_element, parse_frame
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, SelfId, Status, UaType

ADDRESS = "c2:01:02:03:04:05"
BASIC_ID = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="DMUCA0001")
SELF_ID = SelfId(description_type=0, text="survey")


def location(lat_deg: float = 47.5) -> Location:
    return Location(status=Status.AIRBORNE, lat_deg=lat_deg, lon_deg=8.5, alt_geodetic_m=500.0)


@pytest.mark.parametrize(("transport", "frames"), [("ble4", 3), ("ble5", 1), ("wifi", 1), ("nan", 1)])
def test_what_is_sent_is_heard(transport: str, frames: int) -> None:
    messages = (BASIC_ID, location(), SELF_ID)
    sent = FrameSender(ADDRESS).frames(transport, messages)
    assert len(sent) == frames
    receiver = FrameReceiver()
    events = [receiver.receive(transport, ADDRESS, frame, -60.0) for frame in sent]
    heard = tuple(m for event in events if event is not None for m in event.messages)
    assert [type(m) for m in heard] == [BasicId, Location, SelfId]
    assert heard[0] == BASIC_ID
    assert heard[1].lat_deg == pytest.approx(47.5, abs=1e-7)  # type: ignore[union-attr]
    assert {(e.transport, e.address, e.rssi_dbm) for e in events if e} == {(transport, ADDRESS, -60.0)}
    assert (receiver.heard, receiver.bad, receiver.foreign) == (frames, 0, 0)


@pytest.mark.parametrize("transport", sorted(TRANSPORTS))
def test_no_messages_make_no_frame(transport: str) -> None:
    assert FrameSender(ADDRESS).frames(transport, ()) == []


def test_more_than_a_pack_holds_goes_out_in_several() -> None:
    pages = [Authentication(auth_type=1, page=page, data=bytes([page]) * 23) for page in range(1, 12)]
    receiver = FrameReceiver()
    frames = FrameSender(ADDRESS).frames("ble5", pages)
    events = [receiver.receive("ble5", ADDRESS, frame) for frame in frames]
    assert [len(e.messages) for e in events if e] == [9, 2]
    assert [m.page for e in events if e for m in e.messages] == list(range(1, 12))  # type: ignore[union-attr]


def test_counters_step_with_the_content_and_per_transport() -> None:
    sender = FrameSender(ADDRESS)

    def counters(transport: str, *messages: Location | BasicId) -> list[int]:
        return [parse_frame(transport, frame).counter for frame in sender.frames(transport, messages)]

    assert counters("ble4", BASIC_ID, location(1.0)) == [0, 0]
    assert counters("ble4", BASIC_ID, location(2.0)) == [0, 1]
    assert counters("wifi", BASIC_ID, location(2.0)) == [0]
    assert counters("wifi", BASIC_ID, location(2.0)) == [0]
    assert counters("wifi", BASIC_ID, location(3.0)) == [1]
    assert counters("ble4", location(3.0)) == [2]


def test_an_unknown_transport_is_refused() -> None:
    with pytest.raises(ValueError, match="smoke"):
        FrameSender(ADDRESS).frames("smoke", (BASIC_ID,))


@pytest.mark.parametrize("transport", ["wifi", "nan"])
def test_a_wifi_frames_own_address_goes_before_the_reported_one(transport: str) -> None:
    (frame,) = FrameSender(ADDRESS).frames(transport, (location(),))
    event = FrameReceiver().receive(transport, "02:00:00:00:00:99", frame)
    assert event is not None
    assert event.address == ADDRESS


@pytest.mark.parametrize("transport", ["wifi", "nan"])
def test_a_wifi_frame_tells_its_transport_by_itself(transport: str) -> None:
    (frame,) = FrameSender(ADDRESS).frames(transport, (SELF_ID,))
    receiver = FrameReceiver()
    event = receiver.receive_wifi(frame, -70.0)
    assert event == RemoteIdHeard(
        transport=transport, address=ADDRESS, messages=(SELF_ID,), rssi_dbm=-70.0, counter=0
    )
    assert receiver.receive_wifi(build_nan_sync_beacon(ADDRESS)) is None
    assert receiver.receive("wifi", ADDRESS, build_nan_sync_beacon(ADDRESS)) is None
    other = {"wifi": "nan", "nan": "wifi"}[transport]
    assert receiver.receive(other, ADDRESS, frame) is None
    assert receiver.receive_wifi(b"\x80") is None
    assert (receiver.heard, receiver.foreign, receiver.bad) == (1, 3, 1)


@given(st.text(min_size=1, max_size=20))
def test_an_address_is_random_static_and_locally_administered(identity: str) -> None:
    first = int(radio_address(identity).split(":")[0], 16)
    assert first & 0b1100_0000 == 0b1100_0000
    assert first & 0b0000_0011 == 0b0000_0010


def test_an_address_is_steady_and_its_owners_own() -> None:
    """The value itself, so that aircraft keep their addresses over releases."""
    assert radio_address("DMUCA0001") == "d6:78:8c:82:11:f5"
    assert len({radio_address(f"DMUCA{i:04d}") for i in range(1000)}) == 1000


@given(st.sampled_from(sorted(TRANSPORTS)), st.binary(max_size=300))
def test_any_bytes_are_counted_and_never_raise(transport: str, frame: bytes) -> None:
    receiver = FrameReceiver()
    event = receiver.receive(transport, ADDRESS, frame)
    assert (event is not None) == (receiver.heard == 1)
    assert receiver.bad <= 1
    assert receiver.foreign == 0 or (receiver.bad, receiver.heard) == (0, 0)


@given(st.sampled_from(sorted(TRANSPORTS)), st.data())
def test_a_cut_or_flipped_frame_never_raises(transport: str, data: st.DataObject) -> None:
    frame = bytearray(FrameSender(ADDRESS).frames(transport, (location(),))[0])
    frame[data.draw(st.integers(0, len(frame) - 1))] ^= data.draw(st.integers(1, 255))
    FrameReceiver().receive(transport, ADDRESS, bytes(frame[: data.draw(st.integers(0, len(frame)))]))


def test_a_cut_frame_is_bad_and_a_foreign_one_is_not() -> None:
    receiver = FrameReceiver()
    (frame,) = FrameSender(ADDRESS).frames("ble4", (location(),))
    assert receiver.receive("ble4", ADDRESS, frame[:20]) is None
    assert (receiver.bad, receiver.foreign) == (1, 0)
    assert receiver.last_error is not None
    assert "14 bytes" in receiver.last_error
    assert receiver.receive("ble4", ADDRESS, bytes.fromhex("020106")) is None
    assert (receiver.bad, receiver.foreign) == (1, 1)


def test_one_bad_message_does_not_hide_the_location_beside_it() -> None:
    (frame,) = FrameSender(ADDRESS).frames("ble5", (BASIC_ID, location()))
    damaged = bytearray(frame)
    damaged[6 + 3] = 0x72  # type of the first message: reserved
    receiver = FrameReceiver()
    event = receiver.receive("ble5", ADDRESS, bytes(damaged))
    assert event is not None
    assert [type(m) for m in event.messages] == [Location]
    assert (receiver.heard, receiver.bad) == (1, 1)


def test_the_messages_of_several_structures_in_one_frame_are_merged() -> None:
    """Two of a kind stay two, in order; the very same one twice is one."""
    receiver = FrameReceiver()
    data = build_ble4(encode(BASIC_ID), 3) + build_ble4(encode(SELF_ID), 4) + build_ble4(encode(BASIC_ID), 3)
    event = receiver.receive("ble5", ADDRESS, data)
    assert event is not None
    assert event.messages == (BASIC_ID, SELF_ID)
    torn = data[:31] + build_ble4(encode(SELF_ID), 4)[:20]
    event = receiver.receive("ble5", ADDRESS, torn)
    assert event is not None
    assert event.messages == (BASIC_ID,)
    assert (receiver.heard, receiver.bad) == (2, 1)

    (beacon,) = FrameSender(ADDRESS).frames("wifi", (BASIC_ID,))
    event = receiver.receive_wifi(beacon + build_vendor_element(encode_pack((SELF_ID,)), 9))
    assert event is not None
    assert event.messages == (BASIC_ID, SELF_ID)


def test_of_many_structures_in_one_frame_the_first_are_read() -> None:
    texts = tuple(SelfId(description_type=0, text=str(n)) for n in range(9))
    (beacon,) = FrameSender(ADDRESS).frames("wifi", (BASIC_ID,))
    receiver = FrameReceiver()
    more = (build_vendor_element(encode_pack((text,)), 9) for text in texts)
    event = receiver.receive_wifi(beacon + b"".join(more))
    assert event is not None
    assert event.messages == (BASIC_ID, *texts[:3])
    assert receiver.last_error == "10 Remote ID structures in one frame; read: 4"


@pytest.mark.parametrize("transport", ["ble5", "wifi", "nan"])
def test_of_a_torn_pack_the_whole_messages_are_heard(transport: str) -> None:
    (frame,) = FrameSender(ADDRESS).frames(transport, (BASIC_ID, location(), SELF_ID))
    end = len(frame) - (7 if transport == "nan" else 0)
    receiver = FrameReceiver()
    event = receiver.receive(transport, ADDRESS, frame[: end - 10])
    assert event is not None
    assert [type(m) for m in event.messages] == [BasicId, Location]
    assert (receiver.heard, receiver.bad) == (1, 1)
