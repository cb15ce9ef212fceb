"""Aircraft whose positions do not follow the velocity that they report: they are avoided with both."""

from __future__ import annotations

import pytest

from companion.traffic.places import MOVED_PLACE
from tests.companion.traffic.listening import Listener, basic, location


def flown(seconds, *, told_mps, speed_mps=15.0, forged=None):
    """What the law is given after each second of a flight to the east, by name.

    Args:
        told_mps: speed that is reported, to the east, at each second.
        forged: sends something after the message of a second.
    """
    listener, found = Listener(), []
    for second in range(seconds):
        now_s = 10.2 + second
        message = location(0.0, speed_mps * second, 10.0 + second, told_mps(second), vertical_speed_mps=0.0)
        listener.hear(now_s, basic("X"), message)
        if forged is not None:
            forged(listener, second)
        found.append({n.track_id: n for n in listener.traffic.neighbours(now_s)})
    return found


@pytest.mark.parametrize("told_mps", [0.0, 40.0])
def test_positions_that_do_not_follow_the_velocity_are_believed_as_well(told_mps):
    seen = flown(20, told_mps=lambda second: told_mps)[-1]
    assert seen["X"].velocity_ned_mps[1] == pytest.approx(told_mps)
    moved = seen["X" + MOVED_PLACE]
    assert moved.velocity_ned_mps == pytest.approx((0.0, 15.0, 0.0), abs=0.1)
    assert (moved.position_ned_m, moved.age_s, moved.proven) == (
        seen["X"].position_ned_m,
        seen["X"].age_s,
        False,
    )


def test_a_velocity_that_is_right_again_is_believed_alone_within_half_a_minute():
    found = flown(60, told_mps=lambda second: 0.0 if second < 20 else 15.0)
    assert "X" + MOVED_PLACE in found[20]
    assert found[50].keys() == {"X"}


def test_an_honest_flight_is_one_aircraft():
    assert all(seen.keys() == {"X"} for seen in flown(60, told_mps=lambda second: 15.0))


@pytest.mark.parametrize("off_m", [8.0, 20.0, 40.0])
def test_forged_messages_in_its_name_take_its_velocity_from_no_aircraft(off_m):
    """They say that it stands, or has the velocity of nobody."""

    def forge(listener, second):
        speed_mps = 0.0 if second % 2 else 60.0
        message = location(off_m, 15.0 * second + 6.0, 10.4 + second, speed_mps, vertical_speed_mps=0.0)
        listener.hear(10.6 + second, message)

    for second, seen in enumerate(flown(40, told_mps=lambda second: 15.0, forged=forge)):
        east_m = 15.0 * (second + 0.7)
        places = [
            n.position_ned_m[1] + (n.age_s + 0.5) * n.velocity_ned_mps[1]
            for n in seen.values()
            if abs(n.position_ned_m[0]) < 1.0 and n.velocity_ned_mps[1] == pytest.approx(15.0)
        ]
        assert min(abs(place - east_m) for place in places) < 4.0
