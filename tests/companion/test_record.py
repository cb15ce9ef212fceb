"""Event record: what is written is read back; torn and damaged files."""

from __future__ import annotations

import contextlib
import io

import msgspec
import pytest

from companion import event_record
from companion.config import Config, IdentityConfig, TrafficConfig
from companion.errors import PeerDataError
from companion.events import FlightMode, GlobalPosition, SetMode, VelocitySetpoint
from companion.events.base import Command, Event

HEADER = event_record.Header(aircraft="A", software="0", config=Config(identity=IdentityConfig(uas_id="A")))
STEP = event_record.Step(
    now_s=1.05,
    events=(
        GlobalPosition(
            time_boot_s=1.0,
            lat_deg=47.0,
            lon_deg=8.0,
            alt_msl_m=3.0,
            height_above_home_m=3.0,
            velocity_ned_mps=(0.1, 0.2, 0.3),
        ),
    ),
    commands=(SetMode(mode=FlightMode.HOLD), VelocitySetpoint(velocity_ned_mps=(1.0, 2.0, 3.0))),
)
DATA = event_record.MAGIC + event_record.encode(HEADER) + event_record.encode(STEP) * 2


def read(data):
    return list(event_record.read(io.BytesIO(data), "x.events"))


def test_read_back():
    assert read(DATA) == [HEADER, STEP, STEP]


def test_a_torn_tail_loses_only_the_last_record():
    whole = len(DATA) - len(event_record.encode(STEP))
    for cut in range(whole, len(DATA)):
        assert read(DATA[:cut]) == [HEADER, STEP]


def test_every_flipped_byte_is_noticed():
    for at in range(len(DATA)):
        damaged = bytearray(DATA)
        damaged[at] ^= 0x10
        found = []
        with contextlib.suppress(PeerDataError):
            for item in event_record.read(io.BytesIO(bytes(damaged)), "x.events"):
                found.append(item)  # noqa: PERF402 what came before the damage counts
        # A length that grew past the end may read as a torn tail; nothing false may be read.
        assert found == [HEADER, STEP, STEP][: len(found)]
        assert len(found) < 3


def test_a_length_that_reaches_over_whole_steps_is_no_torn_tail():
    at = len(event_record.MAGIC) + len(event_record.encode(HEADER))
    damaged = bytearray(DATA)
    damaged[at + 2] ^= 0x40
    with pytest.raises(PeerDataError, match=rf"byte {at}: a length of .* reaches over the whole records"):
        read(bytes(damaged))


def test_another_file_is_refused_in_one_line():
    with pytest.raises(PeerDataError, match="not an event record"):
        read(b"PK\x03\x04 something else")


def test_a_record_of_another_version_is_told_apart():
    with pytest.raises(PeerDataError, match="format b'1'; this version reads b'4'"):
        list(event_record.read(io.BytesIO(b"DMUCAEV1" + b"\0" * 20), "old.events"))


def test_a_configuration_that_is_refused_now_names_the_version_that_reads_it():
    config = msgspec.structs.replace(HEADER.config, traffic=TrafficConfig(expire_after_s=120.0))
    old = event_record.MAGIC + event_record.encode(msgspec.structs.replace(HEADER, config=config))
    with pytest.raises(PeerDataError, match=r"expire_after_s`; use the version that wrote it \(manifest"):
        read(old)


def test_a_growing_file_is_read_on_from_where_it_stopped(tmp_path):
    path = tmp_path / "a.events"
    path.write_bytes(event_record.MAGIC)
    found = []
    with path.open("rb") as stream, path.open("ab") as end:
        reader = event_record.Reader(stream, "a.events")
        for at in range(len(event_record.MAGIC), len(DATA)):
            end.write(DATA[at : at + 1])
            end.flush()
            found += reader.records()
    assert found == [HEADER, STEP, STEP]


@pytest.mark.parametrize("kind", [*Event.__subclasses__(), *Command.__subclasses__()])
def test_no_event_or_command_has_subclasses(kind: type) -> None:
    """Loops over events and commands compare types, and would not recognise a subclass."""
    assert not kind.__subclasses__()
