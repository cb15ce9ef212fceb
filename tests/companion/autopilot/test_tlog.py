from __future__ import annotations

import io
import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.tlog import TlogCounts, TlogWriter, _Reader, read_tlog
from companion.autopilot.wire import MavlinkWriter, is_known, message_id_of
from companion.errors import PeerDataError
from tests.support.place import LAT_E7, LON_E7

UTC_S = 1_700_000_000.0


def frame(number: int, *, v1: bool = False) -> bytes:
    encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    message = mavlink.MAVLink_global_position_int_message(number, LAT_E7, LON_E7, 1, 2, 3, 4, 5, 6)
    return bytes(message.pack(encoder, force_mavlink1=v1))


def record(number: int, *, v1: bool = False) -> bytes:
    return struct.pack(">Q", round((UTC_S + number) * 1e6)) + frame(number, v1=v1)


def read(data: bytes, counts: TlogCounts | None = None) -> list[tuple[float, bytes]]:
    return list(read_tlog(io.BytesIO(data), "flight.tlog", counts))


def test_what_is_written_is_read() -> None:
    stream = io.BytesIO()
    log = TlogWriter(stream)
    log.received(UTC_S, frame(1) + frame(2)[:10])
    log.sent(UTC_S + 0.25, frame(3))
    log.received(UTC_S + 0.5, frame(2)[10:])
    assert read(stream.getvalue()) == [(UTC_S, frame(1)), (UTC_S + 0.25, frame(3)), (UTC_S + 0.5, frame(2))]


def test_the_writer_keeps_messages_that_the_dialect_does_not_know() -> None:
    unknown = bytes([0xFD, 3, 0, 0, 0, 1, 1, 0x39, 0x30, 0, 1, 2, 3, 0xAA, 0xBB])
    stream = io.BytesIO()
    TlogWriter(stream).received(UTC_S, b"noise" + unknown + frame(1) + unknown)
    assert [raw for _, raw in read(stream.getvalue())] == [unknown, frame(1), unknown]


def test_both_versions_of_mavlink() -> None:
    data = record(1) + record(2, v1=True) + record(3)
    assert [raw for _, raw in read(data)] == [frame(1), frame(2, v1=True), frame(3)]


@pytest.mark.parametrize("seed", range(8))
def test_the_quick_way_reads_what_the_careful_one_does(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a log longer than what is kept in the buffer, with frames that lost their time among the damage."""
    chance = random.Random(seed)
    data = b"".join(
        chance.randbytes(chance.randrange(1, 400)) + frame(number)
        if chance.random() < 0.02
        else record(number, v1=chance.random() < 0.3)
        for number in range(2500)
    )
    data = bytes(byte ^ 0x10 if chance.random() < 1e-3 else byte for byte in data)
    quick, careful = TlogCounts(), TlogCounts()
    found = read(data, quick)
    monkeypatch.setattr(_Reader, "plain", lambda _: iter(()))
    assert found == read(data, careful)
    assert quick == careful
    assert quick.records > 2000
    assert quick.corrupt_spans > 50


@pytest.mark.parametrize("damage", [1, 7, 8, 9, 40, 300, 5000])
def test_damaged_bytes_between_records_are_stepped_over(damage: int) -> None:
    noise = random.Random(damage).randbytes(damage)
    counts = TlogCounts()
    got = read(record(1) + noise + record(2) + record(3), counts)
    assert got == [(UTC_S + n, frame(n)) for n in (1, 2, 3)]
    assert (counts.records, counts.corrupt_spans, counts.corrupt_bytes) == (3, 1, damage)


def test_noise_inside_a_record_leaves_its_own_time() -> None:
    stamped = struct.pack(">Q", round((UTC_S + 2) * 1e6))
    got = read(record(1) + stamped + b"\xff" * 17 + frame(2) + record(3))
    assert got == [(UTC_S + n, frame(n)) for n in (1, 2, 3)]


def test_a_damaged_head_is_stepped_over() -> None:
    assert [raw for _, raw in read(b"\xff" * 100 + record(1) + record(2))] == [frame(1), frame(2)]


@pytest.mark.parametrize("cut", range(1, len(record(3))))
def test_torn_tails_are_counted(cut: int) -> None:
    counts = TlogCounts()
    data = record(1) + record(2) + record(3)[:cut]
    assert [raw for _, raw in read(data, counts)] == [frame(1), frame(2)]
    assert counts.torn_bytes == cut
    assert counts.corrupt_spans == 0


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_flipped_byte_loses_at_most_one_record_and_invents_none(data: st.DataObject) -> None:
    good = [record(n) for n in range(6)]
    stream = bytearray(b"".join(good))
    at = data.draw(st.integers(len(good[0]), len(stream) - 1))
    stream[at] ^= data.draw(st.integers(1, 255))
    got = [raw for _, raw in read(bytes(stream))]
    # A flipped message id may name an unknown message, whose checksum nobody can verify.
    known = [raw for raw in got if is_known(message_id_of(raw))]
    assert set(known) <= {frame(n) for n in range(6)}
    assert len(known) >= 5


@pytest.mark.parametrize(
    "data",
    [b"", b"DMUCAEV1", b"\xa3\x95\x80" * 1000, random.Random(1).randbytes(300_000), record(1)[:20]],
    ids=["empty", "event record", "dataflash", "random", "torn before the first record"],
)
def test_other_files_are_no_logs(data: bytes) -> None:
    with pytest.raises(PeerDataError) as error:
        read(data)
    message = str(error.value)
    assert message.startswith("flight.tlog: not a telemetry log")
    assert "expected" in message
    assert "\n" not in message
    assert (data[:8].hex(" ") if data else "empty") in message


def test_a_raw_stream_without_times_is_no_log() -> None:
    writer = MavlinkWriter(1, 1)
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)
    with pytest.raises(PeerDataError):
        read(b"".join(writer.pack(beat) for _ in range(2000)))
