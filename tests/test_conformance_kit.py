"""The kit of `dmuca.testing` finds plug-ins that break their contract, each by the test that is for it."""

from __future__ import annotations

import dataclasses

import msgspec
import pytest

from companion.atmc.actions import SET_ACTIONS
from companion.autopilot.dialects import ardupilot
from companion.errors import ConfigError
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender
from companion.radio.radio import Health
from companion.remote_id.messages import BasicId, Location
from dmuca import testing

# ---------------------------------------------------------------- laws


class GoodLaw:
    def __init__(self, avoidance):
        self.last = [0.0]

    def choose(self, situation, follow, limits):
        n, e, d = follow.wanted_ned_mps
        self.last[0] = n
        return self.last[0], e, d


class SharingLaw(GoodLaw):
    """All aircraft of the process share what it remembers."""

    shared = (0.0, 0.0)

    def choose(self, situation, follow, limits):
        before, SharingLaw.shared = SharingLaw.shared, follow.wanted_ned_mps[:2]
        return before[0] if situation.now_s > 0.0 else 0.0, 0.0, 0.0


class SmallLaw(GoodLaw):
    def choose(self, situation, follow, limits):
        return [follow.wanted_ned_mps][len(situation.neighbours) // 100]


class FloorLaw(GoodLaw):
    def choose(self, situation, follow, limits):
        assert situation.floor_down_m is None
        return follow.wanted_ned_mps


class KnowsNoAdsbLaw(GoodLaw):
    def choose(self, situation, follow, limits):
        assert not any(other.adsb for other in situation.neighbours)
        return follow.wanted_ned_mps


# ---------------------------------------------------------------- policies


class GoodPolicy:
    actions = SET_ACTIONS

    def choose(self, own_row, neighbour_rows, allowed, current):
        return int(allowed.argmax())


class SharingPolicy(GoodPolicy):
    last = (0,)

    def choose(self, own_row, neighbour_rows, allowed, current):
        (before,) = SharingPolicy.last
        SharingPolicy.last = (int(allowed.argmax()),)
        return before if allowed[before] else int(allowed.argmax())


class SmallPolicy(GoodPolicy):
    def choose(self, own_row, neighbour_rows, allowed, current):
        return [int(allowed.argmax())][len(neighbour_rows) // 100]


# ---------------------------------------------------------------- radios


class GoodRadio:
    """A radio whose air is a list."""

    capabilities = hears = TRANSPORTS
    can_send = TRANSPORTS
    wifi_channel = 6

    def __init__(self, options, context):
        if options:
            raise ConfigError(f"{sorted(options)[0]}: unknown key")
        self.own_addresses = frozenset({context.address})
        self.receiver, self.sender = FrameReceiver(), FrameSender(context.address)
        self.air, self.inbox, self.frames = [], [], 0

    def configure(self, rates, *, probe=False):
        return ()

    def broadcast(self, transport, messages, now_s):
        if transport not in self.capabilities:
            raise ValueError(transport)
        for frame in self.sender.frames(transport, messages):
            self.air.append((transport, frame))
            self.frames += 1

    def heard(self, now_s):
        got, self.inbox = self.inbox, []
        return [e for t, f in got if (e := self.receiver.receive(t, "", f)) is not None]

    def health(self, now_s):
        return Health(True, "well", self.frames, 0, self.receiver.bad, can_send=self.can_send)

    def close(self):
        pass


class ClaimingRadio(GoodRadio):
    capabilities = frozenset({"ble4"})


class FewMessagesRadio(GoodRadio):
    def broadcast(self, transport, messages, now_s):
        if any(not isinstance(m, BasicId | Location) for m in messages):
            raise ValueError("unknown message")
        super().broadcast(transport, messages, now_s)


class MuteRadio(GoodRadio):
    def broadcast(self, transport, messages, now_s):
        super().broadcast(transport, messages, now_s)
        self.air.clear()


class ShortRadio(GoodRadio):
    def broadcast(self, transport, messages, now_s):
        super().broadcast(transport, messages[:1], now_s)


class OwnEarsRadio(GoodRadio):
    def broadcast(self, transport, messages, now_s):
        super().broadcast(transport, messages, now_s)
        self.inbox += self.air[-1:]


class OneAddressRadio(GoodRadio):
    def heard(self, now_s):
        return [msgspec.structs.replace(e, address="00:00:00:00:00:00") for e in super().heard(now_s)]


class NoCounterRadio(GoodRadio):
    def heard(self, now_s):
        return [msgspec.structs.replace(e, counter=0) for e in super().heard(now_s)]


class HalfDeafRadio(GoodRadio):
    def heard(self, now_s):
        return [e for e in super().heard(now_s) if isinstance(e.messages[0], BasicId | Location)]


class NoneRadio(GoodRadio):
    def heard(self, now_s):
        before = self.receiver.bad
        return [*super().heard(now_s), *[None] * (self.receiver.bad - before)]


class Radio(testing.RadioConformance):
    def feed(self, radio, transport, frame):
        radio.inbox.append((transport, frame))

    def sent(self, radio):
        sent, radio.air = radio.air, []
        return sent


# ---------------------------------------------------------------- firmwares

GOOD_FIRMWARE = ardupilot.DIALECT
TEXT_FIRMWARE = dataclasses.replace(ardupilot.DIALECT, take_from=frozenset({"external"}))


def failing(kit, plugin):
    """Names of the tests of a kit that a plug-in of this file fails, without "test_"."""
    tests = type("Test", (kit,), {"name": f"{__name__}:{plugin}"})()
    failed = []
    for name in dir(tests):
        if name.startswith("test_"):
            try:
                getattr(tests, name)()
            except (AssertionError, ConfigError, ValueError):
                failed.append(name.removeprefix("test_"))
    return failed


@pytest.mark.parametrize(
    ("kit", "plugin", "test"),
    [
        (testing.LawConformance, "SharingLaw", "the_same_situations_give_the_same_answers"),
        (testing.LawConformance, "SmallLaw", "it_answers_any_situation"),
        (testing.LawConformance, "FloorLaw", "it_answers_any_situation"),
        (testing.LawConformance, "KnowsNoAdsbLaw", "it_answers_any_situation"),
        (testing.PolicyConformance, "SharingPolicy", "the_same_observations_give_the_same_choices"),
        (testing.PolicyConformance, "SmallPolicy", "it_chooses_an_allowed_action_whatever_it_sees"),
        (Radio, "ClaimingRadio", "it_says_what_it_can"),
        (Radio, "FewMessagesRadio", "it_sends_on_each_of_its_transports"),
        (Radio, "MuteRadio", "what_it_sends_are_the_messages"),
        (Radio, "ShortRadio", "what_it_sends_are_the_messages"),
        (Radio, "OwnEarsRadio", "it_sends_on_each_of_its_transports"),
        (Radio, "OneAddressRadio", "it_hears_what_was_sent"),
        (Radio, "NoCounterRadio", "it_hears_what_was_sent"),
        (Radio, "HalfDeafRadio", "it_hears_what_was_sent"),
        (Radio, "NoneRadio", "damaged_frames_are_counted_and_never_raised"),
        (testing.FirmwareConformance, "TEXT_FIRMWARE", "it_holds_together"),
    ],
)
def test_what_breaks_the_contract_fails(kit, plugin, test):
    assert test in failing(kit, plugin)


@pytest.mark.parametrize(
    ("kit", "plugin", "wanted"),
    [
        # It avoids nobody.
        (testing.LawConformance, "GoodLaw", ["it_keeps_clear_of_an_aircraft_that_hovers_on_its_path"]),
        (testing.PolicyConformance, "GoodPolicy", []),
        (Radio, "GoodRadio", []),
        (testing.FirmwareConformance, "GOOD_FIRMWARE", []),
    ],
)
def test_what_keeps_it_passes(kit, plugin, wanted):
    assert failing(kit, plugin) == wanted
