"""The floor of a region's law: over random policies, radios that fail, and loops that come late."""

from __future__ import annotations

from pathlib import Path
from random import Random

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.broadcast.broadcaster import Broadcaster
from companion.broadcast.legal_floor import keep_floor, too_slow, whole_rates
from companion.config import Config, IdentityConfig, RemoteIdConfig
from companion.events import (
    Broadcast,
    BroadcastChanged,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    RadioState,
    VehicleTime,
)
from companion.ownship import Ownship
from companion.remote_id.messages import BasicId, Location, OperatorId, SelfId, Status, System
from companion.remote_id.region import Region
from companion.toml_reader import decode_toml

FOLDER = Path(__file__).parents[3] / "config/regions"
REGIONS = {path.stem: decode_toml(path, Region) for path in sorted(FOLDER.glob("*.toml"))}
LAWFUL = [region for region in REGIONS.values() if region.transport_sets]
ALL = ("ble4", "ble5", "nan", "wifi")
UTC_S = 1_767_225_600.0
SLACK_S = 1e-6

# What the law says, written down a second time, from the texts and not from the profiles.
LEGAL_SETS = {
    "us": [{"wifi"}, {"ble4", "ble5"}],
    "eu": [{"wifi"}, {"ble5"}, {"nan"}],
    "jp": [{"wifi"}, {"ble5"}, {"nan"}],
}
IDENTITY_PERIOD_S = {"us": 1.0, "eu": 3.0, "jp": 1.0}


def config_of(region: Region, **remote_id: object) -> Config:
    return Config(
        identity=IdentityConfig(uas_id="1596B0000DMUCA01"),
        remote_id=RemoteIdConfig(self_id="TEST", operator_id="FIN87astrdge12k8-xyz", **remote_id),
        region=region,
    )


class Aircraft:
    """An own aircraft in flight, stepped at any times; keeps what went out."""

    def __init__(self, config: Config) -> None:
        self.broadcaster = Broadcaster(config)
        self.own = Ownship()
        self.now_s = 0.0
        self.landed = Landed.IN_AIR
        self.gnss: GnssFix | None = GnssFix(
            fix_type=3, lat_deg=47.0, lon_deg=8.0, alt_msl_m=450.0, alt_ellipsoid_m=497.0
        )
        self.sent: list[tuple[float, Broadcast]] = []
        self.changes: list[BroadcastChanged] = []
        self.said: list[object] = []

    def step(self, gap_s: float, *, position: bool = True) -> None:
        self.now_s += gap_s
        now_s = self.now_s
        for event in (
            Heartbeat(
                system_id=1,
                firmware=Firmware.PX4,
                vehicle_type=2,
                custom_mode=3,
                mode=FlightMode.MISSION,
                armed=True,
            ),
            LandedState(landed=self.landed),
            VehicleTime(time_boot_s=now_s + 100.0, utc_s=UTC_S + now_s),
            *((self.gnss,) if self.gnss is not None else ()),
        ):
            self.own.observe(event, now_s)
        if position:
            self.own.observe(
                GlobalPosition(
                    time_boot_s=now_s + 100.0,
                    lat_deg=47.0,
                    lon_deg=8.0,
                    alt_msl_m=450.0,
                    height_above_home_m=50.0,
                    velocity_ned_mps=(0.0, 0.0, 0.0),
                ),
                now_s,
            )
        for command in self.broadcaster.step(self.own, now_s):
            if isinstance(command, Broadcast):
                self.sent.append((now_s, command))
            elif isinstance(command, BroadcastChanged):
                self.changes.append(command)
            else:
                self.said.append(command)

    def radio(self, can_send: tuple[str, ...], **more: object) -> None:
        state = RadioState(can_send=tuple(sorted(can_send)), **more)
        self.broadcaster.observe(state, self.now_s)


class Judge:
    """Follows what goes out and says when no legal set of transports has told enough."""

    def __init__(self, region: Region, channel: int = 6) -> None:
        self.region = region
        self.beacon_s = 1.0 if channel in (6, 149) else 0.2
        self.last: dict[tuple[str, type], float] = {}

    def take(self, sent: list[tuple[float, Broadcast]]) -> None:
        for now_s, broadcast in sent:
            self.last |= {(broadcast.transport, type(m)): now_s for m in broadcast.messages}

    def legal(self, now_s: float) -> bool:
        identity_s = IDENTITY_PERIOD_S[self.region.name]
        periods = {BasicId: identity_s, System: identity_s, SelfId: 3.0, OperatorId: 3.0}

        def told(transport: str) -> bool:
            limits = {Location: self.beacon_s if transport == "wifi" else 1.0, **periods}
            return all(
                now_s - self.last.get((transport, kind), -99.0) <= limit_s + SLACK_S
                for kind, limit_s in limits.items()
            )

        return any(all(map(told, names)) for names in LEGAL_SETS[self.region.name])


def test_the_profiles_say_what_the_law_says():
    assert {region.name for region in LAWFUL} == LEGAL_SETS.keys()
    for region in LAWFUL:
        assert [set(names) for names in region.transport_sets] == LEGAL_SETS[region.name]
        assert region.location_period_s == 1.0
        assert region.basic_id_period_s == region.system_period_s == IDENTITY_PERIOD_S[region.name]
        assert region.other_period_s == 3.0


def policy_of(random: Random) -> dict[str, int]:
    return {t: random.choice((1, 1, 1, 2, 5, 10)) for t in ALL if random.random() < 0.4}


def radio_of(random: Random, region: Region) -> set[str]:
    """Whatever fails, some legal set stays: nothing can be kept without a radio."""
    return set(random.choice(LEGAL_SETS[region.name])) | {t for t in ALL if random.random() < 0.4}


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.integers(0, 2**32))
def test_no_policy_and_no_failing_radio_breaks_the_floor(seed):
    random = Random(seed)
    region, channel = random.choice(LAWFUL), random.choice((6, 149, 1, 44))
    # On a channel that asks for 5 Hz, a step of 0.2 s breaks the law whatever is scheduled.
    longest_s = 0.15 if channel in (6, 149) else 0.08
    changes = random.choice((0.0, 0.01, 0.1, 0.5))
    judge, aircraft = Judge(region, channel), Aircraft(config_of(region))
    radio = radio_of(random, region)
    aircraft.radio(tuple(radio), wifi_channel=channel)
    aircraft.broadcaster.ask(policy_of(random))
    aircraft.step(0.05)
    for _ in range(150):
        judge.take(aircraft.sent)
        aircraft.sent.clear()
        lost = random.random() < 0.3 * changes
        if lost:
            radio = radio_of(random, region)
            aircraft.radio(tuple(radio), wifi_channel=channel)
        if random.random() < changes:
            aircraft.broadcaster.ask(policy_of(random))
        aircraft.step(random.uniform(0.02, longest_s))
        # Just before the new messages go out, when the last ones are oldest. When the one legal transport is
        # lost, the next begins within this step, which is allowed to take its time.
        assert lost or judge.legal(aircraft.now_s)
        assert {b.transport for _, b in aircraft.sent} <= radio
        judge.take(aircraft.sent)
        assert judge.legal(aircraft.now_s)
        assert aircraft.broadcaster.trouble is None


@pytest.mark.parametrize("asked", [{"ble4": 10}, {"nan": 10}, {"wifi": 1}, {"ble5": 2}])
def test_the_judge_finds_what_would_go_out_without_a_law(asked):
    judge, aircraft = Judge(REGIONS["us"]), Aircraft(config_of(Region()))
    aircraft.radio(ALL)
    aircraft.broadcaster.ask(asked)
    verdicts = []
    for _ in range(200):
        aircraft.step(0.07)
        verdicts.append(judge.legal(aircraft.now_s))
        judge.take(aircraft.sent)
    assert not all(verdicts[30:])


@pytest.mark.parametrize("region", LAWFUL, ids=lambda r: r.name)
def test_a_switch_is_make_before_break(region):
    """Old and new are on the air together for a second; then only the new one is."""
    aircraft = Aircraft(config_of(region))
    aircraft.radio(ALL)
    aircraft.broadcaster.ask({"wifi": 2})
    for _ in range(100):
        aircraft.step(0.05)
    switched_s = aircraft.now_s
    aircraft.broadcaster.ask({"ble4": 2, "ble5": 2})
    for _ in range(100):
        aircraft.step(0.05)
    beacons = [t for t, b in aircraft.sent if b.transport == "wifi"]
    assert switched_s + 0.5 <= beacons[-1] <= switched_s + 1.1
    first = min(t for t, b in aircraft.sent if b.transport == "ble5")
    assert first == pytest.approx(switched_s + 0.05)


def test_the_rate_that_is_asked_is_the_rate_that_is_sent():
    for rate in range(1, 11):
        aircraft = Aircraft(config_of(Region()))
        aircraft.radio(ALL)
        aircraft.broadcaster.ask({"ble4": rate, "ble5": rate, "wifi": rate})
        for _ in range(2000):
            aircraft.step(0.01)
        for transport in ("ble4", "ble5", "wifi"):
            count = sum(
                b.transport == transport and any(isinstance(m, Location) for m in b.messages)
                for _, b in aircraft.sent
            )
            assert abs(count - 20 * rate) <= 1 + rate, (transport, rate, count)


def test_ble4_alone_is_joined_by_what_the_law_asks():
    region = REGIONS["us"]
    decided = keep_floor({"ble4": 5}, region, frozenset(ALL))
    assert decided.rates == {"ble4": 5, "ble5": 5}
    assert decided.legal
    assert "ble5" in decided.reason
    decided = keep_floor({"ble4": 5}, REGIONS["eu"], frozenset(("ble4", "nan")))
    assert decided.rates == {"ble4": 5, "nan": 5}


def test_a_radio_that_cannot_be_legal_does_not_begin_and_says_why():
    aircraft = Aircraft(config_of(REGIONS["us"], transports=("ble4",)))
    aircraft.landed = Landed.ON_GROUND
    aircraft.radio(("ble4", "nan"))
    for _ in range(60):
        aircraft.step(0.05)
    assert not aircraft.sent
    assert aircraft.changes[-1].legal is False
    assert "asks for wifi or ble4+ble5; the radio can send on ble4, nan" in aircraft.changes[-1].reason
    assert aircraft.broadcaster.trouble is not None


def test_a_radio_that_was_legal_only_before_the_vehicle_was_heard_has_not_begun():
    aircraft = Aircraft(config_of(REGIONS["us"], transports=("ble4", "ble5")))
    aircraft.radio(("ble4", "ble5"))
    aircraft.landed = Landed.ON_GROUND
    assert not aircraft.broadcaster.step(aircraft.own, 0.0)
    aircraft.radio(("ble4",))
    for _ in range(60):
        aircraft.step(0.05)
    assert not aircraft.sent


def test_after_a_restart_in_the_air_what_the_radios_can_still_send_is_sent():
    """Being seen by some is better than by none; the aircraft cannot be kept on the ground any more."""
    aircraft = Aircraft(config_of(REGIONS["us"], transports=("ble4", "ble5")))
    aircraft.radio(("ble4",))
    for _ in range(40):
        aircraft.step(0.05)
    assert {b.transport for _, b in aircraft.sent} == {"ble4"}
    statuses = {m.status for _, b in aircraft.sent for m in b.messages if isinstance(m, Location)}
    assert statuses == {Status.REMOTE_ID_SYSTEM_FAILURE}
    assert aircraft.changes[-1].legal is False
    assert any("not legal" in say.text for say in aircraft.said)


def test_a_policy_of_rates_that_cannot_be_is_kept_within_them():
    aircraft = Aircraft(config_of(REGIONS["us"]))
    aircraft.radio(ALL)
    aircraft.broadcaster.ask({"wifi": 0, "ble4": -1, "ble5": 1000})
    for _ in range(100):
        aircraft.step(0.05)
    packs = [t for t, b in aircraft.sent if b.transport == "ble5"]
    assert 45 <= len(packs) <= 52
    assert {b.transport for _, b in aircraft.sent} == {"ble4", "ble5"}


def test_a_radio_lost_in_flight_leaves_what_can_still_be_sent():
    aircraft = Aircraft(config_of(REGIONS["us"], transports=("ble4", "ble5")))
    aircraft.radio(("ble4", "ble5"))
    for _ in range(40):
        aircraft.step(0.05)
    aircraft.radio(("ble4",), text="controller lost its Coded PHY")
    aircraft.sent.clear()
    for _ in range(40):
        aircraft.step(0.05)
    assert {b.transport for _, b in aircraft.sent} == {"ble4"}
    statuses = {m.status for _, b in aircraft.sent for m in b.messages if isinstance(m, Location)}
    assert statuses == {Status.REMOTE_ID_SYSTEM_FAILURE}
    assert "not legal" in aircraft.said[-1].text
    aircraft.radio(("ble4", "ble5"))
    for _ in range(101):
        aircraft.step(0.05)
    assert "works again" in aircraft.said[-1].text


def test_the_secret_part_of_an_operator_id_never_goes_out():
    aircraft = Aircraft(config_of(REGIONS["eu"]))
    aircraft.radio(ALL)
    aircraft.step(0.05)
    sent = {m.operator_id for _, b in aircraft.sent for m in b.messages if isinstance(m, OperatorId)}
    assert sent == {"FIN87astrdge12k8"}


def test_an_old_position_is_not_sent_as_the_present_one():
    aircraft = Aircraft(config_of(REGIONS["eu"]))
    aircraft.radio(ALL)
    for _ in range(20):
        aircraft.step(0.05)
    lost_s = aircraft.now_s
    aircraft.sent.clear()
    for _ in range(60):
        aircraft.step(0.05, position=False)
    for t, broadcast in aircraft.sent:
        location = next(m for m in broadcast.messages if isinstance(m, Location))
        assert (location.lat_deg is None) == (t - lost_s > 1.0)


def test_the_accuracies_of_a_receiver_that_fell_silent_are_not_told():
    """The autopilot goes on by its other sensors for a while; how well is not known."""
    aircraft = Aircraft(config_of(REGIONS["eu"]))
    aircraft.radio(ALL)
    aircraft.gnss = msgspec.structs.replace(aircraft.gnss, horizontal_accuracy_m=1.0)
    aircraft.step(0.05)
    aircraft.gnss = None
    told = []
    for _ in range(100):
        aircraft.step(0.05)
        told += [
            (aircraft.now_s, m.lat_deg, m.horizontal_accuracy_m)
            for m in aircraft.sent[-1][1].messages
            if isinstance(m, Location)
        ]
    assert {lat_deg for _, lat_deg, _ in told} == {47.0}
    assert {accuracy for t, _, accuracy in told if t < 2.0} == {1.0}
    assert {accuracy for t, _, accuracy in told if t > 4.0} == {None}


def test_a_loop_too_slow_for_the_beacons_of_a_channel_is_told():
    """At 5 Hz a beacon leaves every 0.2 s and what the loop is late, which is too late on channel 1."""
    judge, aircraft = Judge(REGIONS["us"], 1), Aircraft(config_of(REGIONS["us"]))
    aircraft.radio(("wifi",), wifi_channel=1)
    aircraft.step(0.2)
    verdicts = []
    for number in range(50):
        judge.take(aircraft.sent)
        aircraft.step(0.21 if number % 2 else 0.19)
        verdicts.append(judge.legal(aircraft.now_s))
    assert not all(verdicts)
    text = too_slow({"wifi": 1}, REGIONS["us"], 1, 5.0)
    assert text is not None
    assert "wifi on channel 1 every 0.2 s: flight.setpoint_rate_hz 5 is too slow; at least 6.25" in text
    assert too_slow({"wifi": 1}, REGIONS["us"], 1, 6.5) is None
    assert too_slow({"wifi": 1, "ble5": 1}, REGIONS["eu"], 6, 5.0) is None
    assert too_slow({"wifi": 1}, Region(), 1, 5.0) is None


def test_two_identities_where_the_state_gives_a_number():
    config = config_of(REGIONS["jp"])
    identity = msgspec.structs.replace(config.identity, registration_id="JU0123456789")
    aircraft = Aircraft(msgspec.structs.replace(config, identity=identity))
    aircraft.radio(ALL)
    aircraft.step(0.05)
    sent = [m.uas_id for m in aircraft.sent[0][1].messages if isinstance(m, BasicId)]
    assert sent == ["1596B0000DMUCA01", "JU0123456789"]


def test_a_radio_that_repeats_by_itself_is_set_to_whole_messages_above_the_floor():
    rates = {"ble4": 1, "wifi": 3}
    assert whole_rates(rates, REGIONS["us"], 6) == {"ble4": 2, "wifi": 3}
    assert whole_rates(rates, REGIONS["us"], 11) == {"ble4": 2, "wifi": 7}
    assert whole_rates(rates, Region(), 11) == rates
