"""Configuration: every wrong input is one line that names the key and what is allowed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import msgspec
import pytest

from companion import config as configuration
from companion.errors import ConfigError
from companion.events import FenceArea
from companion.radio.ether import datagrams
from companion.radio.hci import channel
from companion.radio.registry import RadioConfig
from companion.runtime.links import open_link

CONFIG = Path(__file__).parents[2] / "config"
RADIOS = Path(__file__).parents[2] / "companion" / "radio"
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
        (
            IDENTITY + "[limits]\nmax_speed_mps = 500\n",
            "limits.max_speed_mps: 500: expected a number, 0.5 to 50",
        ),
        (
            IDENTITY + "[limits]\nmax_sped_mps = 5\n",
            "limits.max_sped_mps: unknown key; did you mean max_speed_mps? allowed here: ",
        ),
        (
            IDENTITY + "[avoidance]\nmax_speed_mp = 5\n",
            "avoidance.max_speed_mp: unknown key; did you mean limits.max_speed_mps? allowed here: ",
        ),
        (
            IDENTITY + '[limits]\nmax_speed_mps = "x"\n',
            "limits.max_speed_mps: 'x': expected a number, 0.5 to 50",
        ),
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
            "radio[0].backend: 'eter': allowed: 'null', 'ether', 'hci'",
        ),
        (IDENTITY + '[[radio]]\nbackend = "ether"\n', "radio[0].address: missing"),
        (
            IDENTITY + '[[radio]]\nbackend = "hci"\nchanel = "user:0"\n',
            "radio[0].chanel: unknown key; did you mean channel? allowed here: channel, send, listen",
        ),
        (IDENTITY + '[[radio]]\nbackend = "wifi"\n', "radio[0]: needs hostapd, inject or monitor"),
        (
            IDENTITY + '[remote_id]\nregion = "usa"\n',
            "c.toml: remote_id.region: 'usa': no such profile; allowed: the path of a profile relative to "
            "c.toml, or one of eu, jp, none, us",
        ),
        (IDENTITY + '[remote_id]\nregion = "."\n', "c.toml: remote_id.region: '.': no such profile; allowed"),
        (IDENTITY + '[remote_id]\nregion = "c.toml"\n', "c.toml: identity: unknown key"),
        (
            IDENTITY + '[remote_id]\ntransports = "wifi"\n',
            """remote_id.transports: 'wifi': expected a list such as ["ble4"]""",
        ),
        (IDENTITY + "[remote_id]\ntransports = []\n", "transports: []: expected a list such as"),
        (IDENTITY + "[remote_id]\nrate = 11\n", "remote_id.rate: 11: expected a whole number, 1 to 10"),
        (IDENTITY + "[remote_id]\nrate = 1.5\n", "remote_id.rate: 1.5: expected a whole number, 1 to 10"),
        (IDENTITY + "[remote_id]\nclass_eu = 9\n", "class_eu: 9: expected a whole number, 0 to 7"),
        (
            IDENTITY + "[vehicle]\ncomponent_id = 1\n",
            "vehicle.component_id: 1: expected a whole number, 2 to 255",
        ),
        (IDENTITY + "[remote_id]\ncomponent = 1\n", "component: 1: expected true or false"),
        (IDENTITY + "[remote_id]\noperator_id = 5\n", "operator_id: expected text of 1 to 24 characters"),
        (IDENTITY + "[flight]\nuse = 3\n", "flight.use: 3: expected one of 'watch', 'guard', 'fly'"),
        (IDENTITY + "[flight]\nstart_utc_s = true\n", "flight.start_utc_s: True: expected a number"),
        (IDENTITY + "[traffic.keys]\nA1 = 3\n", "traffic.keys: every value in it must be text"),
        ("radio = [3]\n" + IDENTITY, "radio[0]: 3: expected a table"),
        (IDENTITY + "[[radio]]\nbackend = 3\n", "radio[0].backend: 3: allowed: 'null', 'ether'"),
        ("identity = 3\n", "identity: 3: expected a table"),
        (
            IDENTITY + "[region]\nbeacon_channels = ['x']\n",
            "beacon_channels[0]: 'x': expected a whole number",
        ),
        (
            IDENTITY + "[region]\ntransport_sets = [['x']]\n",
            "region.transport_sets[0][0]: 'x': allowed: 'ble4'",
        ),
        (
            IDENTITY + '[vehicle]\nlink = "udp:127.0.0.1:14540"\n',
            "c.toml: vehicle.link: 'udp:127.0.0.1:14540': allowed: udpin:HOST:PORT, udpout:HOST:PORT, "
            "tcp:HOST:PORT or serial:DEVICE:BAUD; PORT is 1 to 65535",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "null"\n[[radio]]\nbackend = "ether"\naddress = "h"\n',
            "c.toml: radio[1].address: 'h': allowed: HOST:PORT; PORT is 1 to 65535",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "hci"\nchannel = "hci0"\n',
            "c.toml: radio[0].channel: 'hci0': allowed: user:NUMBER, uart:DEVICE:BAUD or tcp:HOST:PORT; PORT",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "arduremoteid"\nlink = "/dev/ttyACM0"\n',
            "c.toml: radio[0].link: '/dev/ttyACM0': allowed: udpin:HOST:PORT, ",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "wifi"\ninject = "interface0123456"\n',
            "c.toml: radio[0].inject: 'interface0123456': expected text of 1 to 15 characters",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "wifi"\nmonitor = "interface0123456"\n',
            "c.toml: radio[0].monitor: 'interface0123456': expected text of 1 to 15 characters",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "wifi"\nhostapd = "/run/hostapd/interface0123456"\n',
            "c.toml: radio[0].hostapd: '/run/hostapd/interface0123456': the path must end with the name of a "
            "network interface, 1 to 15 characters; 'interface0123456' has 16",
        ),
        (
            IDENTITY + '[[radio]]\nbackend = "null"\nx = 1\n',
            "radio[0].x: unknown key; allowed here: no other",
        ),
        (
            IDENTITY + '[remote_id]\ntransports = ["lora"]\n',
            "remote_id.transports[0]: 'lora': allowed: 'ble4', 'ble5', 'wifi', 'nan'",
        ),
        (
            IDENTITY + "[limits]\nfloor_height_m = 50\nceiling_height_m = 40\n",
            "limits.ceiling_height_m: 40 must be 5 m or more above floor_height_m 50",
        ),
        (IDENTITY + '[flight]\ntrajectory = "none.toml"\n', "none.toml: cannot be read: No such file"),
        ("= 3", "not valid TOML"),
        ('[identity]\nuas_id = "Ünicode"\n', "identity.uas_id: 'Ünicode': allowed: printable ASCII"),
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
        ("lat_deg = 47.001", "lat_deg = 97.0", "waypoint[1].lat_deg: 97.0: expected a number, -90 to 90"),
        (
            "alt_m = 30.0 }",
            "alt = 30.0 }",
            "waypoint[0].alt: unknown key; did you mean alt_m? allowed here: t_s, lat_deg",
        ),
        ('"home"', '"hom"', "altitude: 'hom': allowed: 'home', 'msl', 'geodetic'"),
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


@pytest.mark.parametrize(
    ("id_type", "text", "raw"),
    [
        (3, "123e4567-e89b-42d3-a456-426614174000", "123e4567e89b42d3a456426614174000"),
        (3, "123E4567E89B42D3A456426614174000", "123e4567e89b42d3a456426614174000"),
        (4, "0120010030000000000000000000000001", "0120010030000000000000000000000001"),
        (4, "02a1a2a3a4a5a6a7a8", "02a1a2a3a4a5a6a7a8"),
    ],
)
def test_an_identity_of_raw_bytes_is_written_in_hexadecimal_digits(tmp_path, id_type, text, raw):
    head = f"[identity]\nid_type = {id_type}\n"
    loaded = configuration.load(write(tmp_path, f'{head}uas_id = "{text}"\n'))
    assert loaded.identity.uas_id == bytes.fromhex(raw).decode("latin-1")
    resolved = tmp_path / "resolved.toml"
    resolved.write_bytes(configuration.dump(loaded))
    assert configuration.load(resolved) == loaded
    for wrong in (text[:-1], text + "zz", "drone"):
        with pytest.raises(ConfigError, match=r"c\.toml: identity\.uas_id: .*hexadecimal digits"):
            configuration.load(write(tmp_path, f'{head}uas_id = "{wrong}"\n'))
    with pytest.raises(ConfigError, match=r"c\.toml: identity\.uas_id: .* bytes"):
        configuration.load(write(tmp_path, f'{head}uas_id = "{text[:-2]}"\n'))


@pytest.mark.parametrize("id_type", [1, 2])
def test_an_identity_of_text_has_20_characters_at_most(tmp_path, id_type):
    text = f'[identity]\nid_type = {id_type}\nuas_id = "{"A" * 21}"\n'
    with pytest.raises(ConfigError, match=r"identity\.uas_id: .*: 21 characters; allowed: up to 20"):
        configuration.load(write(tmp_path, text))
    assert configuration.load(write(tmp_path, text.replace("A" * 21, "A" * 20))).identity.id_type == id_type


def test_flying_deaf_is_refused(tmp_path):
    write(tmp_path, TRAJECTORY, "t.toml")
    path = write(tmp_path, IDENTITY + '[flight]\nuse = "fly"\ntrajectory = "t.toml"\n')
    with pytest.raises(ConfigError, match="no aircraft is heard"):
        configuration.load(path)


def tells_form(opened: Callable[[], object]) -> bool:
    """Whether what opens a name takes its form; opening it is another matter."""
    try:
        opened()
    except ConfigError as error:
        return "allowed:" not in str(error) and "expected HOST:PORT" not in str(error)
    return True


LINKS = [
    "udpin:h:1",
    "udpin:h:0",
    "udpout:[::1]:65535",
    "tcp:a.b:5760",
    "serial:/dev/null:57600",
    "serial:/dev/a:b:9",
]
NO_LINKS = ["", "udp:h:1", "udpin:h", "udpin::1", "udpin:h:", "udpin:h:x", "udpin:h:65536", "serial:/dev/a",
            "serial::9", "serial:/dev/a:x", "udpin:h:-1"]  # fmt: skip
CHANNELS = ["user:0", "user:65534", "uart:/dev/null:115200", "tcp:h:1", "tcp:[::1]:65535"]
NO_CHANNELS = ["", "user", "user:", "user:x", "user:a:0", "user:65535", "user:²", "uart:/dev/a", "uart::9",
               "uart:/dev/a:0", "tcp:h", "tcp::1", "tcp:h:0", "tcp:h:65536", "udp:h:1"]  # fmt: skip
ADDRESSES = ["127.0.0.1:1", "h:65535"]
NO_ADDRESSES = ["", "h", ":1", "h:", "h:x", "h:-1", "h:65536", "h:²"]


@pytest.mark.parametrize(
    ("radio", "key", "text", "right"),
    [
        *((None, "link", text, text in LINKS) for text in LINKS + NO_LINKS),
        *(("arduremoteid", "link", text, text in LINKS) for text in LINKS + NO_LINKS),
        *(("hci", "channel", text, text in CHANNELS) for text in CHANNELS + NO_CHANNELS),
        *(("ether", "address", text, text in ADDRESSES) for text in ADDRESSES + NO_ADDRESSES),
    ],
)
def test_the_form_of_a_link_is_checked_as_those_do_that_open_it(
    tmp_path, monkeypatch, radio, key, text, right
):
    def unopened(*_args: object, **_keys: object) -> None:
        raise ConfigError("not opened")

    for where in (open_link, channel):
        for name in ("TcpLink", "UdpLink", "SerialLink", "UserChannel", "UartChannel", "TcpChannel"):
            monkeypatch.setattr(where, name, unopened, raising=False)
    openers = {
        "link": lambda: open_link.open_link(text),
        "channel": lambda: channel.open_channel(text),
        "address": lambda: datagrams.parse_endpoint(text, "address"),
    }
    assert tells_form(openers[key]) is right
    head = f'[[radio]]\nbackend = "{radio}"\n' if radio else "[vehicle]\n"
    path = write(tmp_path, f'{IDENTITY}{head}{key} = "{text}"\n')
    if right:
        configuration.load(path)
    else:
        with pytest.raises(ConfigError, match=rf"\.{key}: .*: allowed: "):
            configuration.load(path)


@pytest.mark.parametrize("text", ["udpout:h:0", "tcp:h:0", "serial:/dev/a:0"])
def test_a_link_to_port_or_baud_0_is_refused(tmp_path, text):
    with pytest.raises(ConfigError, match=r"vehicle\.link: "):
        configuration.load(write(tmp_path, f'{IDENTITY}[vehicle]\nlink = "{text}"\n'))


@pytest.mark.parametrize("region", ["", f'[remote_id]\nregion = "{CONFIG}/regions/none.toml"\n'])
def test_a_serial_number_of_any_form_will_do_without_a_law(tmp_path, region):
    text = '[identity]\nuas_id = "ABC123"\n'
    assert configuration.load(write(tmp_path, text + region)).identity.uas_id == "ABC123"
    with pytest.raises(ConfigError, match=r"identity\.uas_id: 'ABC123': .*by CTA-2063-A"):
        configuration.load(write(tmp_path, f'{text}[remote_id]\nregion = "{CONFIG}/regions/us.toml"\n'))


def test_the_example_shows_every_key_and_every_key_it_shows_is_right(tmp_path):
    example = re.sub(r"(?m)^# (?=\[\[|[a-z0-9_]+ = )", "", (CONFIG / "companion.toml").read_text())
    for radio in sorted(RADIOS.glob("*/example.toml")):
        example += radio.read_text()
    for name in ("regions", "trajectory.toml", "fence.toml"):
        (tmp_path / name).symlink_to(CONFIG / name)
    loaded = configuration.load(write(tmp_path, example))
    shown = tomllib.loads(example)
    for section in set(configuration.Config.__struct_fields__) - {"radio", "path", "fence", "region"}:
        assert shown[section].keys() == set(getattr(loaded, section).__struct_fields__), section
    kinds = {type(radio) for radio in loaded.radio}
    assert kinds == set(get_args(RadioConfig))
    for keys, radio in zip(shown["radio"], loaded.radio, strict=True):
        assert keys.keys() == {"backend", *radio.__struct_fields__}


def test_the_profiles_in_the_project_load():
    profiles = [path for path in sorted(CONFIG.glob("*.toml")) if "[identity]" in path.read_text()]
    assert {path.stem for path in profiles} == {"ardupilot-serial", "ardupilot-udp", "companion", "px4-udp"}
    for profile in profiles:
        loaded = configuration.load(profile)
        assert loaded.flight.use == "watch", "who copies one must ask for more"
        assert not loaded.record.delete_oldest


def test_an_identity_of_raw_bytes_has_a_name_for_people_and_files():
    assert configuration.IdentityConfig(uas_id="1596B0000DMUCA01").name == "1596B0000DMUCA01"
    assert configuration.IdentityConfig(uas_id="\x01\x80").name == "0180"


FENCE = """[[area]]
inclusion = true
points = [[47.0, 8.0], [47.01, 8.0], [47.01, 8.01]]

[[area]]
inclusion = false
center = [47.005, 8.005]
radius_m = 20.0
"""
FENCED = IDENTITY + '[limits]\nfence = "fence.toml"\n'


def test_a_fence_file_is_taken_in_and_stands_in_the_run_folder(tmp_path):
    write(tmp_path, FENCE, "fence.toml")
    loaded = configuration.load(write(tmp_path, FENCED))
    assert loaded.fence == (
        FenceArea(inclusion=True, points=((47.0, 8.0), (47.01, 8.0), (47.01, 8.01))),
        FenceArea(inclusion=False, points=((47.005, 8.005),), radius_m=20.0),
    )
    # As the recorder writes it: alone in a folder of its own.
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.toml").write_bytes(configuration.dump(loaded))
    assert configuration.load(run / "config.toml") == loaded


@pytest.mark.parametrize("law", ["paper", "none"])
@pytest.mark.parametrize("fence", ["vehicle", "fence.toml"])
def test_a_fence_goes_with_a_law_that_keeps_it(tmp_path, fence, law):
    write(tmp_path, FENCE, "fence.toml")
    text = f'{IDENTITY}[limits]\nfence = "{fence}"\n[avoidance]\nlaw = "{law}"\n'
    says = f'limits.fence: needs avoidance.law = "dmuca"; {law!r} keeps no fence'
    with pytest.raises(ConfigError, match=re.escape(says)):
        configuration.load(write(tmp_path, text))
    assert configuration.load(write(tmp_path, text.replace(f'"{law}"', '"dmuca"'))).limits.fence == fence


def test_a_fence_inside_the_configuration_is_checked_as_one_in_a_file(tmp_path):
    areas = (FenceArea(inclusion=True, points=((47.0, 8.0), (47.01, 8.0))),)
    loaded = configuration.load(write(tmp_path, IDENTITY + '[limits]\nfence = "vehicle"\n'))
    with pytest.raises(ConfigError, match=re.escape("run: fence: area[0].points: 2 points")):
        configuration.check(msgspec.structs.replace(loaded, fence=areas), "run")


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('[flight]\ntrajectory = "none.toml"\n', "flight.trajectory"),
        ('[limits]\nfence = "none.toml"\n', "limits.fence"),
    ],
)
def test_a_file_that_is_not_there_is_told_with_the_key_that_names_it(tmp_path, text, key):
    path = write(tmp_path, IDENTITY + text)
    with pytest.raises(ConfigError, match=re.escape(f"{path}: {key}: {tmp_path}/none.toml: cannot be read")):
        configuration.load(path)


def test_the_vehicles_own_fence_needs_no_file(tmp_path):
    loaded = configuration.load(write(tmp_path, IDENTITY + '[limits]\nfence = "vehicle"\n'))
    assert (loaded.limits.fence, loaded.fence) == ("vehicle", ())
    (tmp_path / "run.toml").write_bytes(configuration.dump(loaded))
    assert configuration.load(tmp_path / "run.toml") == loaded


@pytest.mark.parametrize(
    ("fence", "message"),
    [
        (None, "fence.toml: cannot be read: No such file"),
        ("", "fence.toml: area: missing"),
        ("[[area]\n", "fence.toml: not valid TOML"),
        (
            FENCE + "radius = 3\n",
            "fence.toml: area[1].radius: unknown key; did you mean radius_m? allowed here: inclusion, points",
        ),
        (FENCE + "\n[[area]]\ninclusion = 1\n", "fence.toml: area[2].inclusion: "),
        (FENCE.replace("[47.01, 8.0]", "[97.0, 8.0]"), "fence.toml: area[0].points[1]: latitude 97.0"),
        (FENCE.replace(", [47.01, 8.01]", ""), "fence.toml: area[0].points: 2 points"),
        (FENCE.replace("20.0", "-1.0"), "fence.toml: area[1].radius_m: -1.0: allowed: more than 0"),
        (FENCE.replace("radius_m = 20.0", ""), "fence.toml: area[1]"),
    ],
)
def test_a_wrong_fence_is_one_line_with_file_and_key(tmp_path, fence, message):
    if fence is not None:
        write(tmp_path, fence, "fence.toml")
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        configuration.load(write(tmp_path, FENCED))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[identity]\nuas_id = "A1"\nicao = "4B123"\n', "identity.icao: '4B123'"),
        ('[identity]\nuas_id = "A1"\nicao = "4B123G"\n', "identity.icao: '4B123G'"),
        (IDENTITY + "[avoidance]\ncrewed_horizontal_m = 0\n", "avoidance.crewed_horizontal_m: 0: expected"),
        (IDENTITY + "[avoidance]\ncrewed_vertical_m = 1001\n", "avoidance.crewed_vertical_m: 1001: expected"),
    ],
)
def test_wrong_keys_of_crewed_traffic(tmp_path, text, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        configuration.load(write(tmp_path, text))
