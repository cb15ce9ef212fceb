"""What a ground station may set, and what it cannot talk the companion into."""

from __future__ import annotations

import math
import struct

import msgspec
import pytest

from companion import event_record, replay
from companion.adjustable_parameters import NAMES, applied, changed, checked, value_of
from companion.authority.table import State
from companion.config import AvoidanceConfig, Config, FlightConfig, IdentityConfig, LimitsConfig
from companion.core import Companion
from companion.errors import ConfigError
from companion.events import Firmware, FlightMode, Landed, MissionCurrent, Say, SetMode, Settings
from companion.radio.ether.section import EtherRadio
from tests.companion.conftest import Bench, config, mission

CONFIG = Config(
    identity=IdentityConfig(uas_id="OWN"),
    flight=FlightConfig(use="fly", trajectory="mission", mission_speed_mps=3.0),
    limits=LimitsConfig(max_speed_mps=4.3),
    radio=(EtherRadio(address="127.0.0.1:1"),),
)
OFF = Settings(enable=False)


def test_names_fit_their_field():
    assert all(len(name) <= 16 for name in NAMES)


def test_nothing_set_is_the_configuration():
    assert applied(CONFIG, Settings()) == CONFIG
    assert [value_of(name, CONFIG, Settings()) for name in NAMES] == [1.0, 5.0, 20.0, 4.3]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("DMUCA_ENABLE", 0.0, Settings(enable=False)),
        ("DMUCA_RADIUS", 8.25, Settings(conflict_radius_m=8.25)),
        ("DMUCA_HORIZON", 60.0, Settings(horizon_s=60.0)),
        ("DMUCA_SPD_MAX", 3.2, Settings(max_speed_mps=3.2)),
        # As configured, though a 32-bit float is a little above it.
        ("DMUCA_SPD_MAX", 4.3, Settings()),
    ],
)
def test_a_value_comes_as_a_32_bit_float(name, value, expected):
    (sent,) = struct.unpack("<f", struct.pack("<f", value))
    new = changed(name, sent, CONFIG, Settings())
    assert new == expected
    assert value_of(name, CONFIG, new) == value
    assert checked(new, CONFIG) == new


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("DMUCA_ENABLE", 0.5, "0 .watch only., 1"),
        ("DMUCA_ENABLE", math.nan, "0 .watch only., 1"),
        ("DMUCA_RADIUS", 1.9, "2 to 50"),
        ("DMUCA_RADIUS", 51.0, "2 to 50"),
        ("DMUCA_RADIUS", math.nan, "2 to 50"),
        ("DMUCA_HORIZON", math.inf, "5 to 60"),
        ("DMUCA_HORIZON", -20.0, "5 to 60"),
        ("DMUCA_SPD_MAX", 4.4, "1 to 4.3"),
        ("DMUCA_SPD_MAX", 0.0, "1 to 4.3"),
        # The configuration's own checks: the mission is flown at 3 m/s.
        ("DMUCA_SPD_MAX", 2.5, "mission_speed_mps: 3 is above limits.max_speed_mps 2.5"),
    ],
)
def test_what_is_not_allowed_says_what_is(name, value, allowed):
    with pytest.raises(ConfigError, match=f"{name}.*{allowed}"):
        changed(name, value, CONFIG, Settings())


def test_a_configured_value_outside_the_range_can_be_gone_back_to():
    wide = msgspec.structs.replace(CONFIG, avoidance=AvoidanceConfig(conflict_radius_m=80.0))
    set_to = changed("DMUCA_RADIUS", 50.0, wide, Settings())
    assert set_to == Settings(conflict_radius_m=50.0)
    assert changed("DMUCA_RADIUS", 80.0, wide, set_to) == Settings()


def test_settings_of_another_configuration_are_held_against_this_one():
    slower = msgspec.structs.replace(CONFIG, limits=LimitsConfig(max_speed_mps=3.0))
    with pytest.raises(ConfigError, match="DMUCA_SPD_MAX: 4: allowed: 1 to 3"):
        checked(Settings(max_speed_mps=4.0), slower)


# ------------------------------------------------------------ the core


def said(commands):
    return [c.text for c in commands if isinstance(c, Say)]


def flying(make_bench, firmware=Firmware.PX4):
    bench = make_bench()
    bench.firmware = firmware
    bench.mode = FlightMode.MISSION
    bench.until(lambda: bench.core.in_control)
    return bench


@pytest.mark.parametrize("firmware", Firmware)
def test_off_gives_the_vehicle_back_at_once_and_on_takes_it_again(make_bench, firmware):
    bench = flying(make_bench, firmware)
    bench.extra.append(OFF)
    commands = bench.step()
    assert SetMode(mode=FlightMode.HOLD) in commands
    assert [s.velocity_ned_mps for s in bench.setpoints(commands)] == [(0.0, 0.0, 0.0)]
    assert bench.core.state is State.FAULT
    assert "DMUCA: DMUCA_ENABLE 0, was 1" in said(commands)
    assert not bench.setpoints(bench.step(400))
    assert "DMUCA_ENABLE" in bench.core.waits_for(bench.now_s)
    bench.extra.append(Settings())
    bench.until(lambda: bench.core.in_control)


def test_a_vehicle_that_does_not_hold_is_commanded_to_stand_for_seconds_and_no_longer(make_bench):
    bench = flying(make_bench)
    bench.obeys = False
    bench.extra.append(OFF)
    told = bench.setpoints(bench.step(400))
    assert {s.velocity_ned_mps for s in told} == {(0.0, 0.0, 0.0)}
    assert 2.9 < len(told) * 0.05 < 3.1


def test_a_pilot_who_takes_over_meanwhile_is_commanded_nothing(make_bench):
    bench = flying(make_bench)
    bench.obeys = False
    bench.extra.append(OFF)
    bench.step()
    bench.mode = FlightMode.STICKS
    assert not bench.setpoints(bench.step(20))
    assert bench.core.state is State.YIELDED
    bench.extra.append(Settings())
    bench.mode = FlightMode.MISSION
    assert not bench.setpoints(bench.step(400))


def test_off_takes_nothing(make_bench):
    bench = make_bench()
    bench.extra.append(OFF)
    assert not [c for c in bench.step(400) if isinstance(c, SetMode)]
    assert bench.core.state is State.STANDBY


def test_off_watches_no_mission():
    made = msgspec.structs.replace(config(use="guard"), path=None)
    bench = Bench(Companion(made), mission=mission(300.0, 900.0), mode=FlightMode.MISSION)
    bench.extra.append(MissionCurrent(seq=0))
    bench.until(lambda: bench.core.state is State.WATCHING)
    bench.extra.append(OFF)
    bench.step()
    assert bench.core.state is State.STANDBY
    assert "switched off (DMUCA_ENABLE is 0)" in said(bench.commands)[-1]
    bench.extra.append(Settings())
    bench.until(lambda: bench.core.state is State.WATCHING)


def test_a_law_keeps_its_numbers_until_the_flight_is_over(make_bench):
    bench = flying(make_bench)
    law = bench.core.plan.course.law
    bench.extra.append(Settings(max_speed_mps=3.5, conflict_radius_m=9.0))
    commands = bench.step(100)
    assert "DMUCA: DMUCA_RADIUS 9, was 5; applies from the next path" in said(commands)
    assert bench.core.in_control
    assert bench.core.plan.course.law is law
    assert bench.core.config.limits.max_speed_mps == 5.0
    bench.landed, bench.armed = Landed.ON_GROUND, False
    bench.step(2)
    assert bench.core.config.limits.max_speed_mps == 3.5
    assert bench.core.plan.terms.limits.max_speed_mps == 3.5
    assert bench.core.config.avoidance.conflict_radius_m == 9.0


def test_a_replay_meets_the_same_settings(make_bench):
    bench = make_bench()
    header = event_record.Header(aircraft="OWN", software="", config=bench.core.config)
    steps = []
    plain = bench.core.step

    def step(now_s, events):
        commands = plain(now_s, events)
        steps.append(event_record.Step(now_s=now_s, events=tuple(events), commands=tuple(commands)))
        return commands

    bench.core.step = step
    bench.extra.append(Settings(max_speed_mps=3.5))
    bench.step(200)
    bench.extra.append(OFF)
    bench.step(50)
    decoder = msgspec.msgpack.Decoder(event_record.Record)
    read = [decoder.decode(msgspec.msgpack.encode(r)) for r in (header, *steps)]
    assert replay.replay_record(read, "x", 0.0).differences == 0
    without = [
        msgspec.structs.replace(s, events=tuple(e for e in s.events if not isinstance(e, Settings)))
        for s in read[1:]
    ]
    assert replay.replay_record([read[0], *without], "x", 0.0).differences > 0


def test_settings_count_from_the_first_step(make_config):
    core = Companion(make_config())
    core.step(0.0, [Settings(horizon_s=33.0)])
    assert core.config.avoidance.horizon_s == 33.0
