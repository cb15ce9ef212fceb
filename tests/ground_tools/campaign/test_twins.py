"""Flights in which two aircraft share an identity: the world of the compiled flight with the core's own
tracks."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import vehicles
from ground_tools.campaign.cells import Cell

THREE = Cell(generator="crossing", aircraft=3, delay_s=(1.0, 2.0), intruders=0.34)
LOSSY = Cell(generator="circle", aircraft=5, intruders=0.2, loss=0.8)
"""Cell in which, with seed 9, two aircraft receive nothing of each other for 6 s before they meet."""


def same(row, other):
    assert row.separation_m == pytest.approx(other.separation_m, abs=1e-3)
    assert row.deviation_m == pytest.approx(other.deviation_m, abs=1e-3)
    assert row.path_ratio == pytest.approx(other.path_ratio, abs=1e-4)
    assert (row.manoeuvres, row.alerts, row.lost) == (other.manoeuvres, other.alerts, other.lost)


@pytest.mark.parametrize("world", ["calm", "all"])
def test_without_twins_the_flight_equals_the_compiled_one(world, monkeypatch):
    """Every aircraft also receives its own frames, and does not mistake them for another aircraft's."""
    cell = replace(THREE, world=world)
    compiled = campaign.fly(cell, [2])[0]
    assert compiled.manoeuvres > 0.0
    monkeypatch.setitem(vehicles.TWINS, "blind", vehicles.BLIND)
    assert cell.twins
    same(campaign.fly(cell, [2])[0], compiled)


@pytest.mark.parametrize("kind", vehicles.TWINS)
def test_a_twin_is_avoided_like_an_aircraft_with_another_name(kind):
    same(campaign.fly(replace(THREE, intruder=kind), [2])[0], campaign.fly(THREE, [2])[0])


@pytest.mark.parametrize("kind", ["twin", "clone"])
def test_after_a_silence_no_track_is_assigned_to_the_wrong_aircraft(kind):
    assert campaign.fly(replace(LOSSY, intruder=kind), [9])[0].separation_m > campaign.SEPARATION_M


def test_rows_of_twins_depend_on_the_code_of_the_tracks(tmp_path):
    kept = [campaign.kept(tmp_path, replace(THREE, intruder=kind)) for kind in ("blind", "twin")]
    for file in kept:
        file.add([])
    told = [file.path.read_text() for file in kept]
    assert [campaign.software() in text for text in told] == [True, False]
    assert campaign.software(twins=True) in told[1]


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--worst", "1"], "--worst cannot be combined with"),
        (["--world", "blackout"], "--world blackout cannot be combined with"),
    ],
)
def test_unsupported_options_of_twins_are_refused(option, message, capsys):
    args = ["campaign", "run", "--generator", "circle", "--intruders", "0.2", "--intruder", "own-twin"]
    assert cli.main([*args, *option]) != 0
    assert message in capsys.readouterr().err
