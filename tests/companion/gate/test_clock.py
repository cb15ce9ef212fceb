"""The gate and the vehicle's own clock: one that falls behind, and a link that becomes late."""

import pytest

from companion.events import ClockRead
from companion.gate.gate import Gate
from tests.companion.gate.authority import flying
from tests.companion.gate.flying import config


def flies_for(one, rate, seconds, *, answers=True, link_s=lambda passed_s: 0.0):
    """Time for which a vehicle may be flown whose clock runs at `rate` of ours, over a link that delays what
    comes down."""
    begin_s, clock_s = one.now_s, one.now_s - one.boot_s
    for step in range(round(seconds / 0.05)):
        passed_s = 0.05 * step
        one.now_s = begin_s + passed_s
        left_s = passed_s - link_s(passed_s)
        stamped_s = clock_s + rate * left_s
        one.boot_s = one.now_s - stamped_s
        one.position()
        one.beat()
        if answers and step % 20 == 0:
            asked_s = begin_s + left_s
            event = ClockRead(time_boot_s=stamped_s, asked_s=asked_s, heard_s=one.now_s)
            one.gate.hear(event, one.now_s)
        one.gate.emptied(one.now_s)
        one.gate.decided(one.now_s)
        if not one.flies():
            return passed_s
    return seconds


@pytest.mark.parametrize(
    ("rate", "answers", "least_s", "most_s"),
    [
        (0.967, True, 200.0, 200.0),
        (0.951, True, 200.0, 200.0),
        (0.967, False, 14.0, 17.0),
        (0.9, True, 8.0, 12.0),
        (1.002, True, 200.0, 200.0),
    ],
)
def test_a_clock_that_falls_behind_is_believed_if_answers_prove_it(rate, answers, least_s, most_s):
    assert least_s <= flies_for(flying(), rate, 200.0, answers=answers) <= most_s


@pytest.mark.parametrize("rate", [1.0, 0.97])
def test_a_link_that_becomes_late_is_late_whatever_the_answers_say(rate):
    """The delay grows by 2 % from 20 s on. Half a second later the messages are late."""
    found_s = flies_for(flying(), rate, 90.0, link_s=lambda passed_s: 0.02 * max(passed_s - 20.0, 0.0))
    assert 43.0 < found_s < 50.0


def test_an_answer_of_long_ago_or_of_another_clock_moves_nothing():
    one = flying()
    assert flies_for(one, 1.0, 10.0) == 10.0
    for boot_s in (-1e9, 0.0, 1e9):
        one.gate.hear(ClockRead(time_boot_s=boot_s, asked_s=one.now_s - 0.01, heard_s=one.now_s), one.now_s)
    one.now_s += 1.0
    one.position(age_s=0.9)
    one.beat()
    one.gate.emptied(one.now_s)
    one.gate.decided(one.now_s)
    assert not one.flies()


def test_why_messages_may_be_old_in_words():
    gate, one = Gate(config()), flying()
    gate.emptied(10.0)
    assert gate.behind_because(10.0) == ("no message of the vehicle has arrived", False)
    assert gate.behind_because(10.3) == ("the vehicle's messages were not read in time here", False)
    for age_s in (0.2, 0.4, 0.6):
        one.now_s += 0.21
        one.position(age_s)
        one.gate.emptied(one.now_s)
    why = "by its own clock, the vehicle's messages arrive 0.6 s late (allowed: up to 0.5 s)"
    assert one.gate.behind_because(one.now_s) == (why, True)
    one.position()
    why = "no message has shown the vehicle's mode since its messages were last late or missing"
    assert one.gate.behind_because(one.now_s) == (why, False)
    heard_s = one.now_s
    for silent_s in (3.0, 60.0):
        one.now_s = heard_s + silent_s
        one.gate.emptied(one.now_s)
        why = f"the vehicle has sent nothing for {silent_s:.1f} s"
        assert one.gate.behind_because(one.now_s) == (why, False)
