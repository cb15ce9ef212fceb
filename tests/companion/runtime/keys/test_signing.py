"""The key's file, and a timestamp that no restart sets back."""

from __future__ import annotations

import errno
import hashlib
import os
import threading

import msgspec
import pytest

from companion import config as configuration
from companion.autopilot.signing import EPOCH_S, LATEST, TICKS_PER_S, timestamp_at
from companion.commands.check import _vehicle
from companion.commands.preflight import Preflight
from companion.config import Config, IdentityConfig, RecordConfig, VehicleConfig
from companion.errors import ConfigError
from companion.runtime import signing_key
from companion.runtime.record import disk
from companion.runtime.signing_key import PERIOD_S, PLAUSIBLE_UTC_S, TIMESTAMP_FILE, KeptSigning, read_key

RAW = bytes(range(100, 132))
DIGITS = "d4ee003d187614d9ffa24d20f58b448551c2cdc1e54cf42fc00bb86182249126"


@pytest.fixture
def key_file(tmp_path):
    def write(data, mode=0o600):
        path = tmp_path / "signing.key"
        path.write_bytes(data)
        path.chmod(mode)
        return path

    return write


@pytest.mark.parametrize(
    ("data", "key"),
    [
        (b"\xff" + RAW[1:], b"\xff" + RAW[1:]),
        (DIGITS.encode(), bytes.fromhex(DIGITS)),
        (DIGITS.upper().encode() + b"\n", bytes.fromhex(DIGITS)),
        (b"correct horse\n", hashlib.sha256(b"correct horse").digest()),
        (b"correct horse\r\n", hashlib.sha256(b"correct horse").digest()),
        # As long as a raw key, with and without the end of the line.
        (b"x" * 32, hashlib.sha256(b"x" * 32).digest()),
        (b"x" * 31 + b"\n", hashlib.sha256(b"x" * 31).digest()),
        # A space behind the digits does not make a passphrase of them.
        (DIGITS.encode() + b" \n", bytes.fromhex(DIGITS)),
        # Hexadecimal digits by chance.
        (b"deadbeef", hashlib.sha256(b"deadbeef").digest()),
    ],
)
def test_the_three_forms_of_a_key(key_file, data, key):
    assert read_key(key_file(data)) == key


def test_a_passphrase_is_what_the_ground_stations_make_of_it(key_file):
    """SHA-256 of "abc", from FIPS 180-2."""
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert read_key(key_file(b"abc\n")).hex() == expected


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (b"\n", "empty"),
        (DIGITS[:-1].encode(), "63 hexadecimal digits; a key has 64"),
        (DIGITS.encode() + b"00", "66 hexadecimal digits; a key has 64"),
        (b"\xff" * 31, "31 bytes that are not one line of ASCII"),
        (b"\xff" * 33, "33 bytes that are not one line of ASCII"),
        (b"two\nlines\n", "10 bytes that are not one line of ASCII"),
        ("schlüssel".encode(), "10 bytes that are not one line of ASCII"),
        (bytes(32), "holds only zero bytes"),
        (DIGITS[:-1].encode() + b" \n", "63 hexadecimal digits; a key has 64"),
        (b"x" * 1025, "more than 1024 bytes"),
    ],
)
def test_what_is_no_key_is_refused_and_not_shown(key_file, data, words):
    path = key_file(data)
    with pytest.raises(ConfigError) as caught:
        read_key(path)
    assert str(caught.value).startswith(f"vehicle.signing_key: {path}: {words}")
    if len(data) > 5:
        assert data.decode("latin-1").strip()[:6] not in str(caught.value)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o660, 0o602, 0o610])
def test_a_key_that_others_can_get_at_is_refused(key_file, mode):
    path = key_file(RAW, mode)
    with pytest.raises(ConfigError, match=f"{mode:04o} .*; run chmod 600 {path}"):
        read_key(path)


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="Is a directory"):
        read_key(tmp_path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(ConfigError, match="not a regular file"):
        read_key(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="no such file") as caught:
        read_key(tmp_path / "a passphrase")
    assert "a passphrase" not in str(caught.value)


# ---------------------------------------------------------------- the configuration


def write(tmp_path, vehicle):
    path = tmp_path / "c.toml"
    path.write_text(f'[identity]\nuas_id = "KEY"\n[vehicle]\n{vehicle}\n')
    return path


def test_the_configuration_holds_the_path_alone(tmp_path, key_file):
    key_file(DIGITS.encode())
    loaded = configuration.load(write(tmp_path, 'signing_key = "signing.key"'))
    assert loaded.vehicle.signing_key == str(tmp_path / "signing.key")
    assert DIGITS.encode() not in configuration.dump(loaded)
    assert configuration.load(write(tmp_path, "")).vehicle.signing_key is None


def test_a_key_in_the_place_of_its_path_is_refused_and_not_shown(tmp_path):
    for wrong in (f'signing_key = "{DIGITS}"', 'signing_key = ""', "signing_key = 1234567890"):
        with pytest.raises(ConfigError, match=r"vehicle\.signing_key") as caught:
            configuration.load(write(tmp_path, wrong))
        assert DIGITS not in str(caught.value)
        assert "1234567890" not in str(caught.value)


# ---------------------------------------------------------------- the timestamp


@pytest.fixture
def config(tmp_path, key_file):
    return Config(
        identity=IdentityConfig(uas_id="KEY"),
        vehicle=VehicleConfig(signing_key=str(key_file(RAW))),
        record=RecordConfig(folder=str(tmp_path / "runs")),
    )


@pytest.fixture
def clock(monkeypatch):
    """The wall clock, and time itself."""

    class Clock:
        utc_s = 1_767_225_600.0

    monkeypatch.setattr(signing_key.time, "time", lambda: Clock.utc_s)
    monkeypatch.setattr(signing_key.clock, "now_s", lambda: 1000.0)
    return Clock


def used(kept, frames=5):
    """Sign some frames; the timestamps."""
    frame = bytes([0xFD, 1, 0, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0])
    return [int.from_bytes(kept.signing.sign(frame)[-12:-6], "little") for _ in range(frames)]


def test_without_a_key_there_is_no_signing(tmp_path):
    folder = tmp_path / "runs"
    kept = KeptSigning(Config(identity=IdentityConfig(uas_id="KEY"), record=RecordConfig(folder=str(folder))))
    kept.close()
    assert kept.signing is None
    assert not folder.exists()


def test_starts_at_the_wall_clock(config, clock):
    kept = KeptSigning(config)
    assert used(kept)[0] == timestamp_at(clock.utc_s) + 1


def test_a_restart_with_a_wrong_clock_never_goes_back(config, clock):
    kept = KeptSigning(config)
    last = used(kept)[-1]
    kept.close()
    for utc_s in (0.0, 1_420_070_400.0, 1_700_000_000.0):
        clock.utc_s = utc_s
        kept = KeptSigning(config)
        stamps = used(kept)
        assert stamps[0] > last
        last = stamps[-1]
        # Killed: nothing is written at its end.


@pytest.mark.parametrize("utc_s", [PLAUSIBLE_UTC_S, EPOCH_S + LATEST / TICKS_PER_S, 1e11])
def test_a_clock_after_2100_is_neither_used_nor_stored_and_told(config, clock, tmp_path, utc_s):
    """Signed with the last timestamp, or near it, no frame of ours would ever again be newer."""
    path = tmp_path / "runs" / TIMESTAMP_FILE
    good_s, clock.utc_s = clock.utc_s, utc_s
    kept = KeptSigning(config)
    stamps = used(kept)
    assert stamps == sorted(set(stamps))
    assert stamps[-1] < timestamp_at(good_s)
    assert kept.wrong_clock is not None
    kept.close()
    assert int(path.read_text()) == stamps[-1]
    clock.utc_s = good_s
    kept = KeptSigning(config)
    assert kept.wrong_clock is None
    assert timestamp_at(good_s) < used(kept)[0] < timestamp_at(good_s + 60.0)
    kept.close()
    stored = int(path.read_text())
    clock.utc_s = utc_s
    kept = KeptSigning(config)
    assert stored < used(kept)[0] < stored + 60 * TICKS_PER_S
    kept.close()
    found = Preflight()
    _vehicle(msgspec.structs.replace(config, vehicle=unreachable(config.vehicle)), found)
    told = [finding.line() for finding in found.findings]
    assert any(line.startswith("red") and "clock is later than the year 2100" in line for line in told)


@pytest.mark.parametrize("text", [f"{timestamp_at(PLAUSIBLE_UTC_S)}\n", f"{LATEST - 10**7}\n"])
def test_a_stored_timestamp_after_2100_is_not_used(config, clock, tmp_path, text):
    path = tmp_path / "runs" / TIMESTAMP_FILE
    path.parent.mkdir()
    path.write_text(text)
    kept = KeptSigning(config)
    assert used(kept)[0] == timestamp_at(clock.utc_s) + 1
    assert kept.unread == f"{path}: damaged"


def test_a_time_of_the_vehicle_after_2100_is_followed_but_not_stored(config, clock, tmp_path):
    kept = KeptSigning(config)
    before = int((tmp_path / "runs" / TIMESTAMP_FILE).read_text())
    kept.signing.timestamp = timestamp_at(PLAUSIBLE_UTC_S)
    kept.close()
    assert int((tmp_path / "runs" / TIMESTAMP_FILE).read_text()) == before
    assert "later than the year 2100" in kept.error


def test_what_a_killed_process_used_after_its_last_write_is_not_used_again(config, clock):
    kept = KeptSigning(config)
    kept.signing.advance(1000.0 + PERIOD_S - 0.01)
    last = used(kept)[-1]
    clock.utc_s = 0.0
    assert used(KeptSigning(config))[0] > last


def test_a_peer_that_is_ahead_is_followed_over_the_restart(config, clock):
    kept = KeptSigning(config)
    kept.signing.timestamp += 1000 * TICKS_PER_S
    last = used(kept)[-1]
    kept.close()
    assert used(KeptSigning(config))[0] > last


def test_of_two_that_share_the_file_the_one_that_is_behind_sets_nothing_back(config, clock):
    """Two companions of one computer, or a `companion check` beside a flight."""
    behind = KeptSigning(config)
    ahead = KeptSigning(config)
    ahead.signing.timestamp += 1000 * TICKS_PER_S
    last = used(ahead)[-1]
    ahead.close()
    behind.close()
    clock.utc_s = 0.0
    assert used(KeptSigning(config))[0] > last


@pytest.mark.parametrize("text", ["", "abc", "-5", "9" * 30, "9" * 18, "281474976710655\n", "\xff"])
def test_a_damaged_file_is_begun_anew_and_told(config, clock, tmp_path, text):
    (tmp_path / "runs").mkdir()
    path = tmp_path / "runs" / TIMESTAMP_FILE
    path.write_text(text)
    kept = KeptSigning(config)
    assert used(kept)[0] == timestamp_at(clock.utc_s) + 1
    assert kept.unread == f"{path}: damaged"


def test_it_is_kept_while_flying(config, monkeypatch, until, tmp_path):
    monkeypatch.setattr(signing_key, "PERIOD_S", 0.01)
    kept = KeptSigning(config)
    assert kept.unread is None
    last = used(kept, 1000)[-1]
    until(lambda: int((tmp_path / "runs" / TIMESTAMP_FILE).read_text()) >= last)
    kept.close()


def test_a_folder_that_cannot_be_written_is_told_and_signs_all_the_same(config, clock, tmp_path):
    (tmp_path / "runs").write_text("a file")
    kept = KeptSigning(config)
    assert used(kept)[0] == timestamp_at(clock.utc_s) + 1
    path = tmp_path / "runs" / TIMESTAMP_FILE
    assert kept.unread == f"{path}: cannot be read: Not a directory"
    assert kept.error == f"{tmp_path / 'runs'}: cannot be written: File exists"
    kept.close()
    found = Preflight()
    _vehicle(msgspec.structs.replace(config, vehicle=unreachable(config.vehicle)), found)
    told = [finding.line() for finding in found.findings]
    assert any(line.startswith("red") and "signing" in line and "cannot be written" in line for line in told)


def unreachable(vehicle):
    return msgspec.structs.replace(vehicle, link="tcp:127.0.0.1:1")


def test_a_disk_that_fills_in_flight_is_told_and_no_more_once_it_takes_it_again(
    config, monkeypatch, until, tmp_path
):
    monkeypatch.setattr(signing_key, "PERIOD_S", 0.01)
    full = threading.Event()

    def replace_file(path, data):
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        disk.replace_file(path, data)

    monkeypatch.setattr(signing_key, "replace_file", replace_file)
    kept = KeptSigning(config)
    assert kept.error is None
    full.set()
    until(lambda: kept.error is not None)
    assert kept.error == f"{tmp_path / 'runs' / TIMESTAMP_FILE}: cannot be written: No space left on device"
    full.clear()
    until(lambda: kept.error is None)
    kept.close()


def test_a_disk_that_hangs_holds_up_neither_start_nor_end(config, monkeypatch):
    monkeypatch.setattr(signing_key, "PERIOD_S", 0.01)
    monkeypatch.setattr(signing_key, "_PATIENCE_S", 0.01)
    goes_on = threading.Event()
    monkeypatch.setattr(signing_key, "replace_file", lambda *_: goes_on.wait())
    kept = KeptSigning(config)
    assert "does not answer" in kept.error
    assert used(kept)
    kept.close()
    goes_on.set()


def test_a_wall_clock_that_jumps_in_flight_changes_no_timestamp(config, clock):
    """It is read once, at the start."""
    kept = KeptSigning(config)
    first = used(kept, 1)[0]
    for utc_s in (0.0, 4e9):
        clock.utc_s = utc_s
        kept.signing.advance(1000.0)
        (last,) = used(kept, 1)
        assert 0 < last - first < 10
