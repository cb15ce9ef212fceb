"""Questions for the vehicle's clock, and which answers give a reading."""

from __future__ import annotations

import math

import pytest

from companion.autopilot.polled.timesync import TimeSync, nanoseconds, read_timesync, timesync
from companion.events import ClockRead


def test_a_question_is_due_once_a_second_and_at_once_after_a_restart() -> None:
    clock = TimeSync()
    asked = [now_s for now_s in (10.0, 10.5, 10.99, 11.0, 11.5, 12.0) if clock.due(now_s) is not None]
    assert asked == [10.0, 11.0, 12.0]
    clock.restart()
    assert clock.due(12.1) == 12_100_000_000


def test_two_questions_of_one_moment_are_one() -> None:
    clock = TimeSync()
    assert clock.ask(10.0) == nanoseconds(10.0) == 10_000_000_000
    assert clock.ask(10.0) is None
    assert clock.ask(10.1) is not None


@pytest.mark.parametrize(("round_trip_s", "read"), [(0.0, True), (0.49, True), (0.51, False), (-0.01, False)])
def test_an_answer_within_half_a_second_is_a_reading(round_trip_s: float, read: bool) -> None:
    clock = TimeSync()
    question = clock.ask(10.0)
    assert question is not None
    answer = clock.answered(70_500_000_000, question, 10.0 + round_trip_s)
    made = ClockRead(time_boot_s=70.5, asked_s=10.0, heard_s=10.0 + round_trip_s)
    assert answer == (made if read else None)
    # A late answer too shows that the vehicle reads what it is sent.
    assert clock.answered_s == 10.0
    assert clock.round_trip_s == pytest.approx(round_trip_s)


def test_each_question_is_answered_once_and_by_a_clock_that_runs() -> None:
    clock = TimeSync()
    question = clock.ask(10.0)
    assert question is not None
    assert clock.answered(1, question + 1, 10.1) is None
    assert clock.answered(-1, question, 10.1) is None
    assert clock.answered_s is None
    assert clock.answered(0, question, 10.1) == ClockRead(time_boot_s=0.0, asked_s=10.0, heard_s=10.1)
    assert clock.answered(0, question, 10.9) is None


@pytest.mark.parametrize(("gap_s", "readings"), [(0.45, 1), (0.55, 2)])
def test_readings_are_half_a_second_apart_or_more(gap_s: float, readings: int) -> None:
    clock = TimeSync()
    found = []
    for now_s in (10.0, 10.0 + gap_s):
        question = clock.ask(now_s)
        assert question is not None
        found.append(clock.answered(5, question, now_s))
    assert sum(reading is not None for reading in found) == readings


def test_the_latest_question_that_was_answered_counts_whatever_the_order_of_answers() -> None:
    clock = TimeSync()
    questions = [clock.ask(now_s) for now_s in (10.0, 10.2)]
    for question in reversed(questions):
        assert question is not None
        clock.answered(5, question, 10.3)
    assert clock.answered_s == 10.2


@pytest.mark.parametrize(("later_s", "open_still"), [(29.9, True), (30.1, False)])
def test_a_question_is_forgotten_after_thirty_seconds(later_s: float, open_still: bool) -> None:
    clock = TimeSync()
    question = clock.ask(10.0)
    assert question is not None
    clock.ask(10.0 + later_s)
    clock.answered(5, question, 10.0 + later_s)
    assert clock.answered_s == (10.0 if open_still else None)


def test_no_question_survives_a_restart() -> None:
    clock = TimeSync()
    question = clock.ask(10.0)
    clock.restart()
    assert question is not None
    assert clock.answered(5, question, 10.1) is None
    assert clock.answered_s is None


def test_fields_on_the_wire() -> None:
    """The targets are an extension, of which trailing zeros are left out."""
    _, payload = timesync(0x0102030405060708, -2, 3, 191)
    assert payload == bytes.fromhex("0807060504030201 feffffffffffffff 03 bf")
    assert read_timesync(payload) == (0x0102030405060708, -2, 3, 191)
    assert read_timesync(payload[:16]) == (0x0102030405060708, -2, 0, 0)
    assert read_timesync(payload + b"more") == (0x0102030405060708, -2, 3, 191)
    assert math.isclose(nanoseconds(1.5), 1.5e9)
