"""Every flag: raised when it is true, and not by an honest aircraft that comes near it."""

from __future__ import annotations

import random

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from companion.remote_id.authentication import (
    MESSAGE_SET_SIGNATURE,
    UAS_ID_SIGNATURE,
    AuthenticationData,
    sign_pages,
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
from companion.traffic.plausibility import RULES, Flag
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

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC_HEX = KEY.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


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
    fly(listener, straight(north_m=900.0), seconds(4, 20.0))
    (new,) = [t for t in listener.traffic.tracks.values() if t.track_id != "X"]
    assert new.flags == {Flag.JUMP}
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


# ---------------------------------------------------------------- timestamps


@pytest.mark.parametrize("clock_s", [-3.0, -4.5, -20.0, -900.0])
def test_stale_timestamps(clock_s):
    listener = Listener()
    fly(listener, straight(), seconds(15), clock_s=clock_s)
    assert listener.flags() == {Flag.STALE_TIMESTAMP}


def test_a_late_second_reception_now_and_then_is_not_stale():
    listener = Listener()
    for k, t in enumerate(seconds(60)):
        fly(listener, straight(), [t], delay_s=2.5 if k % 3 == 0 else 0.8)
    assert Flag.STALE_TIMESTAMP not in listener.ever


@pytest.mark.parametrize("clock_s", [1.0, 4.0, 18.0, 900.0])
def test_future_timestamps(clock_s):
    listener = Listener()
    fly(listener, straight(), seconds(15), clock_s=clock_s)
    assert listener.flags() == {Flag.FUTURE_TIMESTAMP}


def test_a_lead_within_the_declared_accuracy_is_no_doubt():
    listener = Listener()
    fly(listener, straight(), seconds(15), clock_s=1.5, timestamp_accuracy_s=1.5)
    assert listener.ever == set()


def test_one_wrong_timestamp_is_no_doubt():
    listener = Listener()
    for k, t in enumerate(seconds(30)):
        fly(listener, straight(), [t], clock_s=4.0 if k == 7 else 0.0)
    assert listener.ever == set()


@pytest.mark.parametrize("clock_s", [-900.0, 900.0])
def test_without_our_own_utc_no_clock_is_doubted(clock_s):
    listener = Listener(utc_offset_s=None)
    fly(listener, straight(), seconds(15), clock_s=clock_s)
    assert listener.ever == set()


def test_no_timestamp_and_its_end():
    listener = Listener()
    fly(listener, straight(), seconds(10), timestamp_s=None)
    assert listener.flags() == {Flag.NO_TIMESTAMP}
    fly(listener, straight(), seconds(10, 20.0))
    assert listener.flags() == frozenset()


def test_timestamps_across_the_full_hour_are_sound():
    listener = Listener()
    fly(listener, straight(), seconds(60, 3570.0))
    assert listener.ever == set()


# ---------------------------------------------------------------- velocity and values


@pytest.mark.parametrize(
    "change",
    [
        {"speed_mps": 0.0},
        {"direction_deg": 270.0},
        {"direction_deg": 0.0, "speed_mps": 30.0},
    ],
)
@pytest.mark.parametrize("rate_hz", [1.0, 4.0])
def test_velocity_that_the_positions_do_not_follow(change, rate_hz):
    listener = Listener()
    motion = straight(20.0)
    fly(listener, motion, seconds(int(20 * rate_hz), rate_hz=rate_hz), **change)
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}
    fly(listener, motion, seconds(int(25 * rate_hz), 30.0, rate_hz))
    assert listener.flags() == frozenset()


PRECISE = {"horizontal_accuracy_m": 1.0, "speed_accuracy_mps": 0.3}


def test_short_stops_between_messages():
    """Heard every 4.5 s, always at cruise; in between it brakes to a hover and goes on."""
    listener = Listener()
    motion = stop_and_go(8.0, 5.0, cruise_s=0.2, hover_s=1.1)
    fly(listener, motion, [0.1 + 4.5 * k for k in range(4, 24)], **PRECISE)
    assert listener.ever == set()
    assert listener.traffic.tracks["X"].messages == 20


@pytest.mark.parametrize("stamped", [True, False])
def test_fast_and_dated_a_little_wrong(stamped):
    """60 m/s: timestamps 0.3 s off either way, or none and up to 0.9 s of delay."""
    listener = Listener()
    for k, t in enumerate(seconds(60)):
        late = k // 5 % 2
        if stamped:
            fly(listener, straight(60.0), [t], clock_s=0.6 * late - 0.3, **PRECISE)
        else:
            fly(listener, straight(60.0), [t], delay_s=0.9 * late, timestamp_s=None, **PRECISE)
    assert listener.ever == (set() if stamped else {Flag.NO_TIMESTAMP})


def test_noise_of_thirty_metres_where_that_is_declared():
    listener = Listener()
    generator = random.Random(6)
    for t in seconds(120):
        motion = straight(5.0, generator.gauss(200.0, 20.0), generator.gauss(-300.0, 20.0))
        fly(listener, motion, [t], horizontal_accuracy_m=30.0, speed_accuracy_mps=0.3)
    assert listener.ever == set()


def test_long_silences_neither_raise_nor_end_a_mismatch():
    listener = Listener()
    fly(listener, straight(20.0), seconds(20), speed_mps=0.0)
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}
    fly(listener, straight(20.0), [40.0, 49.0, 58.0, 67.0])
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}


def test_a_still_position_with_a_velocity():
    listener = Listener()
    fly(listener, straight(0.0), seconds(20), speed_mps=15.0, direction_deg=45.0)
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}


def test_an_unknown_velocity_is_no_mismatch():
    listener = Listener()
    fly(listener, straight(), seconds(30), speed_mps=None, direction_deg=None)
    assert listener.ever == set()


def test_a_velocity_mismatch_that_reception_times_explain():
    """Without timestamps, heard 0 to 1.5 s late: positions and times do not fit well."""
    listener = Listener()
    generator = random.Random(4)
    for t in seconds(60):
        fly(listener, straight(10.0), [t], delay_s=generator.uniform(0.0, 0.9), timestamp_s=None)
    assert listener.ever == {Flag.NO_TIMESTAMP}


def test_a_speed_that_cannot_be():
    """The message is not believed; the track it would have moved says why."""
    listener = Listener()
    fly(listener, straight(), seconds(5))
    fly(listener, straight(), seconds(3, 15.0), speed_mps=200.0)
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


def test_a_place_that_cannot_be():
    listener = Listener()
    fly(listener, straight(), seconds(5))
    fly(listener, straight(north_m=90_000.0), seconds(3, 15.0))
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


def test_altitudes_that_leap():
    listener = Listener()
    for k, t in enumerate(seconds(10)):
        fly(listener, straight(), [t], alt_geodetic_m=447.0 + 600.0 * (k % 2))
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


def test_an_altitude_that_cannot_be():
    listener = Listener()
    fly(listener, straight(), seconds(5), alt_geodetic_m=30_000.0)
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


@pytest.mark.parametrize("climb_mps", [10.0, -40.0, 60.0])
def test_a_climb_or_dive_is_possible(climb_mps):
    listener = Listener()
    for t in seconds(20):
        fly(
            listener,
            straight(),
            [t],
            alt_geodetic_m=2000.0 + climb_mps * (t - 10.0),
            vertical_speed_mps=climb_mps,
        )
    assert listener.ever == set()


def test_the_first_altitude_of_a_receiver_is_forgiven():
    listener = Listener()
    fly(listener, straight(), seconds(5), alt_geodetic_m=0.0)
    fly(listener, straight(), seconds(20, 15.0))
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


# ---------------------------------------------------------------- signatures


def signed_flight(
    listener, times_s, key=KEY, auth_type=MESSAGE_SET_SIGNATURE, age_s=0.0, north_m=200.0, **heard
):
    for t in times_s:
        messages = (basic(), location(straight(north_m=north_m), t))
        pages = sign_pages(key, auth_type, "X", messages, UTC_OFFSET_S + int(t - age_s))
        listener.hear(t + 0.2, *messages, *pages, **heard)


@pytest.mark.parametrize("auth_type", [MESSAGE_SET_SIGNATURE, UAS_ID_SIGNATURE])
def test_signed(auth_type):
    listener = Listener(keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(20), auth_type=auth_type)
    assert listener.flags() == {Flag.SIGNED}
    assert [r.flag for r in listener.reports] == ["signed"]
    fly(listener, straight(), seconds(20, 30.0))
    assert listener.flags() == {Flag.UNSIGNED}


def test_signed_page_by_page_on_ble4():
    """Four frames for the pages, between the others; the track is vouched for by its address."""
    listener = Listener(keys={"X": PUBLIC_HEX})
    for t in seconds(12):
        fly(listener, straight(), [t], transport="ble4")
        for k, page in enumerate(sign_pages(KEY, UAS_ID_SIGNATURE, "X", (), UTC_OFFSET_S + int(t))):
            listener.hear(t + 0.3 + 0.1 * k, page, transport="ble4")
    assert listener.flags() == {Flag.SIGNED}
    assert listener.traffic.tracks["X"].about.authentication.auth_type == UAS_ID_SIGNATURE


def test_unsigned_only_where_a_key_is_known():
    listener = Listener(keys={"X": PUBLIC_HEX})
    fly(listener, straight(), seconds(20))
    fly(listener, straight(north_m=500.0), seconds(20), identity="Y", address="y")
    assert listener.flags() == {Flag.UNSIGNED}
    assert listener.flags("Y") == frozenset()


def test_a_signer_is_not_called_unsigned_before_it_could_sign():
    listener = Listener(keys={"X": PUBLIC_HEX})
    fly(listener, straight(), seconds(8))
    signed_flight(listener, seconds(8, 18.0))
    assert listener.ever == {Flag.SIGNED}


def test_without_our_own_utc_nobody_is_called_unsigned():
    listener = Listener(utc_offset_s=None, keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(20))
    assert listener.ever == set()


@pytest.mark.parametrize("age_s", [30.0, -30.0])
def test_an_old_or_early_signature_is_bad(age_s):
    listener = Listener(keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(5), age_s=age_s)
    assert listener.flags() == {Flag.BAD_SIGNATURE}


def test_a_forged_signature_is_bad():
    listener = Listener(keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(5), key=Ed25519PrivateKey.from_private_bytes(bytes(32)))
    assert listener.flags() == {Flag.BAD_SIGNATURE}
    assert listener.traffic.neighbours(15.0), "a forger is avoided like everybody"


def test_a_signed_set_vouches_for_its_own_location_only():
    """From the signer's address another one puts X elsewhere: that track is not vouched for."""
    listener = Listener(keys={"X": PUBLIC_HEX})
    for t in seconds(30):
        signed_flight(listener, [t])
        fly(listener, straight(north_m=-900.0), [t + 0.5])
    (copy,) = [t for t in listener.traffic.tracks.values() if t.track_id != "X"]
    assert Flag.SIGNED in listener.flags("X")
    assert Flag.SIGNED not in copy.flags
    assert Flag.UNSIGNED in copy.flags


def test_signatures_say_nothing_without_keys():
    listener = Listener()
    signed_flight(listener, seconds(20))
    assert listener.ever == set()
    assert len(listener.traffic.tracks["X"].about.authentication.data) == 64


def test_a_repeated_signature_is_checked_once():
    listener = Listener(keys={"X": PUBLIC_HEX})
    messages = (basic(), location(straight(), 10.0))
    pages = sign_pages(KEY, MESSAGE_SET_SIGNATURE, "X", messages, UTC_OFFSET_S + 10.0)
    for k in range(200):
        listener.hear(10.2 + 0.001 * k, *messages, *pages)
    assert listener.flags() == {Flag.SIGNED}
    assert Flag.BAD_SIGNATURE not in listener.ever


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
    about = listener.traffic.tracks["X"].about
    assert (about.transport, about.address, about.rssi_dbm) == ("ble4", "a", -71.0)
    assert (about.basic_id, about.other_id) == (basic(), registration)
    assert (about.system, about.operator_id) == (system, operator)
    assert about.self_id == SelfId(description_type=0, text="survey")
    assert about.authentication is None


def test_what_one_transport_lacks_the_other_has_told():
    listener = Listener()
    listener.hear(
        10.2, basic(), location(straight(), 10.0), System(area_count=2), transport="wifi", address="w"
    )
    listener.hear(10.9, basic(), location(straight(), 10.7), transport="ble5", address="b", rssi=-90.0)
    about = listener.traffic.tracks["X"].about
    assert (about.transport, about.address, about.rssi_dbm) == ("ble5", "b", -90.0)
    assert about.system == System(area_count=2)


def test_foreign_authentication_is_shown():
    listener = Listener()
    drip = AuthenticationData(5, UTC_OFFSET_S, bytes(range(137)))
    listener.hear(10.2, basic(), location(straight(), 10.0), *split(drip))
    assert listener.traffic.tracks["X"].about.authentication == drip


def test_every_flag_has_its_sentence():
    assert set(RULES) == set(Flag)
    for rule in RULES.values():
        assert 1 <= rule.raise_at <= rule.most
        assert rule.text[0].islower()
