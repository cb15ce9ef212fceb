"""COLLISION and STATUSTEXT messages of alerts."""

from __future__ import annotations

import pytest

from companion.avoidance.alerts import Level
from companion.events import AlertChanged, Say, Severity, Threat
from tests.companion.avoidance.alerts.test_alerts import Looks, decision, other, view

PERIOD_S = 0.2
OWN, SPEED = (0.0, 0.0, -50.0), (10.0, 0.0, 0.0)
NONE, ADVISORY, CAUTION, WARNING = 100.0, 25.0, 15.0, 5.0
"""Times to loss (s) that are seen as these levels."""


# ------------------------------------------------------------ COLLISION


def test_a_threat_is_told_once_a_second_while_it_lasts_and_once_at_its_end():
    looks = Looks()
    looks.see(*[WARNING] * 26, *[NONE] * 60)
    told = looks.of(Threat)
    # The level is held for 8 s after the last look at 5.0 s; then a Threat of level 0 ends it.
    assert [c.level for _, c in told] == [2] * 13 + [0]
    assert [at_s for at_s, _ in told[:-1]] == pytest.approx([float(k) for k in range(13)])
    assert told[-1][0] == pytest.approx(13.0, abs=PERIOD_S)


def test_a_fall_to_advisory_is_a_threats_end():
    looks = Looks()
    looks.see(*[WARNING] * 3, *[ADVISORY] * 60)
    assert [level for _, level in looks.changes()] == [3, 1]
    assert [c.level for _, c in looks.of(Threat)][-2:] == [2, 0]
    ends = [at_s for at_s, c in looks.of(Threat) if c.level == 0]
    assert ends == [looks.changes()[1][0]]


@pytest.mark.parametrize("parting", [True, False], ids=["clear", "not heard any more"])
def test_an_end_is_told_also_while_five_others_are(parting):
    looks = Looks()
    others = [other(WARNING, f"W{number}") for number in range(5)]
    looks.look(other(WARNING, "A"))
    while looks.level("A"):
        late = others if looks.now_s >= 4.0 else []
        looks.look(*([other(NONE, "A")] if parting or looks.now_s < 5.0 else []), *late)
    for _ in range(20):
        looks.look(*others)
    assert [c.level for _, c in looks.of(Threat) if c.track_id == "A"].count(0) == 1


def test_levels_of_threats():
    looks = Looks()
    looks.see(*[CAUTION] * 3, *[WARNING] * 6)
    assert [c.level for _, c in looks.of(Threat)] == [1, 2]


def test_an_advisory_is_never_a_threat_and_has_no_end():
    looks = Looks()
    looks.see(*[ADVISORY] * 10, *[NONE] * 60)
    assert [level for _, level in looks.changes()] == [1, 0]
    assert looks.of(Threat) == []
    assert looks.of(Say) == []


def test_what_a_threat_says():
    near = other(0.0, "4B1234", position_ned_m=(40.0, 6.0, -47.0), adsb=True)
    result = decision(view("4B1234", adsb=True))
    (threat,) = [c for c in Looks().look(near, result=result) if isinstance(c, Threat)]
    assert threat == Threat(
        track_id="4B1234",
        adsb=True,
        level=2,
        acting=True,
        time_to_closest_s=pytest.approx(4.0),
        horizontal_m=pytest.approx(6.0),
        vertical_m=pytest.approx(3.0),
    )


def test_at_most_five_are_told_at_a_time_the_most_urgent_first():
    looks = Looks()
    warnings = [other(9.0 - number, f"W{number}") for number in range(4)]
    cautions = [other(12.0 + number, f"C{number}") for number in range(4)]
    for _ in range(2):
        looks.look(*cautions)
    told = [c.track_id for c in looks.look(*cautions, *warnings) if isinstance(c, Threat)]
    assert told == ["W3", "W2", "W1", "W0", "C0"]


# ------------------------------------------------------------ STATUSTEXT


def test_of_what_rises_together_the_most_urgent_is_said():
    looks = Looks()
    for _ in range(2):
        looks.look(other(CAUTION, "A"))
    commands = looks.look(other(CAUTION, "A"), other(WARNING, "B"))
    (said,) = [c for c in commands if isinstance(c, Say)]
    assert said.severity is Severity.WARNING
    assert said.text.startswith("DMUCA warning B: closest ")


def test_a_caution_is_a_notice():
    looks = Looks()
    looks.see(*[CAUTION] * 3)
    ((_, said),) = looks.of(Say)
    assert said.severity is Severity.NOTICE
    assert said.text.startswith("DMUCA caution X: ")


def test_not_more_than_one_text_a_second():
    looks = Looks()
    present = []
    for number in range(20):
        present.append(other(WARNING, f"X{number}"))
        looks.look(*present)
    assert len(looks.of(AlertChanged)) == 20
    assert [at_s for at_s, _ in looks.of(Say)] == pytest.approx([0.0, 1.0, 2.0, 3.0])


def test_a_warning_within_a_second_of_another_text_is_said_later():
    looks = Looks()
    looks.see(*[CAUTION] * 3, *[WARNING] * 20)
    assert looks.texts() == ["caution X", "warning X"]
    (first_s, _), (second_s, _) = looks.of(Say)
    assert second_s == pytest.approx(first_s + 1.0)


def test_every_warning_is_said_and_only_the_first_caution():
    looks = Looks()
    cautions = [other(CAUTION, f"C{number}") for number in range(3)]
    for _ in range(10):
        looks.look(*cautions)
    warnings = [other(WARNING, f"W{number}") for number in range(3)]
    for _ in range(30):
        looks.look(*cautions, *warnings)
    assert looks.texts() == ["caution C0", "warning W0", "warning W1", "warning W2"]


def test_a_fall_to_caution_is_not_said():
    looks = Looks()
    looks.see(*[WARNING] * 3, *[CAUTION] * 60)
    assert [level for _, level in looks.changes()] == [3, 2]
    assert looks.texts() == ["warning X"]
    looks.see(*[WARNING] * 20)
    assert looks.texts() == ["warning X"], "it was said, and has not been over since"


def test_when_all_is_over_that_is_said_once():
    looks = Looks()
    looks.look(other(WARNING, "A"), other(WARNING, "B"))
    for _ in range(10):
        looks.look(other(WARNING, "A"), other(WARNING, "B"))
    for _ in range(50):
        looks.look(other(NONE, "A"), other(WARNING, "B"))
    # One of two is over: not a word.
    assert looks.level("A") is Level.NONE
    assert looks.texts() == ["warning A", "warning B"]
    for _ in range(60):
        looks.look(other(NONE, "A"), other(NONE, "B"))
    (_, _, (_, last)) = looks.of(Say)
    assert (last.severity, last.text) == (Severity.INFO, "DMUCA clear of traffic")
    # And what comes then is a first caution again.
    for _ in range(3):
        looks.look(other(CAUTION, "B"))
    assert looks.texts()[3:] == ["caution B"]
