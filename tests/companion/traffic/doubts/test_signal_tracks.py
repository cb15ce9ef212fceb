"""A track whose signal strength contradicts its position is avoided at the place that the powers point to."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.avoidance.law import Neighbour
from companion.traffic.places import SIGNAL_PLACE, _signalled
from companion.traffic.signal_strength import Suspicion
from tests.companion.traffic.flights import Listener, basic, location

BEGIN_S, SPEED_MPS, HEIGHT_M = 11.0, 3.0, 20.0


def coming(aside_m: float, rssi: bool = True, content_s: float = 0.2) -> list[Neighbour]:
    """Neighbours when a sender that comes from the north is 20 m away.

    Args:
        aside_m: how far east of its place it reports to be.
        rssi: whether the power is received, with the distance as in free space.
        content_s: time between two new positions; every 0.2 s there is a message.
    """
    listener, frames = Listener(), 300
    for frame in range(frames):
        now_s = BEGIN_S + 0.2 * frame
        north_m = 20.0 + SPEED_MPS * 0.2 * (frames - 1 - frame)
        at_s = BEGIN_S + content_s * math.floor((now_s - BEGIN_S) / content_s + 1e-6)
        told = north_m + SPEED_MPS * (now_s - at_s), aside_m, -SPEED_MPS, 0.0, HEIGHT_M
        power = -40.0 - 20.0 * math.log10(north_m) if rssi else None
        listener.traffic.note_own(now_s, (0.0, 0.0, -HEIGHT_M), (0.0, 0.0, 0.0))
        listener.hear(now_s, basic(), location(lambda _, told=told: told, at_s), rssi=power)
    return listener.traffic.neighbours(now_s)


def test_a_liar_is_avoided_where_it_is_too() -> None:
    there, beside = coming(50.0)
    assert [there] == coming(50.0, rssi=False), "the reported place is avoided as before"
    assert (there.track_id, beside.track_id) == ("X", "X" + SIGNAL_PLACE)
    assert beside.position_ned_m[:2] == pytest.approx((20.0, 0.0), abs=15.0)
    assert beside.velocity_ned_mps == there.velocity_ned_mps
    assert not beside.proven


def test_its_place_is_told_by_how_far_it_is_from_the_reported_one() -> None:
    reported = Neighbour("X", (100.0, 20.0, -30.0), (3.0, 0.0, 0.0), 0.5, 3.0, proven=True)
    beside = _signalled(reported, Suspicion(9.0, 9.0, -40.0, 25.0))
    assert beside == msgspec.structs.replace(
        reported, track_id="X" + SIGNAL_PLACE, position_ned_m=(60.0, 45.0, -30.0), proven=False
    )


def test_who_says_the_truth_is_avoided_once() -> None:
    assert [n.track_id for n in coming(0.0)] == ["X"]


def test_the_powers_of_repeated_positions_count() -> None:
    """Once a second there is a new position. With its repetitions the liar is found all the same."""
    there, beside = coming(50.0, content_s=1.0)
    assert beside.position_ned_m[:2] == pytest.approx((20.0, 0.0), abs=15.0)
    assert there.position_ned_m[1] == pytest.approx(50.0, abs=0.1)
