"""Configuration: every wrong input is one line that names the key and what is allowed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from companion import config as configuration
from companion.errors import ConfigError

IDENTITY = '[identity]\nuas_id = "A1"\n'
TRAJECTORY = """altitude = "home"
waypoint = [
  { t_s = 0.0, lat_deg = 47.0, lon_deg = 8.0, alt_m = 30.0 },
  { t_s = 60.0, lat_deg = 47.001, lon_deg = 8.0, alt_m = 30.0 },
]
"""


def write(folder: Path, text: str, name: str = "c.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "identity: missing"),
        ("[identity]\n", "identity.uas_id: missing"),
        ("[foo]\na = 1\n", "foo: unknown key; allowed here: identity, vehicle, "),
        (IDENTITY + "[limits]\nmax_speed_mps = 500\n", "limits.max_speed_mps: 500: expected float <= 50"),
        (
            IDENTITY + "[limits]\nmax_sped_mps = 5\n",
            "limits.max_sped_mps: unknown key; allowed here: ",
        ),
        (IDENTITY + '[limits]\nmax_speed_mps = "x"\n', "limits.max_speed_mps: 'x': expected float, got str"),
        (IDENTITY + "[limits]\nmax_speed_mps = nan\n", "limits.max_speed_mps: nan is not a finite number"),
        (IDENTITY + '[flight]\nuse = "fly"\n', "flight.trajectory: missing"),
        (IDENTITY + '[flight]\ntrajectory = "mission"\n', "flight.mission_speed_mps: missing"),
        (IDENTITY + '[flight]\nstart = "utc"\n', "flight.start_utc_s: missing"),
        (
            IDENTITY + '[radio]\nbackend = "null"\n',
            "radio: one table for each radio is needed: write [[radio]]",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "eter"\n',
            "radio[0].backend: 'eter': allowed are 'null', 'ether', 'hci'",
        ),
        (IDENTITY + '[[radio]]\nbackend = "ether"\n', "radio[0].address: missing"),
        (
            IDENTITY + '[[radio]]\nbackend = "hci"\nchanel = "user:0"\n',
            "radio[0].chanel: unknown key; allowed here: channel, send, listen",
        ),
        (IDENTITY + '[[radio]]\nbackend = "wifi"\n', "radio[0]: needs hostapd, inject or monitor"),
        (IDENTITY + '[remote_id]\nregion = "xy.toml"\n', "xy.toml: cannot be read"),
        (IDENTITY + '[remote_id]\nregion = "xy.toml"\n', "c.toml: remote_id.region: "),
        (
            IDENTITY + '[[radio]]\nbackend = "null"\nx = 1\n',
            "radio[0].x: unknown key; allowed here: no other",
        ),
        (
            IDENTITY + '[remote_id]\ntransports = ["lora"]\n',
            "remote_id.transports[0]: 'lora': allowed are 'ble4', 'ble5', 'wifi', 'nan'",
        ),
        (
            IDENTITY + "[limits]\nfloor_height_m = 50\nceiling_height_m = 40\n",
            "limits.ceiling_height_m: 40 must be 5 m or more above floor_height_m 50",
        ),
        (IDENTITY + '[flight]\ntrajectory = "none.toml"\n', "none.toml: cannot be read: No such file"),
        ("= 3", "not valid TOML"),
        ('[identity]\nuas_id = "Ünicode"\n', "identity.uas_id: 'Ünicode': printable ASCII"),
    ],
)
def test_wrong_input(tmp_path, text, message):
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        configuration.load(write(tmp_path, text))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "value", ['"FIN87astrdge12k8-xyz"' + "x", '["FIN87astrdge12k8-xyz"]', '"FIN87astrdge12k8-xyzxyzxyz"']
)
def test_no_error_text_holds_the_operators_secret(tmp_path, value):
    with pytest.raises(ConfigError) as caught:
        configuration.load(write(tmp_path, IDENTITY + f"[remote_id]\noperator_id = {value}\n"))
    assert "xyz" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("t_s = 60.0", "t_s = 0.0", "waypoint[1].t_s: 0 s is not after the one before it (0 s)"),
        ("lat_deg = 47.001", "lat_deg = 97.0", "waypoint[1].lat_deg: 97.0: expected float <= 90"),
        ("alt_m = 30.0 }", "alt = 30.0 }", "waypoint[0].alt: unknown key; allowed here: t_s, lat_deg"),
        ('"home"', '"hom"', "altitude: 'hom': allowed are 'home', 'msl', 'geodetic'"),
    ],
)
def test_wrong_trajectory(tmp_path, old, new, message):
    write(tmp_path, TRAJECTORY.replace(old, new), "t.toml")
    path = write(tmp_path, IDENTITY + '[flight]\nuse = "fly"\ntrajectory = "t.toml"\n')
    with pytest.raises(ConfigError, match=re.escape(message)):
        configuration.load(path)


def test_a_resolved_configuration_stands_alone_and_reads_back_equal(tmp_path):
    write(tmp_path, TRAJECTORY, "t.toml")
    path = write(tmp_path, IDENTITY + '[flight]\ntrajectory = "t.toml"\n')
    loaded = configuration.load(path)
    (tmp_path / "t.toml").unlink()
    resolved = tmp_path / "resolved.toml"
    resolved.write_bytes(configuration.dump(loaded))
    assert configuration.load(resolved) == loaded
    assert loaded.path is not None
    assert len(loaded.path.waypoint) == 2


def test_flying_deaf_is_refused(tmp_path):
    write(tmp_path, TRAJECTORY, "t.toml")
    path = write(tmp_path, IDENTITY + '[flight]\nuse = "fly"\ntrajectory = "t.toml"\n')
    with pytest.raises(ConfigError, match="nobody is heard"):
        configuration.load(path)


def test_the_profiles_in_the_project_load():
    folder = Path(__file__).parents[2] / "config"
    profiles = sorted(folder.glob("companion*.toml"))
    assert profiles
    for profile in profiles:
        configuration.load(profile)
