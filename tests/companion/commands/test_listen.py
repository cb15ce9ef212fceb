"""Received senders in a bounded table, with texts that cannot contain terminal control codes."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from companion.commands.cli import main
from companion.commands.heard_table import (
    FORGET_S,
    MAX_AIRCRAFT,
    HeardTable,
    cells,
    health_words,
    identity_words,
    json_line,
)
from companion.commands.listen import LiveTable, PlainLines, drawing
from companion.config import Config
from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.hci.section import HciRadio
from companion.radio.radio import Health
from companion.radio.wifi.section import WifiRadio
from companion.remote_id.messages import (
    BasicId,
    IdType,
    Location,
    Message,
    OperatorId,
    SelfId,
    Status,
    System,
    UaType,
)
from companion.runtime.radios import Radios

HEALTH = Health(ok=True, text="wlan0: listening", frames_sent=0, frames_heard=7, bad_frames=2)
LOCATION = Location(
    status=Status.AIRBORNE,
    lat_deg=47.5,
    lon_deg=8.5,
    alt_geodetic_m=512.5,
    speed_mps=4.25,
    direction_deg=123.0,
)


def named(uas_id: str, id_type: IdType = IdType.SERIAL_NUMBER) -> BasicId:
    return BasicId(id_type=id_type, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=uas_id)


def frame(
    *messages: Message, address: str = "c2:01", transport: str = "wifi", rssi_dbm: float | None = -60.0
) -> RemoteIdHeard:
    return RemoteIdHeard(transport=transport, address=address, messages=messages, rssi_dbm=rssi_dbm)


def test_everything_an_aircraft_says_is_in_its_row() -> None:
    heard = HeardTable()
    heard.add(frame(named("1596B0000DMUCA01"), LOCATION), 10.0)
    heard.add(frame(System(operator_lat_deg=47.0, operator_lon_deg=8.0), transport="ble5"), 10.5)
    heard.add(frame(OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8")), 11.0)
    heard.add(frame(SelfId(description_type=0, text="survey"), rssi_dbm=-71.4), 12.0)
    (aircraft,) = heard.newest_first()
    assert cells(aircraft, 12.25) == {
        "identity": "1596B0000DMUCA01",
        "type": "helicopter or multirotor",
        "on": "ble5+wifi",
        "address": "c2:01",
        "dBm": "-71",
        "age s": "0.2",
        "position": "47.500000 8.500000",
        "alt m": "512.5",
        "m/s": "4.2",
        "track": "123°",
        "status": "airborne",
        "operator": "FIN87astrdge12k8",
        "operator at": "47.000000 8.000000",
        "about": "survey",
        "msg/s": "2.2",
    }


def test_what_is_unknown_is_a_dash() -> None:
    heard = HeardTable()
    heard.add(frame(Location(alt_baro_m=100.0), rssi_dbm=None), 0.0)
    row = cells(heard.newest_first()[0], 0.0)
    assert (row["identity"], row["type"], row["dBm"], row["position"]) == ("?", "-", "-", "-")
    assert (row["alt m"], row["m/s"], row["track"]) == ("100.0 baro", "-", "-")
    assert (row["operator"], row["operator at"]) == ("-", "-")


def test_an_operator_without_a_position_is_its_id_alone() -> None:
    heard = HeardTable()
    heard.add(frame(OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8")), 0.0)
    row = cells(heard.newest_first()[0], 0.0)
    assert (row["operator"], row["operator at"]) == ("FIN87astrdge12k8", "-")


def test_messages_a_second_are_those_of_the_last_ten_seconds() -> None:
    heard = HeardTable()
    for tick in range(60):
        heard.add(frame(named("A"), LOCATION), tick * 0.5)
    (aircraft,) = heard.newest_first()
    assert aircraft.rate_per_s(29.5) == 4.0
    assert aircraft.rate_per_s(34.5) == 2.0
    assert aircraft.rate_per_s(60.0) == 0.0


def test_an_aircraft_is_one_row_on_all_its_addresses_once_named() -> None:
    heard = HeardTable()
    heard.add(frame(LOCATION, address="c2:01", transport="ble4"), 0.0)
    heard.add(frame(named("A"), address="c2:01", transport="ble4"), 1.0)
    heard.add(frame(named("A"), LOCATION, address="02:99", transport="wifi"), 2.0)
    heard.add(frame(LOCATION, address="c2:01", transport="ble4"), 3.0)
    (aircraft,) = heard.newest_first()
    assert (list(aircraft.addresses), list(aircraft.transports)) == (["02:99", "c2:01"], ["ble4", "wifi"])
    assert aircraft.messages == 5


def test_a_second_identity_does_not_rename() -> None:
    heard = HeardTable()
    for uas_id in ("SERIAL", "JU322627C69E", "SERIAL"):
        heard.add(frame(named(uas_id)), 0.0)
    assert [identity_words(a.basic_id) for a in heard.newest_first()] == ["SERIAL"]
    heard.add(frame(named("X", IdType.NONE), named(""), address="c2:02"), 0.0)
    assert [identity_words(a.basic_id) for a in heard.newest_first()] == ["?", "SERIAL"]


def test_raw_identities_are_shown_in_hexadecimal() -> None:
    assert identity_words(named("\x01\x20\xff", IdType.SPECIFIC_SESSION)) == "0120ff"


def test_the_table_is_bounded_newest_first_and_forgets() -> None:
    heard = HeardTable()
    for number in range(3 * MAX_AIRCRAFT):
        heard.add(frame(named(f"A{number}"), address=f"a{number}"), number * 0.01)
        heard.add(frame(named("SAME"), address=f"b{number}"), number * 0.01)
    assert len(heard) == MAX_AIRCRAFT
    assert identity_words(heard.newest_first()[0].basic_id) == "SAME"
    assert len(heard._names) <= 4 * MAX_AIRCRAFT
    heard.forget(3 * MAX_AIRCRAFT * 0.01 + FORGET_S)
    assert len(heard) == 0
    assert heard._names == {}


@given(
    st.lists(
        st.tuples(st.integers(0, 12), st.none() | st.integers(0, 5), st.sampled_from(["wifi", "ble4"])),
        max_size=60,
    )
)
@settings(derandomize=True, deadline=None)
def test_every_address_is_remembered_by_one_aircraft(frames: list[tuple[int, int | None, str]]) -> None:
    heard = HeardTable()
    for at, (address, name, transport) in enumerate(frames):
        messages = () if name is None else (named(f"A{name}"),)
        taken = heard.add(frame(*messages, LOCATION, address=f"{address}", transport=transport), float(at))
        assert heard.newest_first()[0] is taken
        owned = [a for aircraft in heard.newest_first() for a in aircraft.addresses]
        assert len(owned) == len(set(owned))
        assert set(heard._names) <= set(owned)
        times = [aircraft.last_s for aircraft in heard.newest_first()]
        assert times == sorted(times, reverse=True)


# ---------------------------------------------------------------- hostile words

HOSTILE = "\x1b[2J[bold]\x07\x9b\r\nx"
CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f]")


def hostile_frames() -> list[RemoteIdHeard]:
    return [
        frame(
            named(HOSTILE),
            OperatorId(operator_id_type=0, operator_id=HOSTILE),
            SelfId(description_type=0, text=HOSTILE),
            LOCATION,
            address=HOSTILE,
        ),
        frame(named(HOSTILE, IdType.CAA_REGISTRATION), address="c2:02"),
    ]


def test_no_control_character_reaches_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    heard = HeardTable()
    health = Health(ok=False, text=HOSTILE, frames_sent=0, frames_heard=0, bad_frames=0)
    lines = PlainLines()
    for event in hostile_frames():
        heard.add(event, 0.0)
        print(json_line(event, 1.0))
    with lines:
        lines.show(heard, health, 0.0)
    screen = io.StringIO()
    Console(file=screen, width=250, color_system=None).print(drawing(heard, health, 0.0, 50))
    for shown in (capsys.readouterr().out, screen.getvalue()):
        assert "[2J[bold]" in shown  # the words are there, markup and all
        assert not CONTROL.search(shown)


@given(st.text(max_size=30))
@settings(derandomize=True, deadline=None)
def test_a_line_of_json_is_the_frame_whatever_it_holds(text: str) -> None:
    text = text.encode("utf-8", "replace").decode()
    line = json_line(frame(SelfId(description_type=3, text=text), LOCATION, address=text), 12.3456)
    assert line.isprintable()
    fields: dict[str, Any] = json.loads(line)
    assert (fields["time_utc_s"], fields["transport"], fields["address"]) == (12.346, "wifi", text)
    assert fields["messages"][0] == {"type": "SelfId", "description_type": 3, "text": text}
    assert fields["messages"][1]["lat_deg"] == 47.5


# ---------------------------------------------------------------- views


def test_the_live_table_is_drawn_at_its_own_pace() -> None:
    screen = io.StringIO()
    heard = HeardTable()
    heard.add(frame(named("1596B0000DMUCA01"), LOCATION), 0.0)
    with LiveTable(Console(file=screen, width=250, force_terminal=True)) as view:
        for tick in range(20):
            view.show(heard, HEALTH, tick * 0.05)
    assert screen.getvalue().count("1596B0000DMUCA01") in (4, 5)  # four times a second, and once at the end
    assert "wlan0: listening; 1 aircraft, 7 frames heard, 2 bad" in screen.getvalue()


def test_a_crowd_hides_neither_the_radios_nor_the_newest() -> None:
    screen = io.StringIO()
    heard = HeardTable()
    for number in range(200):
        heard.add(frame(named(f"A{number:03}"), LOCATION, address=f"c2:{number}"), number * 0.01)
    health = Health(ok=False, text="gone", frames_sent=0, frames_heard=7, bad_frames=2)
    with LiveTable(Console(file=screen, width=250, height=12, force_terminal=True)) as view:
        view.show(heard, health, 2.0)
        drawn = screen.getvalue()
        assert "NOT OK: gone; 200 aircraft, 7 frames heard, 2 bad" in drawn
        assert "A199" in drawn
    assert set(re.findall(r"A\d{3}", screen.getvalue())) <= {f"A{number:03}" for number in range(188, 200)}


def test_plain_lines_come_once_a_second_for_who_was_heard(capsys: pytest.CaptureFixture[str]) -> None:
    heard = HeardTable()
    with PlainLines() as view:
        heard.add(frame(named("A")), 0.0)
        view.show(heard, HEALTH, 0.05)
        heard.add(frame(named("B"), address="c2:02"), 0.5)
        view.show(heard, HEALTH, 0.55)
        view.show(heard, HEALTH, 1.1)
        view.show(heard, HEALTH, 2.2)
    lines = capsys.readouterr().out.splitlines()
    assert [re.split("[; ]", line)[1] for line in lines] == ["wlan0:", "A", "B", "wlan0:"]


def test_a_radio_that_is_not_well_says_so() -> None:
    health = Health(ok=False, text="gone", frames_sent=0, frames_heard=0, bad_frames=0)
    assert health_words(health, 0) == "NOT OK: gone; 0 aircraft, 0 frames heard, 0 bad"


# ---------------------------------------------------------------- what is asked for wrongly


@pytest.mark.parametrize(
    ("toml", "says"),
    [
        ('[identity]\nuas_id = "A1"\n', "radio: none configured, so nothing can be received"),
        ('[identity]\nuas_id = "A1"\n[[radio]]\nbackend = "null"\n', "radio: none configured"),
        (
            '[identity]\nuas_id = "A1"\n[[radio]]\nbackend = "arduremoteid"\nlink = "udpout:127.0.0.1:9"\n'
            '[[radio]]\nbackend = "hci"\nchannel = "tcp:127.0.0.1:9"\nlisten = false\n'
            '[[radio]]\nbackend = "wifi"\nhostapd = "/nowhere"\n',
            "none of the configured radios can listen",
        ),
        ('[identity]\nuas_id = "A1"\n[[radio]]\nbackend = "ether"\naddress = "x"\n', "HOST:PORT"),
    ],
)
def test_a_configuration_without_a_radio_is_refused_in_words(
    toml: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "my.toml"
    path.write_text(toml)
    assert main(["remote-id", "listen", "--config", str(path)]) == 2
    assert says in capsys.readouterr().err


def test_what_sends_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened: list[Config] = []

    def radios(config: Config, *, sending: bool) -> Radios:
        assert not sending
        opened.append(config)
        raise ConfigError("seen")

    monkeypatch.setattr("companion.commands.listen.Radios", radios)
    path = tmp_path / "my.toml"
    path.write_text(
        '[identity]\nuas_id = "A1"\n[[radio]]\nbackend = "arduremoteid"\nlink = "udpout:127.0.0.1:9"\n'
        '[[radio]]\nbackend = "hci"\nchannel = "user:0"\n'
        '[[radio]]\nbackend = "wifi"\nhostapd = "/run/x"\ninject = "mon1"\nmonitor = "mon0"\n'
    )
    assert main(["remote-id", "listen", "--config", str(path)]) == 2
    assert opened[0].radio == (HciRadio(channel="user:0", send=False), WifiRadio(monitor="mon0"))


@pytest.mark.parametrize("text", ["wifi", "wifi=", "lora=1", "=mon0", ""])
def test_a_radio_that_is_none_is_refused_in_words(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["remote-id", "listen", "--radio", text]) == 2
    assert f"--radio: {text!r}: allowed: hci=CHANNEL" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["-1", "nan", "inf", "soon"])
def test_seconds_that_are_none_are_refused_in_words(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["remote-id", "listen", "--radio", "ether=127.0.0.1:9", "--seconds", text])
    assert stop.value.code == 2
    assert f"--seconds: {text!r}; allowed: a number of seconds, 0 or more" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_ends_it_in_one_line() -> None:
    command = ["remote-id", "listen", "--radio", "ether=127.0.0.1:9", "--seconds", "0"]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "companion.commands.cli", *command],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
        )
    assert ended.returncode == 1
    assert ended.stderr == "remote-id listen: the output cannot be written: No space left on device\n"
