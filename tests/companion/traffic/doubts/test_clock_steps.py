"""A sender whose clock steps back, and messages that only look like it."""

from __future__ import annotations

import math

import pytest

from tests.companion.traffic.listening import Listener, basic, location

DELAY_S = 0.2


class Flight:
    """One aircraft that flies east and sends once a second; its messages take `DELAY_S`."""

    def __init__(self, speed_mps=15.0):
        self.listener = Listener()
        self.speed_mps = self.before_mps = speed_mps
        self.east_m, self.now_s = 0.0, 10.0

    def send(self, step_s=0.0, lost=False):
        """Fly for a second and send.

        Args:
            step_s: error of the clock.
        """
        self.now_s += 1.0
        self.east_m += 0.5 * (self.before_mps + self.speed_mps)
        self.before_mps = self.speed_mps
        if not lost:
            self.hear(self.now_s, location(0.0, self.east_m, self.now_s + step_s, self.speed_mps))

    def hear(self, sent_s, message, delay_s=DELAY_S):
        self.listener.hear(sent_s + delay_s, basic("X"), message)

    def places(self, after_s=0.5):
        """By name: how far ahead of its true place the aircraft is predicted."""
        now_s = self.now_s + after_s
        self.listener.traffic.expire(now_s)
        true_m = self.east_m + after_s * self.speed_mps
        return {
            n.track_id: n.position_ned_m[1] + n.age_s * n.velocity_ned_mps[1] - true_m
            for n in self.listener.traffic.neighbours(now_s)
        }


@pytest.mark.parametrize("step_s", [-1.5, -2.5, -4.0])
@pytest.mark.parametrize("speed_mps", [15.0, 25.0])
def test_a_clock_that_steps_back_neither_freezes_nor_moves_its_aircraft(step_s, speed_mps):
    flight = Flight(speed_mps)
    for second in range(40):
        flight.send(0.0 if second < 10 else step_s)
        assert flight.places() == {"X": pytest.approx(0.0, abs=0.5)}
    assert flight.listener.traffic.counts.old == 0


def test_the_correction_lasts_while_it_hovers_and_ends_when_the_clock_is_right():
    flight = Flight()
    for second in range(60):
        flight.speed_mps = min(15.0, max(0.0, 3.0 * abs(second - 25) - 15.0))
        flight.send(-3.0 if 10 <= second < 45 else 0.0)
        if not 15 <= second < 37:
            assert flight.places() == {"X": pytest.approx(0.0, abs=1.0)}, second


@pytest.mark.parametrize("hovers", [True, False])
def test_a_clock_that_is_set_right_unnoticed_can_step_again(hovers):
    """It is set right while the aircraft hovers, or is not heard for ten seconds."""
    flight = Flight()
    for second in range(80):
        if hovers:
            flight.speed_mps = min(15.0, max(0.0, 3.0 * abs(second - 30) - 15.0))
        flight.send(
            -3.0 if 10 <= second < 32 else -4.0 if second >= 60 else 0.0,
            lost=not hovers and 25 <= second < 35,
        )
        if not 15 <= second < 45:
            assert flight.places() == {"X": pytest.approx(0.0, abs=0.5)}, second


def test_a_message_that_arrives_late_is_no_step():
    """Its position is that of its timestamp."""
    flight = Flight()
    for second in range(20):
        flight.send(lost=second == 10)
        if second == 12:
            old = location(0.0, flight.east_m - 30.0, flight.now_s - 2.0, 15.0)
            flight.hear(flight.now_s + 0.3, old)
        assert flight.places()["X"] == pytest.approx(0.0, abs=0.5)


def test_delays_that_grow_are_no_step():
    """They age its messages, and the aircraft stays where it is."""
    flight = Flight()
    for second in range(20):
        flight.now_s += 1.0
        flight.east_m += 15.0
        message = location(0.0, flight.east_m, flight.now_s, 15.0)
        flight.hear(flight.now_s, message, delay_s=DELAY_S if second < 10 else 2.4)
        found = flight.places(2.5)
        assert found["X"] == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("step_s", [-1.5, -4.0, 4.0])
@pytest.mark.parametrize("every", [1, 3])
def test_forged_messages_with_another_clock_redate_no_true_one(step_s, every):
    """Just after a true one, at the place where the aircraft is."""
    flight = Flight()
    for second in range(30):
        flight.send()
        assert min(map(abs, flight.places(DELAY_S).values())) < 3.5
        if second % every == 0:
            sent_s = flight.now_s + 0.4
            forged = location(0.0, flight.east_m + 6.0, math.floor(10.0 * (sent_s + step_s)) / 10.0, 15.0)
            flight.hear(sent_s, forged)
        assert abs(flight.places(0.7)["X"]) < 3.5
