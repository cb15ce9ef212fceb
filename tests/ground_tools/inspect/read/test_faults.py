"""Faults are separated from ordinary events that look like faults."""

from __future__ import annotations

import pytest

from companion.config import Config, IdentityConfig
from companion.events import AuthorityChanged, Say, Severity, TrackFlagged, VehicleText
from ground_tools.inspect.read.faults import faults
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import headline, terminal
from ground_tools.inspect.report.summary import describe
from tests.ground_tools.inspect.flights import read, step, write

ONE = Config(identity=IdentityConfig(uas_id="ONE"))


def told(folder, *things):
    """The faults and the ordinary events in a record with the given events at 1 s, 2 s and so on."""
    steps = []
    for k, thing in enumerate(things, start=1):
        events = (thing,) if isinstance(thing, VehicleText) else ()
        steps.append(step(float(k), *(() if events else (thing,)), events=events))
    return faults(read(folder, ONE, [step(0.0), *steps]), 0.0)


@pytest.mark.parametrize(
    "text",
    [
        "Initialising APM...",
        "GROUND START",
        "Calibrating barometer",
        "barometer calibration complete",
        "Barometer 1 calibration complete",
        "beginning INS calibration. Do not move plane",
        "ArduCopter V3.2.1 (36b405fb)",
        "PX4: 1d1849d3 NuttX: 1a99ba58",
    ],
)
def test_start_up_messages_are_ordinary_whatever_their_severity(tmp_path, text):
    bad, ordinary = told(tmp_path, VehicleText(severity=1, text=text))
    assert bad == []
    assert [(row["what"], row["text"]) for row in ordinary] == [("vehicle starts", text)]


@pytest.mark.parametrize(
    "text",
    ["Barometer calibration failed", "PreArm: Need 3D Fix", "Low Battery!", "Crash: Disarming", "Bad GPS"],
)
def test_other_loud_messages_are_faults(tmp_path, text):
    bad, ordinary = told(tmp_path, VehicleText(severity=1, text=text))
    assert [row["text"] for row in bad] == [text]
    assert ordinary == []


def test_a_start_up_message_of_low_severity_is_not_listed(tmp_path):
    assert told(tmp_path, VehicleText(severity=6, text="GROUND START")) == ([], [])


def change(previous, state, trigger):
    return AuthorityChanged(previous=previous, state=state, trigger=trigger, reason="the pilot chose LAND")


@pytest.mark.parametrize(
    ("previous", "state", "trigger", "fault"),
    [
        ("guarding", "yielded", "pilot", False),
        ("recovering", "yielded", "pilot", False),
        ("avoiding", "yielded", "pilot", True),
        ("guarding", "yielded", "spent", True),
        ("guarding", "fault", "unfit", True),
        ("guarding", "standby", "release", None),
    ],
)
def test_a_pilot_who_takes_over_at_the_end_is_no_fault(tmp_path, previous, state, trigger, fault):
    bad, ordinary = told(tmp_path, change(previous, state, trigger))
    assert (len(bad), len(ordinary)) == {True: (1, 0), False: (0, 1), None: (0, 0)}[fault]


def test_a_change_of_authority_is_reported_once(tmp_path):
    said = Say(severity=Severity.WARNING, text="DMUCA fault: no GNSS")
    other = Say(severity=Severity.WARNING, text="DMUCA: ADS-B full (200)")
    bad, _ = told(tmp_path, change("guarding", "fault", "unfit"), said, other)
    assert [row["what"] for row in bad] == ["authority: fault", "companion"]


def test_a_doubt_that_is_withdrawn_is_one_row_with_its_end_and_meaning(tmp_path):
    flag = {"track_id": "TWO", "flag": "remote_id_failure"}
    words = "it reports a failure of its Remote ID system"
    bad, _ = told(
        tmp_path,
        TrackFlagged(text=words, **flag),
        TrackFlagged(text=f"no longer: {words}", **flag),
        TrackFlagged(text="no longer: it is late", track_id="TWO", flag="other"),
    )
    (row,) = bad
    assert (row["time_s"], row["until_s"]) == (1.0, 2.0)
    assert row["text"] == f"{words}; a companion reports this while it has no position to send"


@pytest.mark.parametrize("withdrawn", [True, False])
def test_the_first_lines_say_what_a_doubt_means(tmp_path, withdrawn):
    flag = {"track_id": "TWO: B", "flag": "remote_id_failure"}
    words = "it reports a failure of its Remote ID system"
    steps = [step(0.0), step(1.0, TrackFlagged(text=words, **flag))]
    steps += [step(2.0, TrackFlagged(text=f"no longer: {words}", **flag))] if withdrawn else []
    write(tmp_path, ONE, steps)
    (line,) = (line for line in headline.verdicts(describe(read_run(tmp_path))) if line.startswith("Faults"))
    doubt = f"track TWO: B: {words}"
    assert line == "Faults and warnings: " + (
        f"0; doubts that were withdrawn: {doubt}" if withdrawn else f"1; {doubt}"
    )


def test_repeated_faults_are_one_row_and_are_counted(tmp_path):
    steps = [step(float(k), events=(VehicleText(severity=3, text="ODID: lost"),)) for k in range(8)]
    write(tmp_path, ONE, steps)
    figures = describe(read_run(tmp_path))
    assert "Faults and warnings: 8; vehicle: ODID: lost (8)" in headline.verdicts(figures)
    (row,) = dict(terminal.sections(figures))["Faults and warnings"][1:]
    assert row == ["ONE", "0.0", "7.0", "8", "vehicle", "ODID: lost"]


def test_of_many_faults_three_are_named_and_the_rest_counted(tmp_path):
    steps = [step(float(k), events=(VehicleText(severity=3, text=f"fault {k}"),)) for k in range(5)]
    write(tmp_path, ONE, steps)
    figures = describe(read_run(tmp_path))
    named = "vehicle: fault 0, vehicle: fault 1, vehicle: fault 2, 2 more"
    assert f"Faults and warnings: 5; {named}" in headline.verdicts(figures)
    assert headline.head({**figures, "positions": "truth"}).endswith("distances from truth")
    assert headline.head({**figures, "positions": ""}).endswith("distances from no positions")


def test_notes_are_no_damage(tmp_path):
    write(tmp_path, ONE, [step(0.0), step(1.0)])
    figures = describe(read_run(tmp_path))
    assert headline.damage(figures) == []
    assert any("no Remote ID was heard" in words for words in headline.notes(figures))


def test_a_word_not_in_a_text_makes_no_line_red(tmp_path):
    write(tmp_path, ONE, [step(0.0, events=(VehicleText(severity=1, text="EKF NOT LOST"),)), step(1.0)])
    assert not any(map(headline.is_bad, headline.verdicts(describe(read_run(tmp_path)))))


def test_piped_tables_cut_no_word(tmp_path):
    name = "A" * 38
    text = "x" * 30 + " " + "y" * 30
    config = Config(identity=IdentityConfig(uas_id="1596B0000DMUCA0001"))
    steps = [step(float(k), events=(VehicleText(severity=3, text=f"{name} {text}"),)) for k in range(3)]
    write(tmp_path, config, steps)
    shown = terminal.text(describe(read_run(tmp_path))).split()
    assert {name, "x" * 30, "y" * 30} <= set(shown)


@pytest.mark.parametrize(
    ("missing_percent", "silences", "words"),
    [(63.2, 0, "thinned log?"), (63.2, 2, ""), (3.0, 0, "")],
)
def test_messages_missing_from_a_thinned_log_are_not_reported_as_lost(
    tmp_path, missing_percent, silences, words
):
    write(tmp_path, ONE, [step(0.0), step(1.0)])
    figures = describe(read_run(tmp_path))
    figures["aircraft"][0]["link"] = [
        {
            "component": "1/1", "frames": 100, "missing": 172, "missing_percent": missing_percent,
            "silences": silences, "longest_silence_s": 4.0 if silences else None,
        }
    ]  # fmt: skip
    sections = dict(terminal.sections(figures))
    (row,) = sections["Telemetry link (absent: gaps in the sequence numbers, lost or not logged)"][1:]
    assert row[-1] == words
    assert not any("172" in line for line in headline.verdicts(figures))
