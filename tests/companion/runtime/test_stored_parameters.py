"""What ground stations have set outlives the process, whole or not at all."""

from __future__ import annotations

import threading
from pathlib import Path

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.commands.check import _settings
from companion.commands.preflight import Preflight
from companion.config import Config, IdentityConfig, LimitsConfig, RecordConfig, load
from companion.errors import ConfigError
from companion.events import Settings
from companion.runtime.flight import Flight
from companion.runtime.stored_parameters import KeptSettings, read_settings, settings_path, usable_settings
from tests.companion.runtime.flying import KEY, Autopilot, Radio, configured, fly, heard_of

SET = Settings(enable=False, max_speed_mps=3.5)


@pytest.fixture
def config(tmp_path):
    return Config(identity=IdentityConfig(uas_id="A/B"), record=RecordConfig(folder=str(tmp_path / "runs")))


def test_what_is_kept_is_read_again(config):
    assert read_settings(config) == Settings()
    kept = KeptSettings(config, Settings())
    for radius in range(3, 20):
        kept.keep(Settings(conflict_radius_m=float(radius)))
    kept.keep(SET)
    kept.close()
    assert "settings" not in {thread.name for thread in threading.enumerate()}
    assert kept.error is None
    assert read_settings(config) == SET
    assert [p.name for p in settings_path(config).parent.iterdir()] == ["settings-A_B.json"]


def test_nothing_is_written_of_what_was_read(config):
    kept = KeptSettings(config, SET)
    kept.keep(SET)
    kept.close()
    assert not settings_path(config).exists()


def test_a_write_that_fails_leaves_the_old_file_and_says_so(config, monkeypatch):
    kept = KeptSettings(config, Settings())
    kept.keep(SET)
    kept.close()

    def full(_file):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("companion.runtime.record.disk.os.fsync", full)
    kept = KeptSettings(config, SET)
    kept.keep(Settings(horizon_s=9.0))
    kept.close()
    assert "No space left" in (kept.error or "")
    assert read_settings(config) == SET


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "damaged"),
        (b'{"type":"Settings","enable":fal', "damaged"),
        (b'{"type":"Settings","enable":"no"}', "enable"),
        (b'{"type":"Settings","speed":3}', "speed"),
        (b'{"type":"Heartbeat"}', "Heartbeat"),
        (b"\xff\xfe\x00", "damaged"),
        (b"[" * 4096, "damaged"),
        (b'{"type":"Settings","conflict_radius_m":900}', "DMUCA_RADIUS: 900: allowed: 2 to 50"),
        (b'{"type":"Settings","max_speed_mps":7}', "DMUCA_SPD_MAX: 7: allowed: 1 to 5"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_reason(config, content, why):
    path = settings_path(config)
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=f"{path.name}.*{why}"):
        read_settings(config)
    found = Preflight()
    _settings(config, found)
    assert not found.ready
    assert why in found.findings[0].line()


def test_a_file_in_the_place_of_the_folder_holds_no_settings(config):
    settings_path(config).parent.write_text("no folder")
    assert usable_settings(config, pytest.fail, pytest.fail) == Settings()


def test_check_shows_what_is_set(config):
    found = Preflight()
    _settings(config, found)
    assert "as configured" in found.findings[0].line()
    path = settings_path(config)
    path.parent.mkdir()
    path.write_bytes(msgspec.json.encode(SET))
    found = Preflight()
    _settings(config, found)
    lines = " ".join(f.line() for f in found.findings)
    assert "DMUCA_ENABLE 0, was 1" in lines
    assert "DMUCA_SPD_MAX 3.5, was 5" in lines
    assert found.ready


def test_a_flight_stores_what_is_set_and_the_next_one_begins_with_it(
    make_config, tmp_path, kept_signals, watchdog, until
):
    sets = MavlinkWriter(255, 190).pack(
        mavlink.MAVLink_param_set_message(1, 191, b"DMUCA_ENABLE", 0.0, mavlink.MAV_PARAM_TYPE_REAL32)
    )
    autopilot, said = Autopilot(wrap=lambda heartbeat: heartbeat + sets), []
    made = configured(make_config, tmp_path, autopilot.port)
    flight = Flight(made, said.append, dry_run=False)
    flight.radio = Radio()
    fly(flight, lambda: until(lambda: settings_path(made).exists()))
    assert read_settings(made) == Settings(enable=False)

    again = Flight(made, said.append, dry_run=False)
    assert again.onboard.settings == Settings(enable=False)
    until(lambda: "settings: DMUCA_ENABLE 0, was 1" in said)
    again._close()

    settings_path(made).write_bytes(b"{")
    damaged = Flight(made, said.append, dry_run=False)
    assert damaged.onboard.settings == Settings(enable=False)
    named = f"{settings_path(made)}: damaged"
    until(
        lambda: any(named in line and "switched off until DMUCA_ENABLE is set to 1" in line for line in said)
    )
    damaged._close()
    autopilot.end()


def test_settings_of_another_configuration_are_not_used(config):
    path = settings_path(config)
    path.parent.mkdir()
    path.write_bytes(msgspec.json.encode(SET))
    slower = msgspec.structs.replace(config, limits=LimitsConfig(max_speed_mps=3.0))
    with pytest.raises(ConfigError, match="DMUCA_SPD_MAX"):
        read_settings(slower)


@pytest.mark.parametrize(
    ("content", "enable"),
    [
        (msgspec.json.encode(SET), False),
        (b'{"type":"Settings","enable":false,"speed":3}', False),
        (b'{"type":"Settings","max_speed_mps":3.5}', True),
        (b'{"type":"Settings","enable":fal', False),
        (b'{"type":"Settings","enable":false', False),
        (b"", False),
        (b"\0" * 60, False),
        (b"[" * 4096, False),
    ],
)
def test_a_companion_that_was_or_may_have_been_switched_off_stays_so(config, content, enable):
    path = settings_path(config)
    path.parent.mkdir()
    path.write_bytes(content)
    slower = msgspec.structs.replace(config, limits=LimitsConfig(max_speed_mps=3.0))
    told = []
    assert usable_settings(slower, lambda _line: None, told.append) == Settings(enable=enable)
    assert str(path) in told[0]
    assert ("switched off until DMUCA_ENABLE is set to 1" in told[0]) is not enable


def test_a_companion_whose_settings_cannot_be_read_is_switched_off_until_a_pilot_switches_it_on(config):
    path = settings_path(config)
    path.mkdir(parents=True)  # as unreadable as one on a failing disk, also for root
    told = []
    settings = usable_settings(config, lambda _line: None, told.append)
    assert settings == Settings(enable=False)
    assert f"{path}: cannot be read" in told[0]
    path.rmdir()
    kept = KeptSettings(config, settings)
    kept.keep(Settings())
    kept.close()
    assert usable_settings(config, lambda _line: None, pytest.fail) == Settings()


@pytest.mark.parametrize("linked", [False, True])
def test_a_switched_off_companion_stays_so_while_the_disk_with_its_settings_is_not_mounted(
    tmp_path, config, linked
):
    """A missing file on a missing disk is not a file that was never written."""
    disk, folder = tmp_path / "media" / "disk", tmp_path / "media" / "disk" / "runs"
    disk.mkdir(parents=True)
    if linked:
        folder = tmp_path / "runs"
        folder.symlink_to(disk / "runs")
        (disk / "runs").mkdir()
    config = msgspec.structs.replace(config, record=RecordConfig(folder=str(folder)))
    kept = KeptSettings(config, Settings())
    kept.keep(Settings(enable=False))
    kept.close()
    assert read_settings(config) == Settings(enable=False)
    disk.rename(tmp_path / "elsewhere")
    for _start in range(2):
        told = []
        settings = usable_settings(config, lambda _line: None, told.append)
        assert settings == Settings(enable=False)
        assert str(folder) in told[0]
        assert "mount its disk" in told[0]
        # What is stored now must not make the folder, which the next start would take for the disk.
        kept = KeptSettings(config, settings)
        kept.keep(Settings(horizon_s=9.0))
        kept.close()
        assert kept.error is not None
        assert not disk.exists()
    found = Preflight()
    _settings(config, found)
    assert not found.ready
    (tmp_path / "elsewhere").rename(disk)
    assert read_settings(config) == Settings(enable=False)


def test_a_flight_without_the_disk_of_its_folder_starts_switched_off_and_does_not_make_the_folder(
    make_config, tmp_path, kept_signals, watchdog, until, autopilot, said
):
    made = configured(make_config, tmp_path, autopilot.port)
    folder = tmp_path / "media" / "disk" / "runs"
    key = tmp_path / "key"
    key.write_bytes(KEY)
    key.chmod(0o600)
    made = msgspec.structs.replace(
        made,
        record=RecordConfig(folder=str(folder)),
        vehicle=msgspec.structs.replace(made.vehicle, signing_key=str(key)),
    )
    flight = Flight(made, said.append, dry_run=False)
    assert flight.onboard.settings == Settings(enable=False)
    flight._close()
    missing = f"there is no folder {folder.parent}; mount its disk"
    assert any("switched off until DMUCA_ENABLE is set to 1" in line and missing in line for line in said)
    assert flight._signing.unread is not None
    assert missing in flight._signing.unread
    made = msgspec.structs.replace(made, vehicle=msgspec.structs.replace(made.vehicle, signing_key=None))
    flight = Flight(made, said.append, dry_run=False)
    flight.radio = Radio()
    fly(flight, lambda: until(heard_of(said, "not recording: record.folder")))
    assert heard_of(said, missing)()
    assert not folder.parent.exists()


def test_what_is_stored_does_not_depend_on_the_folder_of_the_start(tmp_path, monkeypatch):
    (tmp_path / "c.toml").write_text('[identity]\nuas_id = "A1"\n')
    found = set()
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        found |= {settings_path(load(path)) for path in (tmp_path / "c.toml", Path("../c.toml"))}
    assert all(path.is_absolute() for path in found)
    assert {path.resolve() for path in found} == {tmp_path / "runs" / "settings-A1.json"}


def test_a_service_stores_where_systemd_lets_it_write(tmp_path, monkeypatch):
    (tmp_path / "c.toml").write_text('[identity]\nuas_id = "A1"\n')
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}/state:{tmp_path}/other")
    assert settings_path(load(tmp_path / "c.toml")) == tmp_path / "state" / "runs" / "settings-A1.json"
