"""A conformance kit for plug-ins: classes of tests that a third party subclasses and runs with pytest.

    from dmuca.testing import LawConformance

    class TestMine(LawConformance):
        name = "mine"          # the entry point, of the installed distribution

Each `test_...` method can also be called directly. It raises AssertionError, or `unittest.SkipTest` if the
subclass provides nothing to test with. docs/plug-ins.md describes what plug-ins may and must do.
"""

from __future__ import annotations

import contextlib
import math
import unittest
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from companion import plugins
from companion.atmc.choice import Choice
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.plugin_policy import PluginPolicy
from companion.autopilot.dialect import DIALECTS, FIRMWARES, check_dialect, use
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED, Dialect
from companion.avoidance.law import Neighbour, Situation
from companion.avoidance.plugin_law import PluginLaw
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig, TrafficConfig
from companion.errors import ConfigError
from companion.events import FlightMode, RemoteIdHeard
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender, radio_address
from companion.radio.plugin.plugin_radio import GuardedRadio, open_radio
from companion.radio.plugin.section import PluginRadio
from companion.radio.radio import ByteLink, RadioContext
from companion.remote_id.codec import decode, encode
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

__all__ = ["FirmwareConformance", "LawConformance", "PolicyConformance", "RadioConformance"]

_PERIOD_S = 0.2
_LAG_S = 0.5
_MOST = TrafficConfig().max_tracks
_PATH = Trajectory([0.0, 100.0], [(0.0, 0.0, -50.0), (400.0, 0.0, -50.0)])


class LawConformance:
    """Tests of a plug-in of `dmuca.laws`."""

    name: ClassVar[str]
    """Name of the plug-in's entry point."""
    least_m: ClassVar[float] = 10.0
    """Distance that the law must keep from an aircraft that hovers on its path, m; by default the
    separation."""

    def law(self) -> PluginLaw:
        """A new law on a straight path to the north, 50 m up, at 4 m/s."""
        return PluginLaw(AvoidanceConfig(law=self.name), LimitsConfig(), _PATH)

    def test_it_answers_any_situation(self) -> None:
        """The law must not fail, whatever the number, kind and behaviour of the neighbours."""
        law, rng = self.law(), np.random.default_rng(1)
        for step in range(300):
            found = law.decide(_situation(rng, step, _number(rng, step)))
            assert law.fault is None, law.fault
            assert all(map(math.isfinite, found.chosen_ned_mps))

    def test_the_same_situations_give_the_same_answers(self) -> None:
        """Replays depend on this, also where several aircraft fly in one process."""
        alone, law, other = self.law(), self.law(), self.law()
        steps = [_situation(np.random.default_rng(step), step, 5) for step in range(100)]
        answers = [alone.decide(situation).chosen_ned_mps for situation in steps]
        rng = np.random.default_rng(2)
        for step, (situation, answer) in enumerate(zip(steps, answers, strict=True)):
            other.decide(_situation(rng, step, 5))
            assert law.decide(situation).chosen_ned_mps == answer, "another law object changes its answers"
        assert alone.fault is None, alone.fault

    def test_it_arrives_where_nobody_is_in_the_way(self) -> None:
        """At the end of a path without traffic, the aircraft is within 5 m of the path's end."""
        places = self._fly(())
        assert float(np.linalg.norm(places[-1] - np.array(_PATH.position(100.0)))) < 5.0

    def test_it_keeps_clear_of_an_aircraft_that_hovers_on_its_path(self) -> None:
        """The aircraft stays at least `least_m` away from the hovering one."""
        place = 150.0, 0.0, -50.0
        other = Neighbour(
            track_id="A", position_ned_m=place, velocity_ned_mps=(0.0, 0.0, 0.0), age_s=0.0, sigma_m=1.0
        )
        least = float(np.linalg.norm(self._fly((other,)) - np.array(place), axis=1).min())
        assert least > self.least_m, f"it came within {least:.1f} m"

    def _fly(self, neighbours: tuple[Neighbour, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
        """True positions of a point mass that follows commands with a lag, one for each decision."""
        law, places = self.law(), []
        place, velocity = np.array(_PATH.position(0.0)), np.array([4.0, 0.0, 0.0])
        for step in range(round(120.0 / _PERIOD_S)):
            now_s = step * _PERIOD_S
            n, e, d = place.tolist()
            vn, ve, vd = velocity.tolist()
            found = law.decide(Situation(now_s, now_s, (n, e, d), (vn, ve, vd), 1.0, neighbours))
            assert law.fault is None, law.fault
            velocity = velocity + (np.array(found.chosen_ned_mps) - velocity) * (_PERIOD_S / _LAG_S)
            place = place + velocity * _PERIOD_S
            places.append(place)
        return np.array(places)


class PolicyConformance:
    """Tests of a plug-in of `dmuca.policies`."""

    name: ClassVar[str]
    """Name of the plug-in's entry point."""

    def policy(self) -> PluginPolicy:
        """A new policy."""
        return PluginPolicy(plugins.load(plugins.POLICIES, self.name))

    def test_it_chooses_an_allowed_action_whatever_it_sees(self) -> None:
        """This holds for any number of neighbours, and any set of allowed actions that is not empty."""
        policy, rng = self.policy(), np.random.default_rng(1)
        for step in range(500):
            answer = policy.choose(*_observation(rng, len(policy.actions), _number(rng, step)))
            assert isinstance(answer, Choice), answer

    def test_if_one_action_is_allowed_it_chooses_that_one(self) -> None:
        """This holds even if the policy prefers to keep the action in use."""
        policy, rng = self.policy(), np.random.default_rng(2)
        for index in range(len(policy.actions)):
            own, rows, allowed, current = _observation(rng, len(policy.actions))
            allowed[:] = False
            allowed[index] = True
            assert policy.choose(own, rows, allowed, current) == Choice(index, policy.actions[index])

    def test_the_same_observations_give_the_same_choices(self) -> None:
        """Replays depend on this, also where several aircraft fly in one process."""
        alone, policy, other = self.policy(), self.policy(), self.policy()
        actions, rng = len(alone.actions), np.random.default_rng(3)
        seen = [_observation(rng, actions) for _ in range(100)]
        answers = [alone.choose(*observation) for observation in seen]
        for observation, answer in zip(seen, answers, strict=True):
            other.choose(*_observation(rng, actions))
            assert policy.choose(*observation) == answer, "another policy object changes its answers"


class _NoLink:
    """A link without anything at its other end."""

    def wait(self, timeout_s: float) -> None:
        """Do not wait."""

    def receive(self, now_s: float) -> bytes:
        """Return nothing."""
        return b""

    def send(self, data: bytes) -> None:
        """Discard the bytes."""

    def close(self) -> None:
        """Do nothing."""


class RadioConformance:
    """Tests of a plug-in of `dmuca.radios`."""

    name: ClassVar[str]
    """Name of the plug-in's entry point."""

    def options(self) -> Mapping[str, Any]:
        """Options with which the radio opens on this machine."""
        return {}

    def bad_options(self) -> Mapping[str, Any]:
        """Options that the radio must refuse with a ConfigError."""
        return {"no_such_option": 1}

    def link(self, _address: str) -> ByteLink:
        """The link that `RadioContext.open_link` opens."""
        return _NoLink()

    def feed(self, radio: Any, transport: str, frame: bytes) -> None:
        """Let the radio that the plug-in made receive a frame, which may be damaged."""
        raise unittest.SkipTest("RadioConformance.feed is not overridden: reception is not tested")

    def sent(self, radio: Any) -> Iterable[tuple[str, bytes]]:
        """Transport and bytes of each frame that the radio has put on the air since the last call."""
        raise unittest.SkipTest("RadioConformance.sent is not overridden: what is sent is not tested")

    def open(self, options: Mapping[str, Any] | None = None) -> GuardedRadio:
        """A new radio, as a flight opens it."""
        context = RadioContext("KIT", lambda: 0.0, self.link)
        return open_radio(
            PluginRadio(name=self.name, options=dict(self.options() if options is None else options)), context
        )

    def test_it_says_what_it_can(self) -> None:
        """Transports are known, addresses have the required form, and the state is readable."""
        with self._opened() as radio:
            assert radio.capabilities | radio.hears, "it neither sends nor hears"
            assert radio.capabilities | radio.hears <= TRANSPORTS
            assert radio.made.health(0.0).can_send <= radio.capabilities, "it can send more than it has"
            for address in radio.own_addresses:
                octets = address.split(":")
                assert address == address.lower(), address
                assert list(map(len, octets)) == [2] * 6, address
            self._sound(radio)

    def test_options_that_it_does_not_know_are_refused(self) -> None:
        """A misspelt key must not be ignored."""
        refused = None
        try:
            self.open(self.bad_options()).close()
        except ConfigError as error:
            refused = str(error)
        assert refused is not None, "it opened with bad_options()"
        assert refused.startswith("radio.options: "), f"it raised something else than ConfigError: {refused}"

    def test_it_sends_on_each_of_its_transports(self) -> None:
        """Sent frames are counted, sending raises nothing, and the radio does not hear itself."""
        with self._opened() as radio:
            rates = dict.fromkeys(sorted(radio.capabilities), 1)
            radio.configure(rates, probe=True)
            radio.configure(rates)
            for transport in rates:
                before = radio.health(0.0).frames_sent
                radio.broadcast(transport, _messages(), 0.0)
                self._sound(radio)
                assert radio.health(0.0).frames_sent > before, f"{transport}: nothing was sent"
                heard = {event.address for event in radio.heard(0.0)}
                assert not heard & radio.own_addresses, f"{transport}: it hears itself"

    def test_what_it_sends_are_the_messages(self) -> None:
        """A receiver reads each message from the frames, on the transport that was asked for."""
        with self._opened() as radio:
            for transport in sorted(radio.capabilities):
                radio.broadcast(transport, _messages(), 0.0)
                frames = list(self.sent(radio.made))
                assert {name for name, _ in frames} == {transport}
                events = _received(transport, [frame for _, frame in frames])
                assert [m for event in events for m in event.messages] == list(_messages()), transport

    def test_a_transport_that_it_does_not_have_is_refused(self) -> None:
        """The radio raises ValueError, as `Radio` requires."""
        with self._opened() as radio:
            for transport in (*sorted(TRANSPORTS - radio.capabilities), "pigeon"):
                try:
                    radio.broadcast(transport, _messages(), 0.0)
                except ValueError:
                    continue
                raise AssertionError(f"{transport}: no ValueError")

    def test_it_hears_what_was_sent(self) -> None:
        """Each message of each frame arrives unchanged, on each transport that the radio receives, with the
        frame's counter, if the radio reports counters, and the transmitter that a Wi-Fi frame names."""
        address = radio_address("OTHER")
        with self._opened() as radio:
            for transport in sorted(radio.hears):
                sender = FrameSender(address)
                sender.frames(transport, _messages()[1:2])  # its counters no longer begin at 0
                frames = sender.frames(transport, _messages())
                for frame in frames:
                    self.feed(radio.made, transport, frame)
                heard = radio.heard(0.0)
                self._sound(radio)
                assert [m for event in heard for m in event.messages] == list(_messages()), transport
                assert {event.transport for event in heard} == {transport}
                for event, wanted in zip(heard, _received(transport, frames), strict=True):
                    assert event.counter in (None, wanted.counter), f"{transport}: a wrong counter"
                    assert event.address == wanted.address or not wanted.address, (
                        f"{transport}: a wrong address"
                    )
                assert radio.heard(0.0) == [], "a frame is returned once"

    def test_damaged_frames_are_counted_and_never_raised(self) -> None:
        """The input is random bytes, and frames with flipped bits or cut-off ends."""
        rng = np.random.default_rng(4)
        with self._opened() as radio:
            for transport in sorted(radio.hears):
                for frame in FrameSender(radio_address("OTHER")).frames(transport, _messages()):
                    for _ in range(50):
                        damaged = bytearray(frame[: int(rng.integers(0, len(frame) + 1))])
                        for at in rng.integers(0, max(len(damaged), 1), 3) if damaged else ():
                            damaged[int(at)] ^= int(rng.integers(1, 256))
                        self.feed(radio.made, transport, bytes(damaged))
                        self.feed(radio.made, transport, rng.bytes(40))
                radio.heard(1.0)
                self._sound(radio)
            assert radio.health(1.0).bad_frames > 0, "damaged frames are not counted"

    def test_it_is_idle_without_an_error(self) -> None:
        """A flight polls the radio twenty times a second and may hear nobody for hours."""
        with self._opened() as radio:
            for step in range(200):
                radio.heard(0.05 * step)
                self._sound(radio)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[GuardedRadio]:
        radio = self.open()
        try:
            yield radio
        finally:
            radio.close()
        self._sound(radio)

    @staticmethod
    def _sound(radio: GuardedRadio) -> None:
        radio.health(0.0)
        assert radio.trouble is None, radio.trouble
        assert radio.left_out == 0, "it returned what is no frame of messages"


class FirmwareConformance:
    """Tests of a plug-in of `dmuca.firmwares`."""

    name: ClassVar[str]
    """Name of the plug-in's entry point."""

    def dialect(self) -> Dialect:
        """The plug-in's dialect, checked."""
        loaded = plugins.load(plugins.FIRMWARES, self.name).loaded
        check_dialect(loaded)
        assert isinstance(loaded, Dialect)
        return loaded

    def test_it_holds_together(self) -> None:
        """Each mode that is commanded is read back as the same mode, and parameters are known."""
        dialect = self.dialect()
        assert dialect.vehicle_types
        for mode, command in dialect.commands.items():
            assert dialect.mode(CUSTOM_MODE_ENABLED, command.custom_mode) is mode
            assert dialect.name(command.custom_mode) != f"mode {command.custom_mode}", "the mode has no name"
        for wanted in dialect.wanted:
            assert wanted.names, f"{wanted.field}: no parameter"
            assert wanted.lowest < wanted.highest, f"{wanted.field}: an empty range"

    def test_modes_that_a_pilot_flies_are_never_taken_from(self) -> None:
        """Modes flown by stick and unknown modes belong to the pilot."""
        assert not self.dialect().take_from & {FlightMode.STICKS, FlightMode.OTHER}

    def test_it_takes_the_place_of_its_firmware(self) -> None:
        """The dialect replaces the built-in one while it is in use, and no longer."""
        dialect = self.dialect()
        before = dict(DIALECTS)
        try:
            use(self.name)
            assert DIALECTS[dialect.firmware] is dialect
            assert FIRMWARES[dialect.autopilot] is dialect.firmware
        finally:
            use(None)
        assert before == DIALECTS


def _situation(rng: np.random.Generator, step: int, others: int) -> Situation:
    """A random situation. The neighbours may fly anywhere, even through the own aircraft."""

    def three(scale: float) -> tuple[float, float, float]:
        n, e, d = rng.normal(0.0, scale, 3).tolist()
        return n, e, d

    now_s = _PERIOD_S * step
    neighbours = tuple(
        Neighbour(
            track_id=f"N{number}",
            position_ned_m=three(float(rng.choice([0.0, 5.0, 200.0]))),
            velocity_ned_mps=three(10.0),
            age_s=float(rng.uniform(0.0, 14.0)),
            sigma_m=float(rng.uniform(0.0, 30.0)),
            vertical_known=bool(rng.random() < 0.9),
            crewed=bool(rng.random() < 0.1),
            adsb=bool(rng.random() < 0.1),
            silent=bool(rng.random() < 0.1),
            yields=bool(rng.random() < 0.1),
            share=float(rng.uniform(0.5, 1.0)),
            turn_rps=float(rng.normal(0.0, 0.1)),
        )
        for number in range(others)
    )
    floor, ceiling = (down if rng.random() < 0.5 else None for down in (30.0, -150.0))
    return Situation(now_s, now_s, three(100.0), three(3.0), 1.5, neighbours, floor, ceiling)


def _number(rng: np.random.Generator, step: int) -> int:
    """A number of neighbours, now and then as many as the table holds."""
    return _MOST if step % 50 == 0 else int(rng.integers(0, 60))


def _observation(rng: np.random.Generator, actions: int, others: int = 5) -> tuple[Any, Any, Any, int | None]:
    """A random own row and neighbour rows, the allowed actions, and the one in use."""
    rows = rng.uniform(0.0, 1.0, (others, len(NEIGHBOUR_COLUMNS)))
    allowed = rng.random(actions) < rng.uniform(0.1, 1.0)
    allowed[rng.integers(0, actions)] = True
    current = None if rng.random() < 0.2 else int(rng.integers(0, actions))
    return rng.uniform(-1.0, 1.0, len(OWN_COLUMNS)), rows, allowed, current


def _messages() -> tuple[Message, ...]:
    """Every message that an aircraft sends, as decoding returns it."""
    sent = (
        BasicId(
            id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="1596B0000DMUCA01"
        ),
        Location(
            status=Status.AIRBORNE,
            lat_deg=47.397,
            lon_deg=8.545,
            alt_geodetic_m=430.0,
            speed_mps=5.0,
            direction_deg=90.0,
        ),
        SelfId(description_type=0, text="survey"),
        System(operator_lat_deg=47.397, operator_lon_deg=8.546, timestamp_utc_s=1_767_225_600.0),
        OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
    )
    return tuple(decode(encode(message)) for message in sent)


def _received(transport: str, frames: Iterable[bytes]) -> list[RemoteIdHeard]:
    """What a receiver reads from frames; the address is "" where the frame holds none."""
    receiver = FrameReceiver()
    events = [receiver.receive(transport, "", frame) for frame in frames]
    return [event for event in events if event is not None]
