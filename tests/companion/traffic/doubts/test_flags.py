"""What is said of a sender, and what is not said of an honest one."""

from __future__ import annotations

import random

import pytest

from companion.remote_id.authentication import (
    AuthenticationData,
    split,
)
from companion.remote_id.messages import (
    IdType,
    Location,
    OperatorId,
    SelfId,
    Status,
    System,
)
from companion.traffic.plausibility import RULES, Doubts, Flag, Reports
from tests.companion.traffic.flights import (
    UTC_OFFSET_S,
    Listener,
    basic,
    circle,
    fly,
    location,
    seconds,
    stop_and_go,
    straight,
)

# ---------------------------------------------------------------- honest aircraft


@pytest.mark.parametrize("rate_hz", [1.0, 4.0, 10.0])
@pytest.mark.parametrize(
    "motion",
    [straight(), straight(0.0), straight(60.0), circle(20.0, 5.0), circle(8.0, 5.0), stop_and_go(20.0, 5.0)],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_an_honest_aircraft_is_not_doubted(motion, rate_hz, seed):
    """Hard turns, stops, and white noise of the declared accuracy on every value."""
    listener = Listener()
    fly(listener, motion, seconds(120, rate_hz=rate_hz), noise=random.Random(seed))
    assert listener.ever == set()
    assert len(listener.traffic.tracks) == 1
    assert listener.reports == []


@pytest.mark.parametrize("motion", [straight(), circle(20.0, 5.0), stop_and_go(20.0, 5.0)])
def test_loss_is_no_doubt(motion):
    """Half of all messages lost, and twice ten seconds in a row."""
    generator = random.Random(3)
    times = [t for t in seconds(120) if generator.random() > 0.5 and not (40 < t < 50 or 80 < t < 90)]
    listener = Listener()
    fly(listener, motion, times, noise=generator)
    assert listener.ever == set()


@pytest.mark.parametrize("motion", [straight(), circle(20.0, 5.0), stop_and_go(20.0, 5.0)])
def test_one_aircraft_on_three_transports_is_not_doubted(motion):
    """Other addresses on each, BLE addresses that rotate, other delays, messages out of order."""
    listener = Listener()
    generator = random.Random(5)
    frames = []
    for t in seconds(60):
        message = location(motion, t, generator)
        turn = int(t) // 20
        frames += [
            (t + 0.05, "wifi", "w", (basic(), message)),
            (t + 0.4, "ble5", f"b5-{turn}", (basic(), message)),
            (t + 0.7, "ble4", f"b4-{turn}", (message,)),
            (t + 0.75, "ble4", f"b4-{turn}", (basic(),)),
        ]
        half = location(motion, t + 0.5, generator)
        frames.append((t + 0.9, "ble4", f"b4-{turn}", (half,)))
    for now_s, transport, address, messages in sorted(frames, key=lambda f: f[0]):
        listener.hear(now_s, *messages, address=address, transport=transport)
        listener.traffic.expire(now_s)
    assert listener.ever == set()
    assert listener.traffic.counts.updates > 100
    assert listener.traffic.counts.split == 0


@pytest.mark.parametrize("clock_s", [0.3, -0.3])
def test_a_clock_three_tenths_off_is_no_doubt(clock_s):
    listener = Listener()
    fly(listener, straight(), seconds(30), clock_s=clock_s, delay_s=0.05)
    assert listener.ever == set()


# ---------------------------------------------------------------- duplicate identity


@pytest.mark.parametrize("address", ["a", "other"])
@pytest.mark.parametrize("rate_hz", [1.0, 5.0])
def test_one_identity_at_two_places(address, rate_hz):
    """Whether the copy has an address of its own or not, and however often each of the two sends."""
    listener = Listener()
    frames = [(t, 200.0, "a") for t in seconds(20)]
    frames += [(t, -900.0, address) for t in seconds(int(20 * rate_hz), 10.5, rate_hz)]
    for t, north, source in sorted(frames):
        fly(listener, straight(north_m=north), [t], address=source)
    assert len(listener.traffic.tracks) == 2
    for track in listener.traffic.tracks.values():
        assert track.flags == {Flag.DUPLICATE_IDENTITY}


def test_a_duplicate_that_leaves_is_forgiven():
    listener = Listener()
    for t in seconds(20):
        fly(listener, straight(), [t])
        fly(listener, straight(north_m=-900.0), [t + 0.5], address="copy")
    fly(listener, straight(), seconds(20, 30.0))
    assert Flag.DUPLICATE_IDENTITY not in listener.flags("X")
    texts = [r.text for r in listener.reports if r.track_id == "X"]
    assert texts == [RULES[Flag.DUPLICATE_IDENTITY].text, "no longer: " + RULES[Flag.DUPLICATE_IDENTITY].text]


def test_one_position_elsewhere_and_back_is_no_duplicate():
    listener = Listener()
    fly(listener, straight(), seconds(10))
    fly(listener, straight(north_m=900.0), [20.0])
    fly(listener, straight(), seconds(20, 21.0))
    assert Flag.DUPLICATE_IDENTITY not in listener.ever


def test_our_own_identity_elsewhere_is_a_duplicate():
    listener = Listener(own="X")
    for t in seconds(10):
        listener.traffic.note_own(t, (0.0, 0.0, -50.0), (0.0, 0.0, 0.0))
        fly(listener, straight(), [t])
    assert listener.flags("X") == {Flag.DUPLICATE_IDENTITY}


# ---------------------------------------------------------------- jump


def test_a_leap():
    listener = Listener()
    fly(listener, straight(), seconds(10))
    fly(listener, straight(north_m=900.0), seconds(2, 20.0))
    (new,) = [t for t in listener.traffic.tracks.values() if t.track_id != "X"]
    assert new.flags == frozenset(), "it may be a glitch"
    fly(listener, straight(north_m=900.0), [22.0])
    assert new.flags == {Flag.JUMP}
    fly(listener, straight(north_m=900.0), [23.0])
    fly(listener, straight(north_m=900.0), seconds(12, 24.0))
    assert new.flags == frozenset()


def test_leaps_at_every_message():
    listener = Listener()
    generator = random.Random(1)
    for t in seconds(20):
        fly(
            listener, straight(north_m=generator.uniform(-5e3, 5e3), east_m=generator.uniform(-5e3, 5e3)), [t]
        )
    assert Flag.JUMP in listener.ever


def test_two_senders_of_one_address_are_no_leap():
    listener = Listener()
    for t in seconds(20):
        fly(listener, straight(), [t])
        fly(listener, straight(north_m=900.0), [t + 0.5])
    assert Flag.JUMP not in listener.ever


def test_a_position_as_vague_as_declared_is_no_leap():
    """Accuracy 185 m: what hops within it neither leaps nor is in two places."""
    listener = Listener()
    generator = random.Random(2)
    for t in seconds(60):
        fly(
            listener,
            straight(north_m=generator.gauss(200.0, 75.0), east_m=generator.gauss(-300.0, 75.0)),
            [t],
            horizontal_accuracy_m=185.2,
        )
    assert listener.ever == set()


# ---------------------------------------------------------------- status


@pytest.mark.parametrize(
    ("status", "flag"),
    [(Status.EMERGENCY, Flag.EMERGENCY), (Status.REMOTE_ID_SYSTEM_FAILURE, Flag.REMOTE_ID_FAILURE)],
)
def test_status_of_the_sender(status, flag):
    listener = Listener()
    fly(listener, straight(), seconds(3))
    fly(listener, straight(), [13.0], status=status)
    assert listener.flags() == {flag}
    fly(listener, straight(), seconds(3, 14.0))
    assert listener.flags() == frozenset()
    listener.hear(17.0, basic(), Location(status=status, timestamp_s=17.0))
    assert listener.flags() == {flag}, "a failing sender has no position any more"


@pytest.mark.parametrize("status", [Status.UNDECLARED, Status.GROUND, Status.AIRBORNE])
def test_other_status_is_no_flag(status):
    listener = Listener()
    fly(listener, straight(), seconds(5), status=status)
    assert listener.ever == set()


# ---------------------------------------------------------------- reports


def test_each_change_is_told_once():
    listener = Listener()
    fly(listener, straight(), seconds(10), status=Status.EMERGENCY)
    fly(listener, straight(), seconds(10, 20.0))
    text = RULES[Flag.EMERGENCY].text
    assert [(r.track_id, r.flag, r.text) for r in listener.reports] == [
        ("X", "emergency", text),
        ("X", "emergency", f"no longer: {text}"),
    ]


def test_a_hostile_sender_cannot_flood_the_log():
    listener = Listener()
    reports = []
    for k in range(2000):
        now_s = 10.0 + 0.005 * k
        status = Status.EMERGENCY if k % 8 < 4 else Status.AIRBORNE
        message = location(straight(north_m=300.0 * (k % 2)), now_s, status=status)
        listener.hear(now_s + 0.1, basic(f"G{k % 150}"), message, address=f"g{k % 150}")
        reports.append(len(listener.reports))
    assert reports[-1] > 50
    per_second = [b - a for a, b in zip(reports, reports[200:], strict=False)]
    assert max(per_second) <= 20
    assert len(listener.traffic._judge.reports) <= len(listener.traffic.tracks)


def test_a_track_that_is_gone_reports_nothing():
    listener = Listener()
    heard = [location(straight(north_m=30.0 * k), 10.0, status=Status.EMERGENCY) for k in range(100)]
    for k, message in enumerate(heard):
        listener.hear(10.2, basic(f"G{k}"), message, address=f"g{k}")
    listener.traffic.expire(40.0)
    assert listener.traffic.flagged(40.0) == []


def test_a_name_that_comes_later_takes_the_flags_along():
    listener = Listener()
    listener.hear(10.2, location(straight(), 10.0, status=Status.EMERGENCY), transport="ble4")
    listener.hear(10.3, basic(), transport="ble4")
    assert listener.flags() == {Flag.EMERGENCY}
    assert [r.track_id for r in listener.reports] == ["ble4/a"]


# ---------------------------------------------------------------- what a sender tells beside


def test_what_is_heard_before_the_track_is_kept():
    """BLE 4: each message is a frame; a registration beside the serial number; the last of each counts."""
    listener = Listener()
    operator = OperatorId(operator_id_type=0, operator_id="CHE87astrdge12k8")
    system = System(operator_lat_deg=47.4, operator_lon_deg=8.5)
    registration = basic("REG", IdType.CAA_REGISTRATION)
    before = (basic(), registration, System(), system, operator, SelfId(description_type=0, text="survey"))
    for k, message in enumerate(before):
        listener.hear(10.0 + 0.1 * k, message, transport="ble4")
    listener.hear(11.0, location(straight(), 10.8), transport="ble4", rssi=-71.0)
    latest = listener.traffic.tracks["X"].latest
    assert (latest.transport, latest.address, latest.rssi_dbm) == ("ble4", "a", -71.0)
    assert (latest.basic_id, latest.other_id) == (basic(), registration)
    assert (latest.system, latest.operator_id) == (system, operator)
    assert latest.self_id == SelfId(description_type=0, text="survey")
    assert latest.authentication is None


def test_what_one_transport_lacks_the_other_has_told():
    listener = Listener()
    listener.hear(
        10.2, basic(), location(straight(), 10.0), System(area_count=2), transport="wifi", address="w"
    )
    listener.hear(10.9, basic(), location(straight(), 10.7), transport="ble5", address="b", rssi=-90.0)
    latest = listener.traffic.tracks["X"].latest
    assert (latest.transport, latest.address, latest.rssi_dbm) == ("ble5", "b", -90.0)
    assert latest.system == System(area_count=2)


def test_foreign_authentication_is_shown():
    listener = Listener()
    drip = AuthenticationData(5, UTC_OFFSET_S, bytes(range(137)))
    listener.hear(10.2, basic(), location(straight(), 10.0), *split(drip))
    assert listener.traffic.tracks["X"].latest.authentication == drip


def test_every_flag_has_its_sentence():
    assert set(RULES) == set(Flag)
    for rule in RULES.values():
        assert 1 <= rule.raise_at <= rule.most
        assert rule.text[0].islower()


def test_ten_changes_are_reported_at_once_and_ten_a_second():
    """In the order in which the tracks changed."""
    reports, flags = Reports(), (Flag.JUMP, Flag.EMERGENCY)
    for number in range(20):
        reports.mark(f"{number:02}", Doubts(flags=set(flags)))
    told = [[report.track_id for report in reports.due(now_s)] for now_s in (100.0, 100.0, 100.5, 900.0)]
    assert [len(tracks) for tracks in told] == [10, 0, 5, 10]
    assert [track for tracks in told for track in tracks] == [f"{n // 2:02}" for n in range(25)]
    reports.forget("19")
    assert len(reports) == 7
