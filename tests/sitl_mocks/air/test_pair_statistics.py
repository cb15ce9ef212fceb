"""Age of information, compared with values computed by hand."""

from __future__ import annotations

import pytest

from sitl_mocks.air.pair_statistics import PairStats, information_age


def test_age_of_information_is_a_saw_tooth() -> None:
    pair = PairStats()
    pair.refresh(1.0, 0.8)
    pair.refresh(2.0, 1.9)  # had grown to 1.2
    pair.end(4.0)  # grows to 2.1
    assert pair.observed_s == 3.0
    assert pair.information_age_mean_s == pytest.approx(((0.2 + 1.2) / 2 * 1.0 + (0.1 + 2.1) / 2 * 2.0) / 3.0)
    assert pair.information_age_max_s == pytest.approx(2.1)
    assert pair.first_heard_s == 1.0


def test_what_is_older_than_what_is_known_changes_nothing() -> None:
    fresh, overtaken = PairStats(), PairStats()
    for pair in (fresh, overtaken):
        pair.refresh(2.0, 1.9)
    overtaken.refresh(2.5, 1.0)
    for pair in (fresh, overtaken):
        pair.end(3.0)
    assert overtaken == fresh


def test_a_gap_between_leaving_and_coming_back_is_not_counted() -> None:
    pair = PairStats()
    pair.refresh(1.0, 1.0)
    pair.end(2.0)
    pair.end(50.0)
    pair.refresh(60.0, 59.5)
    pair.end(61.0)
    assert pair.observed_s == 2.0
    assert pair.information_age_mean_s == pytest.approx((0.5 * 1.0 + (0.5 + 1.5) / 2 * 1.0) / 2.0)
    assert pair.information_age_max_s == pytest.approx(1.5)
    assert pair.first_heard_s == 1.0


def test_who_was_never_heard_has_no_age() -> None:
    pair = PairStats()
    pair.end(10.0)
    row = pair.to_dict()
    assert row["first_heard_s"] is row["information_age_mean_s"] is row["information_age_max_s"] is None


def test_ages_in_words() -> None:
    heard, mute = PairStats(), PairStats()
    heard.refresh(1.0, 1.0)
    heard.end(3.0)
    assert information_age([mute.to_dict()]) == "no aircraft received another"
    assert information_age([heard.to_dict()]) == "age of information: mean 1.00 s, maximum 2.0 s"
    assert information_age([heard.to_dict(), mute.to_dict()]).endswith("; 1 of 2 pairs received nothing")


def test_heard_at_the_very_end_there_is_a_largest_age_and_no_mean() -> None:
    pair = PairStats()
    pair.refresh(10.0, 9.0)
    pair.end(10.0)
    assert (pair.to_dict()["information_age_mean_s"], pair.information_age_max_s) == (None, 1.0)
