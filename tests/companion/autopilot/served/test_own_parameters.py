"""Parameters of our own, over bytes: who is answered, with what, how fast."""

from __future__ import annotations

import itertools
import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adjustable_parameters import NAMES
from companion.autopilot.link import AutopilotLink
from companion.autopilot.served.own_parameters import PERIOD_S, OwnParameters
from companion.autopilot.signing import Signing
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.config import Config, IdentityConfig, VehicleConfig
from companion.events import Settings
from companion.radio.ether.section import EtherRadio

CONFIG = Config(identity=IdentityConfig(uas_id="OWN"), radio=(EtherRadio(address="127.0.0.1:1"),))
KEY = bytes(range(32))


class Station:
    """A ground station, and the vehicle that passes on what it says."""

    def __init__(self, signing: Signing | None = None) -> None:
        self.parameters = OwnParameters(CONFIG, Settings())
        self.link = AutopilotLink(VehicleConfig(), signing=signing, settings=self.parameters)
        self.now_s = 0.0
        self._reader = MavlinkReader()
        self._writers = {}
        self.peer = Signing(KEY, 1_000_000, 0.0) if signing else None
        self.says(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), 1, 1)
        self.run(1.0)

    def says(self, message, system=255, component=190, signed=True):
        writer = self._writers.setdefault((system, component), MavlinkWriter(system, component))
        frame = writer.pack(message)
        if self.peer is not None and signed:
            frame = self.peer.sign(frame)
        self.link.receive(frame, self.now_s)

    def run(self, seconds=2.0, step_s=0.05):
        """Let time pass; returns what we said about parameters and texts, with its time, and the events."""
        heard, events = [], []
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            events += self.link.advance(self.now_s)
            told = self._reader.feed(self.link.drain())
            heard += [(self.now_s, m) for m in told if m.get_type() in ("PARAM_VALUE", "STATUSTEXT")]
        return heard, [e for e in events if isinstance(e, Settings)]

    def set(self, name, value, kind=9, system=1, component=191, **sender):
        self.says(mavlink.MAVLink_param_set_message(system, component, name, value, kind), **sender)

    def list(self, system=1, component=0, **sender):
        self.says(mavlink.MAVLink_param_request_list_message(system, component), **sender)

    def read(self, name=b"", index=-1, component=191):
        self.says(mavlink.MAVLink_param_request_read_message(1, component, name, index))


def values(heard):
    return [(m.param_id, m.param_value) for _, m in heard if m.get_type() == "PARAM_VALUE"]


def texts(heard):
    return [m.text for _, m in heard if m.get_type() == "STATUSTEXT"]


@pytest.mark.parametrize("component", [0, 191])
def test_a_list_is_told_whole_and_slowly(component):
    station = Station()
    station.list(component=component)
    heard, events = station.run()
    assert [m.param_index for _, m in heard] == list(range(len(NAMES)))
    assert values(heard) == list(zip(NAMES, (1.0, 5.0, 20.0, 5.0), strict=True))
    assert {(m.param_count, m.param_type) for _, m in heard} == {(len(NAMES), 9)}
    assert {(m.get_srcSystem(), m.get_srcComponent()) for _, m in heard} == {(1, 191)}
    times = [t for t, _ in heard]
    assert all(b - a >= PERIOD_S - 1e-6 for a, b in itertools.pairwise(times))
    assert not events


def test_one_is_read_by_name_or_index_and_unknown_ones_are_met_with_silence():
    station = Station()
    station.read(b"DMUCA_HORIZON")
    station.read(index=1)
    for name in (b"_HASH_CHECK", b"dmuca_enable", b"DMUCA_ENABLE_AND", b"\xff" * 16):
        station.read(name)
    station.read(index=len(NAMES))
    station.set(b"WP_SPD", 3.0)
    heard, _ = station.run()
    assert values(heard) == [("DMUCA_HORIZON", 20.0), ("DMUCA_RADIUS", 5.0)]


def test_a_change_is_an_event_and_is_answered_with_itself():
    station = Station()
    station.set(b"DMUCA_RADIUS", 8.5)
    heard, events = station.run()
    assert values(heard) == [("DMUCA_RADIUS", 8.5)]
    assert events == [Settings(conflict_radius_m=8.5)]
    assert station.parameters.settings == events[0]
    station.set(b"DMUCA_RADIUS", 8.5)
    heard, events = station.run()
    assert values(heard) == [("DMUCA_RADIUS", 8.5)]
    assert not events


@pytest.mark.parametrize(("value", "kind"), [(500.0, 9), (float("nan"), 9), (8.0, 6)])
def test_a_refused_value_is_answered_with_the_old_one_and_the_reason_once(value, kind):
    station = Station()
    for time in range(4):
        station.set(b"DMUCA_RADIUS", value, kind)
        heard, events = station.run(0.5)
        assert values(heard) == [("DMUCA_RADIUS", 5.0)]
        assert not events
        said = "".join(texts(heard))
        assert (("DMUCA: DMUCA_RADIUS: " in said) and ("allowed: " in said)) == (time == 0)
    assert station.link.counts.settings_refused == 4


def test_who_is_not_asked_does_not_answer():
    station = Station()
    station.list(system=2)
    station.list(component=1)
    station.read(b"DMUCA_RADIUS", component=0)
    station.set(b"DMUCA_ENABLE", 0.0, component=1)
    station.set(b"DMUCA_ENABLE", 0.0, component=0)
    station.set(b"DMUCA_ENABLE", 0.0, system=0)
    assert station.link.counts.foreign == 6
    heard, events = station.run()
    assert not heard
    assert not events


def test_our_own_vehicles_components_are_no_ground_station():
    station = Station()
    station.set(b"DMUCA_ENABLE", 0.0, system=1)
    assert station.run()[1] == [Settings(enable=False)]
    for component in (1, 154, 191):
        station.says(mavlink.MAVLink_param_set_message(1, 191, b"DMUCA_ENABLE", 1.0, 9), 1, component)
    assert station.run() == ([], [])


def test_nothing_else_of_a_ground_station_is_let_through():
    station = Station()
    before = station.link.counts.settings_requests
    for message in (
        mavlink.MAVLink_command_long_message(1, 191, 400, 0, 1, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_param_value_message(b"WP_SPD", 9.0, 9, 1, 0),
        mavlink.MAVLink_statustext_message(6, b"hello"),
    ):
        station.says(message)
    assert station.link.counts.settings_requests == before
    assert station.link.counts.foreign == 3


def test_a_flood_is_answered_no_faster():
    station = Station()
    dice = random.Random(1)
    heard = []
    for _ in range(100):
        for _ in range(50):
            station.set(dice.choice(NAMES).encode(), dice.uniform(-10.0, 70.0))
            station.list()
            station.read(index=dice.randrange(-5, 10))
        heard += station.run(0.05)[0]
    assert 0 < len(values(heard)) <= 5.0 / PERIOD_S + 1


def test_before_the_vehicle_is_known_nobody_is_answered():
    parameters = OwnParameters(CONFIG, Settings())
    link = AutopilotLink(VehicleConfig(), settings=parameters)
    message = mavlink.MAVLink_param_set_message(1, 191, b"DMUCA_ENABLE", 0.0, 9)
    link.receive(MavlinkWriter(255, 190).pack(message), 0.0)
    link.advance(1.0)
    assert parameters.settings == Settings()
    assert link.counts.foreign == 1


def test_on_a_signed_link_an_unsigned_set_is_dropped():
    station = Station(Signing(KEY, 1_000_000, 0.0))
    station.set(b"DMUCA_ENABLE", 0.0, signed=False)
    assert station.run() == ([], [])
    station.set(b"DMUCA_ENABLE", 0.0)
    heard, events = station.run()
    assert values(heard) == [("DMUCA_ENABLE", 0.0)]
    assert events == [Settings(enable=False)]
