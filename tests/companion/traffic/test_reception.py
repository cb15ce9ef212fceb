"""Rates and shares from the counters of frames, under losses and from strange senders."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import TrafficConfig
from companion.events import RemoteIdHeard
from companion.remote_id.messages import BasicId, IdType, Location, SelfId, UaType
from companion.traffic.senders.reception import HEARD_S, UNKNOWN_RATE, Reception
from companion.traffic.tracks import Traffic
from tests.support.place import HOME

TICK_S = 0.05


def stream(rate, share, seconds, rng=None, counted=True, start_s=0.0, reception=None):
    """A sender of which a share arrives, each frame at the next tick of a loop."""
    reception = reception or Reception()
    rng = rng or np.random.default_rng(1)
    for k in range(round(rate * seconds)):
        if rng.random() < share:
            arrived_s = np.ceil((start_s + k / rate) / TICK_S) * TICK_S
            reception.count_frame(k & 0xFF if counted else None, float(arrived_s))
    return reception


@pytest.mark.parametrize("rate", [1, 2, 3, 5, 10])
@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_losses_do_not_change_the_rate(rate, share):
    rng = np.random.default_rng(rate)
    found = []
    for _ in range(40):
        reception = stream(rate, share, 60.0, rng)
        if (told := reception.rate(60.0)) > 0:
            found.append(told)
    # At 1 a second of which a fifth arrives, most are silent for longer than counts.
    assert len(found) >= (35 if rate * share >= 1.0 else 10)
    assert np.median(found) == rate
    assert max(found) - rate <= 1 + 0.1 * rate


@pytest.mark.parametrize("share", [1.0, 0.6, 0.2, 0.05])
def test_the_share_is_found(share):
    rng = np.random.default_rng(3)
    sums = np.array([stream(10, share, 60.0, rng).arrivals(60.0) for _ in range(100)])
    arrived, expected = sums.sum(axis=0)
    assert arrived / expected == pytest.approx(share, rel=0.1)
    assert 40.0 < expected / 100 < 101.0


@pytest.mark.parametrize(("share", "most"), [(1.0, 0.0), (0.5, 0.0), (0.2, 0.25)])
def test_a_sender_that_repeats_its_content_is_not_measured(share, most):
    """Ten frames a second with one new content: most counts arrive, however many frames are lost. Under heavy
    loss few contents arrive twice, which is noticed less often."""
    rng, measured = np.random.default_rng(4), 0
    for _ in range(40):
        reception = Reception()
        for k in range(600):
            if rng.random() < share:
                reception.count_frame(k // 10 & 0xFF, 0.1 * k)
        measured += reception.arrivals(60.0)[1] > 0.0
    assert measured <= 40 * most


def test_a_frame_that_is_received_twice_at_once_is_no_repetition():
    reception = Reception()
    for k in range(100):
        for copy in range(3):
            reception.count_frame(k & 0xFF, k + 0.01 * copy)
    assert reception.arrivals(99.0)[1] > 5.0


def test_a_frame_that_a_second_receiver_passes_on_a_step_later_is_no_repetition():
    reception = Reception()
    for k in range(100):
        reception.count_frame(k & 0xFF, 0.2 * k)
        reception.count_frame(k & 0xFF, 0.2 * k + 0.051)
    assert reception.arrivals(20.0)[1] > 5.0


def test_a_changed_rate_is_seen_within_seconds():
    reception = stream(10, 0.5, 30.0)
    assert reception.rate(30.0) == 10
    rng = np.random.default_rng(2)
    for k in range(20):
        if rng.random() < 0.5:
            reception.count_frame((300 + k) & 0xFF, 30.0 + k / 2)
    assert reception.rate(40.0) == 2


def test_heard_once_or_no_more():
    reception = Reception()
    assert reception.rate(0.0) == 0
    reception.count_frame(7, 1.0)
    assert reception.rate(1.0 + HEARD_S) == UNKNOWN_RATE
    assert reception.rate(1.01 + HEARD_S) == 0
    assert reception.arrivals(1.0) == (0.0, 0.0)


def test_repetitions_are_no_messages():
    reception = Reception()
    for k in range(100):
        reception.count_frame(k // 5, 0.1 * k)
    assert reception.rate(10.0) == 2
    arrived, expected = reception.arrivals(10.0)
    assert arrived == pytest.approx(expected)


def test_without_a_counter_arrivals_are_the_rate_and_no_share_is_told():
    reception = stream(10, 0.5, 30.0, counted=False)
    assert 3 <= reception.rate(30.0) <= 7
    assert reception.arrivals(30.0) == (0.0, 0.0)


def test_frames_that_overtake_each_other_are_all_arrivals():
    reception = Reception()
    rng = np.random.default_rng(1)
    frames = sorted((0.1 * k + rng.uniform(0.15, 0.6), k & 0xFF) for k in range(300))
    for arrived_s, counter in frames:
        reception.count_frame(counter, arrived_s)
    arrived, expected = reception.arrivals(frames[-1][0])
    assert 0.9 * expected < arrived <= expected
    assert reception.rate(frames[-1][0]) == 10


def test_made_up_counters_move_little():
    reception = Reception()
    rng = np.random.default_rng(1)
    for k in range(1000):
        reception.count_frame(int(rng.integers(0, 256)), 0.01 * k)
        assert 0 <= reception.rate(0.01 * k) <= 10
    arrived, expected = reception.arrivals(10.0)
    assert 0.0 <= arrived <= expected <= 400.0


def test_a_restarted_sender_is_not_a_loss():
    reception = stream(10, 1.0, 20.0)
    stream(10, 1.0, 20.0, start_s=20.0, reception=reception)
    arrived, expected = reception.arrivals(40.0)
    assert arrived == pytest.approx(expected)
    assert reception.rate(40.0) == 10


def test_a_long_silence_is_not_a_loss():
    reception = stream(10, 1.0, 20.0)
    stream(10, 1.0, 2.0, start_s=40.0, reception=reception)
    arrived, expected = reception.arrivals(42.0)
    assert arrived == pytest.approx(expected)


def test_every_transport_of_a_track_by_its_locations():
    traffic = Traffic(TrafficConfig(), "OWN")
    name = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.AEROPLANE, uas_id="X")

    def hear(transport, now_s, counter, *messages):
        heard = RemoteIdHeard(transport=transport, address="a", messages=messages, counter=counter)
        traffic.hear(heard, now_s, 0.0, HOME, 47.0)

    hear("ble4", 0.0, 0, name)
    for k in range(200):
        now_s = 0.1 * k
        place = Location(
            lat_deg=HOME.lat_deg, lon_deg=HOME.lon_deg + 0.001, timestamp_s=round(now_s, 1), speed_mps=0.0
        )
        hear("ble4", now_s, (200 + k) & 0xFF, place)
        # On BLE 4 every kind of message has a counter of its own.
        hear("ble4", now_s, k // 10, SelfId(description_type=0, text=f"{k // 10}"))
        if k % 5 == 0:
            hear("wifi", now_s, k // 5, name, place)
    (track,) = traffic.tracks.values()
    found = {transport: reception.rate(19.9) for transport, reception in traffic.receptions(track)}
    assert found == {"ble4": 10, "wifi": 2}


def test_what_arrived_fades_and_counts_for_nothing_after_ten_seconds():
    reception = stream(10, 1.0, 20.0)
    arrived, expected = reception.arrivals(reception.heard_s)
    later = reception.arrivals(reception.heard_s + 9.9)
    assert 0.0 < later[0] < arrived
    assert later[0] / later[1] == pytest.approx(arrived / expected)
    assert reception.arrivals(reception.heard_s + 10.1) == (0.0, 0.0)
