"""The vehicle's own Remote ID module: when it broadcasts instead of us, and what does not silence us."""

from __future__ import annotations

import pytest

from companion.events import Broadcast, RadioState, RemoteIdModule, Severity
from companion.remote_id.messages import BasicId, Location
from tests.companion.broadcast.on_air import configured, said, told


def report(bench, seconds=1.0, component_id=236, ready=True, text=""):
    """The module reports once a second; returns the commands of that time."""
    commands = []
    for _ in range(round(seconds)):
        bench.extra.append(RemoteIdModule(component_id=component_id, ready=ready, text=text))
        commands += bench.step(20)
    return commands


def locations(commands):
    return [m for c in commands for m in getattr(c, "messages", ()) if isinstance(m, Location)]


def grounded(bench):
    bench.armed = False
    return bench


def test_a_vehicle_with_its_own_module_is_not_doubled(bench):
    assert told(grounded(bench), Location)
    report(bench, 4.0)
    bench.armed = True
    assert not locations(report(bench, 10.0))
    assert bench.core.broadcaster.gives_way
    assert bench.core.broadcaster.trouble is None


def test_ble4_begins_with_its_name_again_after_the_module(bench):
    """Receivers may know the aircraft by the module's transmitter only."""
    bench.core.broadcaster.ask({"ble4": 5})
    bench.extra = [RadioState(can_send=("ble4",))]
    grounded(bench).step(100)
    report(bench, 4.0)
    assert bench.core.broadcaster.gives_way
    bench.step(80)
    sent = [c for c in bench.step(60) if isinstance(c, Broadcast)]
    assert not bench.core.broadcaster.gives_way
    located = [c for c in sent if any(isinstance(m, Location) for m in c.messages)]
    assert len(located) > 5
    assert all(any(isinstance(m, BasicId) for m in c.messages) for c in located)


@pytest.mark.parametrize("seconds", [1, 2, 3])
def test_a_report_or_two_do_not_silence_us(bench, seconds):
    """Also not for a moment: three seconds of reports are needed."""
    commands = report(grounded(bench), seconds) + bench.step(100)
    assert len(locations(commands)) >= seconds + 4
    assert not bench.core.broadcaster.gives_way


def test_reports_with_pauses_or_of_changing_components_do_not_silence_us(bench):
    grounded(bench)
    for number in range(20):
        report(bench, 1, component_id=236 + number % 2)
        assert not bench.core.broadcaster.gives_way
    bench.step(20)
    for _ in range(20):
        report(bench, 1)
        bench.step(40)
        assert not bench.core.broadcaster.gives_way


def test_in_flight_no_report_silences_us(bench):
    """Neither many of them, nor those that began on the ground and were too few there."""
    report(grounded(bench), 2)
    bench.armed = True
    commands = report(bench, 60, ready=False, text="forged")
    assert len(locations(commands)) >= 59
    assert not said(commands)
    assert not bench.core.broadcaster.gives_way


def test_forged_heartbeats_between_the_true_ones_do_not_make_it_look_grounded(bench):
    """In flight: disarmed just before each forged report, armed again at the next true heartbeat."""
    bench.step(20)
    commands = []
    for _ in range(20):
        bench.armed = True
        commands += bench.step(18)
        bench.armed = False
        commands += bench.step(1)
        bench.extra.append(RemoteIdModule(component_id=236, ready=True, text=""))
        commands += bench.step(1)
    assert len(locations(commands)) >= 19
    assert not bench.core.broadcaster.gives_way


def test_when_the_module_falls_silent_in_flight_we_broadcast(bench):
    report(grounded(bench), 5)
    bench.armed = True
    assert not locations(report(bench, 5))
    commands = bench.step(200)
    assert said(commands) == [
        (Severity.WARNING, "DMUCA: the vehicle's Remote ID module fell silent; broadcasting instead")
    ]
    first = next(number for number, command in enumerate(commands) if locations([command]))
    assert first > 0
    assert len(locations(commands)) >= 4
    # The module is back: two identities for the rest of the flight, rather than none.
    assert len(locations(report(bench, 20))) >= 19
    grounded(bench)
    report(bench, 5)
    assert not told(bench, Location, 1.0)


def test_another_component_does_not_keep_the_module_alive(bench):
    report(grounded(bench), 5)
    bench.armed = True
    commands = report(bench, 10, component_id=99)
    assert len(locations(commands)) >= 4


def test_a_companion_that_does_not_yield_is_silenced_by_no_report(bench):
    mine = grounded(configured(bench, yield_to_module=False))
    mine.step(20)
    assert len(locations(report(mine, 20))) >= 19
    assert not mine.core.broadcaster.gives_way


def test_a_module_that_is_not_ready_is_said(bench):
    commands = report(grounded(bench), 5, ready=False, text="missing operator location")
    assert said(commands) == [
        (Severity.WARNING, "DMUCA Remote ID module not ready: missing operator location")
    ]
