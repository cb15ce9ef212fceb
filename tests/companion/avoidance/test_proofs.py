"""Theorems on the closing speed and on the limit of a command's change, over the real numbers.

The formulas are transcribed from `closing` and `limit`; random inputs hold the transcriptions against the
compiled code. A square root is a number of its own, not negative, whose square is what stands under the root.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import z3

from companion.avoidance.kernels import Bounds, Vector, closing, limit
from tests.companion.proving import prove, refute

A, LAG, ROOM, PERIOD, V, W, T, ROOT, ROOT_AFTER = z3.Reals("a lag room period v w t root root_after")
POSITIVE = (A > 0, LAG > 0, PERIOD > 0, ROOM >= 0)


def speed_at(room, root):
    """`closing` for a room that is not negative: its value, and what makes `root` its square root."""
    return root - A * LAG, z3.And(root >= 0, root * root == A * LAG * A * LAG + 2 * A * room)


ALLOWED, IS_ROOT = speed_at(ROOM, ROOT)


# ---------------------------------------------------------------- the closing speed


def test_the_closing_speed_is_the_transcribed_one():
    rng = np.random.default_rng(1)
    for room, a, lag in zip(
        rng.uniform(0.0, 300.0, 1000), rng.uniform(0.3, 8.0, 1000), rng.uniform(0.1, 2.0, 1000), strict=True
    ):
        v = closing(room, a, lag)
        root = v + a * lag
        assert root >= 0.0
        assert root * root == pytest.approx((a * lag) ** 2 + 2.0 * a * room, rel=1e-12)


def test_the_closing_speed_uses_all_of_the_room_and_no_more():
    prove(z3.And(ALLOWED >= 0, ALLOWED * LAG + ALLOWED * ALLOWED / (2 * A) == ROOM), *POSITIVE, IS_ROOT)


def test_who_flies_at_most_the_closing_speed_reacts_and_then_brakes_stops_before_the_plane():
    """One approach: towards the plane at most v for the time `lag`, then braking with `a`: at no moment of
    the braking is more of the room used up than there is. 1 m/s faster, it can be."""
    flies = (*POSITIVE, IS_ROOT, V >= 0, W >= 0, W <= V * LAG, T >= 0, A * T <= V)
    way = W + V * T - A * T * T / 2  # w: the way made during the reaction
    prove(way <= ROOM, *flies, V <= ALLOWED)
    refute(way <= ROOM, *flies, V <= ALLOWED + 1)


def test_who_keeps_to_the_closing_speed_of_each_period_never_reaches_the_plane():
    """Sampled, any number of periods by induction: whatever speed is flown during a period, if it is at most
    the closing speed of the room at its beginning, room is left at its end. Periods may last as long as the
    lag, not longer than twice the lag."""
    period = (*POSITIVE, IS_ROOT, ALLOWED >= V)
    prove(ROOM - V * PERIOD >= 0, *period, PERIOD <= LAG)
    refute(ROOM - V * PERIOD >= 0, *period, PERIOD > 2 * LAG)


def test_braking_keeps_to_the_closing_speed_of_every_later_period():
    """The sampled limit can be kept: who flew at most the closing speed for a period has, at its end, a room
    whose closing speed is at least the speed flown less `a` times the period. Idealised: a commanded speed is
    flown at once and without error, and the plane stands still."""
    then, is_root = speed_at(ROOM - V * PERIOD, ROOT_AFTER)
    flies = (*POSITIVE, IS_ROOT, V >= 0, V <= ALLOWED, is_root, V >= A * PERIOD)
    prove(then >= V - A * PERIOD, *flies, PERIOD <= LAG)
    refute(then >= V - A * PERIOD, *flies, PERIOD > 3 * LAG)


# ---------------------------------------------------------------- the limit of change


def transcribed(wanted, before, change, least, most, speed):
    """`limit` without its two shares for rounding, and which of its three cuts it made: of the change, of the
    down speed, of the speed."""
    dn, de, dd = (w - b for w, b in zip(wanted, before, strict=True))
    length = math.hypot(dn, de, dd)
    k = change / length if length > change else 1.0
    free = before[2] + k * dd
    down = min(max(free, least), most)
    if down != free:
        left, level = math.sqrt(max(change**2 - (down - before[2]) ** 2, 0.0)), math.hypot(dn, de)
        k = left / level if level > left else 1.0
    n, e = before[0] + k * dn, before[1] + k * de
    cut = min(max(down, -speed), speed)
    level, room = math.hypot(n, e), math.sqrt(max(speed**2 - cut**2, 0.0))
    if level > room:
        n, e = n * room / level, e * room / level
    return (n, e, cut), (length > change, down != free, level > room)


def in_ball(rng, speed):
    """A velocity of at most so much; one in three at the limit itself."""
    v = rng.normal(size=3)
    return v * speed / math.hypot(*v) * (1.0 if rng.random() < 0.3 else rng.random() ** (1 / 3))


def drawn(rng):
    speed = rng.uniform(1.0, 20.0)
    least, most = sorted(rng.uniform(-speed, speed, 2))
    change = rng.choice([0.1, 0.5, 3.0]) * rng.uniform(0.05, 1.0)
    before = in_ball(rng, speed)
    wanted = before + 2 * change * in_ball(rng, 1.0) if rng.random() < 0.5 else in_ball(rng, speed)
    if (fast := math.hypot(*wanted)) > speed:
        wanted *= speed / fast
    return wanted, before, change, least, most, speed


def test_the_limit_is_the_transcribed_one_and_keeps_its_bounds():
    """Searched: 6000 random cases, with every combination of cuts among them but the speed's where the down
    bounds do not cut: there it only rounds."""
    rng = np.random.default_rng(2)
    cuts = set()
    for _ in range(6000):
        wanted, before, change, least, most, speed = drawn(rng)
        got = limit(Vector(*wanted), Vector(*before), Bounds(change, least, most, speed))
        expected, cut = transcribed(wanted, before, change, least, most, speed)
        cuts.add(cut)
        # Under a root, shares for rounding of 1e-9 become 3e-5 of the value.
        assert got == pytest.approx(expected, abs=2e-4 * (1.0 + change))
        assert math.hypot(*got) <= speed * (1.0 + 1e-15)
        assert least - 1e-11 * speed <= got[2] <= most + 1e-11 * speed
        if least <= before[2] <= most:
            assert math.dist(got, before) <= change * (1.0 + 1e-12)
    of_change_and_down = {(change, down, False) for change in (False, True) for down in (False, True)}
    assert cuts >= of_change_and_down | {(False, True, True), (True, True, True)}


LEAST, MOST, DOWN, BEFORE, CHANGE, SPEED = z3.Reals("least most down before change speed")
K, J = z3.Reals("k j")
LEVEL, LEFT, RADIUS = z3.Reals("level left radius")


def clipped(value, low, high):
    raised = z3.If(value < low, low, value)
    return z3.If(raised > high, high, raised)


def test_the_down_bounds_and_the_speed_hold_whatever_was_commanded_before():
    """Nothing is given of the wish, nor of the last command. The down bounds are reachable at all: the least
    is no more than the speed, the greatest no less than minus it."""
    down = clipped(clipped(DOWN, LEAST, MOST), -SPEED, SPEED)
    bounds = (LEAST <= MOST, SPEED > 0, LEAST <= SPEED, MOST >= -SPEED)
    prove(z3.And(down >= LEAST, down <= MOST, down >= -SPEED, down <= SPEED), *bounds)
    # The level part, in the axis along it: what `room` is and what is left of the level speed.
    room = z3.And(RADIUS >= 0, SPEED * SPEED - down * down == RADIUS * RADIUS)
    level = z3.If(LEVEL > RADIUS, RADIUS, LEVEL)
    prove(level * level + down * down <= SPEED * SPEED, *bounds, room, LEVEL >= 0)


def test_a_change_is_no_longer_than_allowed_where_the_down_bounds_do_not_cut():
    """The first cut, along the change: k of it is at most `change` long."""
    k = z3.If(LEVEL > CHANGE, K, z3.RealVal(1))
    prove(k * LEVEL <= CHANGE, CHANGE >= 0, LEVEL >= 0, K * LEVEL == CHANGE)
    # With wish and last command within the speed, so is all between them: the speed cuts nothing.
    p2, w2, pw = z3.Reals("p2 w2 pw")  # their squares and product: |p - w|^2 = p2 - 2 pw + w2 >= 0
    prove(
        (1 - K) * (1 - K) * p2 + 2 * K * (1 - K) * pw + K * K * w2 <= 1,
        p2 >= 0, w2 >= 0, p2 <= 1, w2 <= 1, p2 - 2 * pw + w2 >= 0, K >= 0, K <= 1,
    )  # fmt: skip


def test_a_change_is_no_longer_than_allowed_where_the_down_bounds_cut():
    """With the last command within the down bounds: the cut moves the down speed towards it, the level part
    has what that leaves, and the cut to the speed brings the level part no farther away.

    The last step: q is the point of the straight change at the new down speed, or the last command, whichever
    is within the level room; c, farther on the way, is cut to the room along itself (the first axis). What
    comes out is no farther from q than c, so no farther from the last command than c by way of q.
    """
    down = clipped(BEFORE + DOWN, LEAST, MOST)
    within = (LEAST <= BEFORE, BEFORE <= MOST)
    prove(z3.And((down - BEFORE) * DOWN >= 0, (down - BEFORE) ** 2 <= DOWN * DOWN), *within)
    gap = down - BEFORE
    left = z3.And(LEFT >= 0, CHANGE * CHANGE - gap * gap == LEFT * LEFT)
    k = z3.If(LEVEL > LEFT, K, z3.RealVal(1))
    prove(
        (k * LEVEL) ** 2 + gap * gap <= CHANGE * CHANGE,
        *within, left, CHANGE >= 0, LEVEL >= 0, K * LEVEL == LEFT,
    )  # fmt: skip
    qn, qe, c = z3.Reals("qn qe c")
    prove(
        (RADIUS - qn) ** 2 + qe**2 <= (c - qn) ** 2 + qe**2,
        RADIUS >= 0, c > RADIUS, qn**2 + qe**2 <= RADIUS * RADIUS,
    )  # fmt: skip
    # The level share after a cut is no less than before it (q comes before c on the way).
    prove(
        LEFT >= J * LEVEL,
        *within, left, CHANGE >= 0, LEVEL >= 0, J >= 0, J <= 1,
        (J * LEVEL) ** 2 + gap * gap <= CHANGE * CHANGE,
    )  # fmt: skip


def test_where_the_down_bounds_force_it_the_change_exceeds_by_no_more_than_they_ask():
    """Searched, 2000 cases with the last command outside of the down bounds: the down speed changes by the
    greater of what is allowed and what the bounds ask; level, the cut to the speed may come on top."""
    rng = np.random.default_rng(3)
    forced = 0
    while forced < 2000:
        wanted, before, change, least, most, speed = drawn(rng)
        asked = max(least - before[2], before[2] - most, 0.0)
        if asked == 0.0:
            continue
        forced += 1
        n, e, down = limit(Vector(*wanted), Vector(*before), Bounds(change, least, most, speed))
        assert abs(down - before[2]) <= max(change, asked) * (1.0 + 1e-9)
        if math.hypot(n, e, down) < speed * (1.0 - 1e-9):  # the speed has cut nothing
            assert math.dist((n, e, down), before) <= max(change, asked) * (1.0 + 1e-9)
