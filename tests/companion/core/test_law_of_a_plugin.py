"""A law of a plug-in in the core: it flies, and when it fails the vehicle is let go as after other faults."""

from __future__ import annotations

import msgspec
import pytest

from companion import replay
from companion.authority.table import State
from companion.config import AvoidanceConfig, LimitsConfig
from companion.core import Companion
from companion.errors import ConfigError
from companion.event_record import Header, Step
from companion.events import AuthorityChanged, Firmware, FlightMode, Landed, Say, SetMode, Threat
from tests.companion.conftest import Bench, mission
from tests.companion.core.conftest import intruder
from tests.companion.core.guarded.guarding import meet
from tests.support import plugged


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    """The laws of `plugged.LAWS`."""
    yield from plugged.installed(tmp_path, monkeypatch, "plugged_laws", plugged.laws)


@pytest.fixture
def flown_by(make_config):
    """Build a bench whose vehicle is held and flown by a law."""

    def build(law, firmware=Firmware.PX4):
        made = msgspec.structs.replace(make_config(), avoidance=AvoidanceConfig(law=law))
        # PX4 is taken from a hold, ArduPilot is not.
        mode = FlightMode.HOLD if firmware is Firmware.PX4 else FlightMode.EXTERNAL
        bench = Bench(Companion(made), firmware=firmware, mode=mode)
        bench.until(lambda: bench.core.state is State.GUARDING and bench.mode is FlightMode.EXTERNAL)
        return bench

    return build


def changes(bench):
    return [c for _, c in bench.log if isinstance(c, AuthorityChanged)]


def test_it_flies(flown_by):
    bench = flown_by("aside")
    bench.step(20)
    assert bench.core.state is State.GUARDING
    assert len(bench.setpoints()) == 1
    bench.extra.append(intruder(bench, bench.north_m + 40.0, 3.0))
    bench.step(60)
    assert bench.core.state is State.AVOIDING
    assert bench.setpoints()[0].velocity_ned_mps[1] > 1.0


@pytest.mark.parametrize("firmware", [Firmware.PX4, Firmware.ARDUPILOT])
def test_when_it_fails_nothing_is_commanded_and_the_pilot_is_told(flown_by, firmware):
    bench = flown_by("raises", firmware)
    bench.until(lambda: bench.core.state is State.FAULT)
    assert bench.setpoints() == []
    (changed,) = [c for c in changes(bench) if c.state == "fault"]
    assert changed.trigger == "unfit"
    assert (
        changed.reason
        == 'law "raises" (plugged_laws:Raises of plugged_laws 1.0) failed: RuntimeError: no idea'
    )
    assert any(isinstance(c, Say) and changed.reason in c.text for c in bench.commands)
    holds = [c for c in bench.commands if isinstance(c, SetMode) and c.mode is FlightMode.HOLD]
    assert len(holds) == (firmware is Firmware.ARDUPILOT), "ArduPilot would fly the last setpoint on"


def test_a_failed_law_is_not_asked_again_before_a_landing(flown_by):
    bench = flown_by("raises")
    bench.until(lambda: bench.core.state is State.FAULT)
    assert bench.setpoints(bench.step(400)) == []
    assert bench.core.state is State.FAULT
    bench.landed = Landed.ON_GROUND
    bench.until(lambda: bench.core.state is State.STANDBY)
    bench.landed = Landed.IN_AIR
    bench.until(lambda: bench.core.state is State.GUARDING)


def test_after_a_fault_the_pilot_is_still_told_of_other_aircraft(flown_by):
    bench = flown_by("raises")
    bench.until(lambda: bench.core.state is State.FAULT)
    bench.extra.append(intruder(bench, bench.north_m + 40.0, 3.0))
    assert any(isinstance(c, Threat) for c in bench.step(40))


def test_a_guarded_mission_goes_on_when_it_fails(make_config):
    made = msgspec.structs.replace(
        make_config(use="guard"), path=None, limits=LimitsConfig(), avoidance=AvoidanceConfig(law="raises")
    )
    bench = Bench(Companion(made), mission=mission(300.0, 900.0), mode=FlightMode.MISSION)
    bench.velocity_ned_mps = (3.0, 0.0, 0.0)
    bench.until(lambda: bench.core.state is State.WATCHING)
    bench.until(lambda: bench.core.state is State.STANDBY)
    assert "failed: RuntimeError: no idea" in changes(bench)[-1].reason
    meet(bench, seconds=5.0)
    assert bench.core.state is State.STANDBY
    assert bench.mode is FlightMode.MISSION
    assert "failed" in bench.core.waits_for(bench.now_s)
    assert bench.setpoints([c for _, c in bench.log]) == []


@pytest.mark.parametrize("law", ["aside", "raises"])
def test_a_recording_replays_bit_for_bit(make_config, law):
    made = msgspec.structs.replace(make_config(), avoidance=AvoidanceConfig(law=law))
    bench, records = Bench(Companion(made)), [Header(aircraft="A", software="test", config=made)]
    step = bench.core.step

    def recorded(now_s, events):
        commands = step(now_s, events)
        records.append(Step(now_s=now_s, events=tuple(events), commands=tuple(commands)))
        return commands

    bench.core.step = recorded
    for k in range(300):
        if k % 20 == 0:
            bench.extra.append(intruder(bench, 80.0 - 0.15 * k, 3.0))
        bench.step()
    result = replay.replay_record(records, "bench", 0.0)
    assert (result.steps, result.differences, result.inexact) == (300, 0, 0)


def test_a_recording_whose_law_is_not_installed_is_refused(make_config):
    made = msgspec.structs.replace(make_config(), avoidance=AvoidanceConfig(law="gone"))
    with pytest.raises(ConfigError, match="'gone' is unknown; allowed: dmuca, paper, none, aside"):
        replay.replay_record([Header(aircraft="A", software="test", config=made)], "bench", 0.0)
