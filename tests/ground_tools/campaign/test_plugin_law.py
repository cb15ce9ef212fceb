"""The law of a plug-in in the campaign: flights, and refused encounters."""

from __future__ import annotations

import json

import pytest
from msgspec.structs import replace

from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign.cells import Cell
from tests.support import plugged

CELL = Cell(generator="crossing", aircraft=3, delay_s=(1.0, 2.0))


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    """Install the laws of `plugged.LAWS`."""
    monkeypatch.syspath_prepend(str(tmp_path))
    plugged.forget("plugged_laws")
    plugged.laws(tmp_path)
    yield tmp_path
    plugged.forget("plugged_laws")


def test_a_law_that_follows_the_path_flies_as_without_avoidance():
    mine, none = (campaign.fly(replace(CELL, law=law), [2])[0] for law in ("follow", "none"))
    assert mine.separation_m == pytest.approx(none.separation_m, abs=1e-3)
    assert mine.deviation_m == pytest.approx(none.deviation_m, abs=1e-3)
    assert mine.separation_m < campaign.SEPARATION_M


def test_a_class_of_a_module_flies_as_the_plug_in_of_that_class():
    by_module, by_name = (
        campaign.fly(replace(CELL, law=law), [2])[0] for law in ("plugged_laws:Aside", "aside")
    )
    assert by_module.separation_m == by_name.separation_m
    assert by_module.deviation_m == by_name.deviation_m


def test_a_law_that_avoids_changes_the_flight(capsys):
    options = [
        "campaign",
        "run",
        "--generator",
        "crossing",
        "--aircraft",
        "3",
        "--law",
        "aside",
        "--seeds",
        "2-2",
    ]
    assert cli.main([*options, "--processes", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["min_separation_m"] > found["unavoided_median_min_separation_m"] + 1.0


def test_a_law_that_fails_ends_the_campaign(capsys):
    options = [
        "campaign",
        "run",
        "--generator",
        "crossing",
        "--aircraft",
        "3",
        "--law",
        "raises",
        "--seeds",
        "2-2",
    ]
    assert cli.main([*options, "--processes", "1"]) == 2
    assert (
        'law "raises" (plugged_laws:Raises of plugged_laws 1.0) failed: RuntimeError'
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--signal"], "cannot be combined with --signal"),
        (["--world", "blackout"], "cannot be combined with --signal, --world blackout or mute"),
        (["--intruders", "0.5", "--intruder", "turning"], "intruders other than blind, twin, clone"),
        (["--worst", "1"], "--worst cannot be combined with --law aside"),
    ],
)
def test_cells_that_a_plugin_law_cannot_fly_are_refused(options, words, capsys):
    command = [
        "campaign",
        "run",
        "--generator",
        "crossing",
        "--aircraft",
        "3",
        "--law",
        "aside",
        "--seeds",
        "1-1",
    ]
    assert cli.main([*command, *options]) == 2
    assert words in capsys.readouterr().err


def test_scenarios_need_a_record_of_the_flight(capsys):
    command = ["campaign", "scenarios", "parking", "--laws", "aside", "--seeds", "1-1", "--processes", "1"]
    assert cli.main(command) == 2
    assert "law aside: the flights of a plug-in's law are not recorded" in capsys.readouterr().err


def test_kept_rows_belong_to_the_code_of_the_plug_in(site):
    before = campaign.software_of([replace(CELL, law="aside")])
    assert before.startswith(campaign.software(twins=True, peers=True))
    (site / "plugged_laws.py").write_text(plugged.LAWS + "\n# another version\n")
    assert campaign.software_of([replace(CELL, law="aside")]) != before
    assert campaign.software_of([CELL]) == campaign.software()


def test_an_unknown_law_is_answered_with_all_that_are_known(capsys):
    command = ["campaign", "run", "--generator", "crossing", "--law", "dmcua", "--seeds", "1-1"]
    assert cli.main(command) == 2
    text = capsys.readouterr().err
    assert "--law: dmcua is unknown; allowed: dmuca, paper, none, orca" in text
    assert "daidalus, omniscient, aside, " in text
