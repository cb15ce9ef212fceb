"""A short soak: the rules hold, each can be broken, and a seed reproduces a flight."""

from __future__ import annotations

import dataclasses
import json
import math
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import pytest

from companion import ownship
from companion.authority.control import Control
from companion.authority.modes import OurModes
from companion.authority.table import HOLDING
from companion.errors import ConfigError
from companion.events import Firmware
from companion.gate.gate import Gate
from companion.ownship import Ownship
from sitl_mocks import cli
from sitl_mocks.examinations import soak
from sitl_mocks.examinations.faults import KINDS, Fault, drawn, from_json, to_json
from sitl_mocks.examinations.flights import BrokenRuleError, Flights, Told
from sitl_mocks.examinations.soak import Schedule, fly, from_file, schedule_of, shorten, to_file
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

PAIRS = list(product(Firmware, ("guard", "fly")))
LATE = "slow", "up", "late"
"""What the companion is told too late of, or what reaches the vehicle too late: each has cases of its own."""


def schedule(firmware, use, seed=1, hours=0.1):
    drawn_up = schedule_of(firmware, use, seed, hours)
    return dataclasses.replace(drawn_up, faults=tuple(f for f in drawn_up.faults if f.kind not in LATE))


@pytest.mark.parametrize(("firmware", "use"), PAIRS)
def test_no_rule_is_broken(firmware, use, monkeypatch):
    """This flies five minutes with a trouble in almost every one; `sitl-mocks soak` flies hours."""
    monkeypatch.setattr(soak, "_MEAN_S", 35.0)
    told = fly(schedule(firmware, use, 1, 0.09)).told
    assert told.taken > 0
    assert told.setpoints > 100
    assert sum(told.troubles.values()) > 2


def test_a_mission_is_given_back_between_troubles():
    flights = Flights(Firmware.PX4, "guard", 1)
    while not flights.told.given_back:
        assert flights.now_s < 400.0
        flights.step()
    assert (flights.told.faults, flights.told.yielded) == (0, 0)


RTL_WHILE_FLOWN = Schedule(
    Firmware.PX4,
    "fly",
    1,
    "udp",
    60.0,
    (
        Fault("burst", 34.0, numbers=(20.0,)),
        Fault("mode", 40.0, modes=("rtl",)),
        Fault("traffic", 41.0, 5.0, (20.0,)),
    ),
)
"""The companion holds the vehicle from 32 s on."""
GNSS_LOST = Schedule(Firmware.PX4, "fly", 1, "udp", 90.0, (Fault("down", 70.0, 10.0),))


@pytest.mark.parametrize(
    ("where", "name", "broken", "flight", "rule"),
    [
        (OurModes, "judge", lambda self, shown, now_s, held: None, RTL_WHILE_FLOWN, "setpoint"),
        (ownship, "in_mode", lambda beat, custom_mode: beat, RTL_WHILE_FLOWN, "setpoint"),
        (Ownship, "unfit", lambda self, now_s, stale_after_s: None, GNSS_LOST, "stale"),
    ],
)
def test_a_companion_that_breaks_a_rule_is_found_and_the_schedule_cut_down(
    monkeypatch, where, name, broken, flight, rule
):
    monkeypatch.setattr(where, name, broken)
    monkeypatch.setattr(Gate, "release", lambda self, data, now_s: data)
    monkeypatch.setattr(Gate, "current", lambda self, now_s: True)
    monkeypatch.setattr(Gate, "answers", lambda self, now_s, waiting: True)
    with pytest.raises(BrokenRuleError) as caught:
        fly(flight)
    assert caught.value.rule == rule
    short = shorten(flight, caught.value, None)
    assert len(short.faults) == 1
    assert short.until_s < flight.until_s
    with pytest.raises(BrokenRuleError) as again:
        fly(short)
    assert again.value.rule == rule


@pytest.mark.parametrize(
    ("where", "name", "broken", "flight"),
    [
        (OurModes, "judge", lambda self, shown, now_s, held: None, RTL_WHILE_FLOWN),
        (Ownship, "unfit", lambda self, now_s, stale_after_s: None, GNSS_LOST),
    ],
)
def test_the_gate_keeps_the_rules_of_a_core_that_does_not(monkeypatch, where, name, broken, flight):
    """Without the gate they break one (the test above)."""
    monkeypatch.setattr(where, name, broken)
    assert fly(flight).told.setpoints > 0


def test_an_exception_of_the_companion_is_told_with_its_time(monkeypatch):
    def fails(self, now_s, gap_s):
        if now_s > 20.0:
            raise RuntimeError("a bug")

    monkeypatch.setattr(Control, "_unfit", fails)
    with pytest.raises(BrokenRuleError, match=r"at 20\.05 s: exception: RuntimeError: a bug"):
        fly(GNSS_LOST)


def test_a_companion_that_stays_idle_is_found(monkeypatch):
    monkeypatch.setattr(Control, "_watch", lambda self, now_s, cycle, commands: None)
    monkeypatch.setattr(
        "companion.authority.readiness.Readiness.waits_for", lambda self, now_s, ours: "never"
    )
    with pytest.raises(BrokenRuleError, match="idle: no fault for"):
        fly(Schedule(Firmware.ARDUPILOT, "guard", 1, "udp", 200.0, ()))


def test_a_seed_is_a_flight():
    one, other = (dataclasses.asdict(fly(schedule(Firmware.PX4, "guard", hours=0.03))) for _ in range(2))
    del one["memory_mb"], other["memory_mb"]
    assert one == other


def test_a_snapshot_goes_on_as_the_flight_itself():
    flights = Flights(Firmware.ARDUPILOT, "fly", 1)
    while flights.onboard.core.state not in HOLDING:
        flights.step()
    flights.plan(Fault("stall", flights.now_s + 1.0, 2.0), Fault("mode", flights.now_s + 2.0, modes=("rtl",)))
    copies = [flights.snapshot().world() for _ in range(2)]
    ends = []
    for world in (copies[0], flights, copies[1]):
        for _ in range(200):
            super(Flights, world).step()
        ends.append((world.now_s, world.vehicle.position_ned_m, world.vehicle.mode, world.judge.setpoints))
    assert ends[0] == ends[1] == ends[2]
    assert ends[0][2] is VehicleMode.RTL


def test_a_mode_that_is_flown_already_is_not_seen_when_the_pilot_selects_it():
    flights = Flights(Firmware.PX4, "fly", 1)
    while flights.vehicle.mode is not VehicleMode.MISSION or flights.onboard.core.state not in HOLDING:
        flights.step()
    flights.pilot_selects(VehicleMode.MISSION)
    while flights.vehicle.mode is VehicleMode.MISSION:
        flights.step()
    for _ in range(100):
        flights.step()
    assert flights.onboard.core.state in HOLDING


def test_a_schedule_is_plain_text():
    one = schedule_of(Firmware.PX4, "guard", 3, 2.0)
    assert {fault.kind for fault in one.faults} > {"stall", "mode", "late"}
    assert from_file(json.loads(json.dumps(to_file(one, 2)))) == (one, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_every_trouble_begins_and_ends(kind):
    import numpy as np

    fault = drawn(kind, 30.0, 2.0, np.random.default_rng(1))
    assert from_json(json.loads(json.dumps(to_json(fault)))) == fault
    flights = Flights(Firmware.ARDUPILOT, "fly", 1)
    flights.plan(fault)
    while flights.now_s < 31.0 + fault.lasts_s:
        super(Flights, flights).step()
    assert flights.told.troubles == {kind: 1}
    weather = flights.link.weather
    assert (weather.delay_s, weather.rate_bps, weather.down_stands) == (0.0, math.inf, False)
    assert (flights.vehicle.troubles.answers, flights.traffic_hz) == ("right", 0.0)


@pytest.mark.parametrize(
    "entry",
    [{"kind": "flood", "at_s": 1.0}, {"kind": "mode", "at_s": 1.0, "modes": ["acro"]}, {"at_s": 1.0}],
)
def test_an_entry_that_is_none_is_refused(entry):
    with pytest.raises(ConfigError, match="schedule:"):
        from_json(entry)


def test_the_command_replays_a_file(tmp_path, capsys):
    file = tmp_path / "s.json"
    file.write_text(json.dumps(to_file(dataclasses.replace(GNSS_LOST, until_s=5.0), None)))
    assert cli.main(["soak", "--schedule", str(file)]) == 0
    assert capsys.readouterr().out == "no rule was broken\n"
    file.write_text("[]")
    assert cli.main(["soak", "--schedule", str(file)]) == 2
    file.write_text("{}")
    assert cli.main(["soak", "--schedule", str(file)]) == 2


@pytest.mark.parametrize(
    ("setpoints", "code", "words"), [(0, 1, "no result for px4-fly"), (1, 0, "no rule was")]
)
def test_a_companion_that_sent_nothing_has_no_result(monkeypatch, capsys, setpoints, code, words):
    def flown(firmware, use, *_):
        own = setpoints if (firmware, use) == (Firmware.PX4, "fly") else 1
        return soak.Flown(0.25, "udp", Told(setpoints=own))

    monkeypatch.setattr(soak, "_pair", flown)
    monkeypatch.setattr(soak, "worker_pool", ThreadPoolExecutor)
    assert cli.main(["soak"]) == code
    assert words in capsys.readouterr().out.splitlines()[-1]


def test_hours_that_are_none_are_refused(capsys):
    assert cli.main(["soak", "--hours", "0"]) == 2
    assert "--hours: 0 is out of range; allowed: above 0, up to 1000" in capsys.readouterr().err
    assert soak.LINKS == ("udp", "tcp", "pty")
