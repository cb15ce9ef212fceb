"""Flights with two of one identity: the compiled flight's world, the core's own tracks."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import vehicles
from ground_tools.campaign.cells import Cell

THREE = Cell(generator="crossing", aircraft=3, delay_s=(1.0, 2.0), intruders=0.34)
LOSSY = Cell(generator="circle", aircraft=5, intruders=0.2, loss=0.8)
"""Of whose seed 9 aircraft hear nothing of each other for 6 s before they meet."""


def same(row, other):
    assert row.separation_m == pytest.approx(other.separation_m, abs=1e-3)
    assert row.deviation_m == pytest.approx(other.deviation_m, abs=1e-3)
    assert row.path_ratio == pytest.approx(other.path_ratio, abs=1e-4)
    assert (row.manoeuvres, row.alerts, row.lost) == (other.manoeuvres, other.alerts, other.lost)


@pytest.mark.parametrize("world", ["calm", "all"])
def test_without_a_twin_it_is_the_compiled_flight(world, monkeypatch):
    """Everybody hears the own frames besides, and takes none for another's."""
    cell = replace(THREE, world=world)
    compiled = campaign.fly(cell, [2])[0]
    assert compiled.manoeuvres > 0.0
    monkeypatch.setitem(vehicles.TWINS, "blind", vehicles.BLIND)
    assert cell.twins
    same(campaign.fly(cell, [2])[0], compiled)


@pytest.mark.parametrize("kind", vehicles.TWINS)
def test_a_twin_is_avoided_as_one_with_a_name_of_its_own(kind):
    same(campaign.fly(replace(THREE, intruder=kind), [2])[0], campaign.fly(THREE, [2])[0])


@pytest.mark.parametrize("kind", ["twin", "clone"])
def test_after_a_silence_no_track_is_given_to_the_other(kind):
    assert campaign.fly(replace(LOSSY, intruder=kind), [9])[0].separation_m > campaign.SEPARATION_M


def test_its_rows_hang_on_the_tracks_code(tmp_path):
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
def test_what_a_twins_flight_cannot_do(option, message, capsys):
    args = ["campaign", "run", "--generator", "circle", "--intruders", "0.2", "--intruder", "own-twin"]
    assert cli.main([*args, *option]) != 0
    assert message in capsys.readouterr().err
