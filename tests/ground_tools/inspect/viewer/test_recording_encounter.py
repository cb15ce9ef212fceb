"""The recording's encounter: its content, and how it is written in pieces."""

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from companion.event_record import Step
from ground_tools.inspect.read.flown import flown, separations
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.viewer import drawing, recording, scene, writer
from ground_tools.inspect.viewer.scene import PIECE_S, Encounter, Scene, first_encounter
from tests.ground_tools.inspect.viewer.reading import ENCOUNTER, WHOLE, Read
from tests.support import needs

pytestmark = needs.rerun


def test_the_encounter_counts_from_the_first_conflict_and_contains_its_surroundings(
    found: Read, built: Path
) -> None:
    run = read_run(built)
    conflicts = run.aircraft[0].facts.decisions
    first = conflicts.now_s[conflicts.conflict][0]
    rows = found.column("/aircraft/DMUCA001/own", "positions", ENCOUNTER)
    whole = dict(found.column("/aircraft/DMUCA001/own", "positions"))
    assert rows[0][0] == pytest.approx(-10.0, abs=0.1)
    assert rows[-1][0] == pytest.approx(conflicts.now_s[conflicts.conflict][-1] + 20.0 - first, abs=0.2)
    now = next(points for time, points in rows if abs(time) < 1e-6)
    assert now == whole[first]
    # States persist: the state before the encounter is repeated at its start.
    states = found.column("/authority/DMUCA001", "state", ENCOUNTER)
    assert [(time, state) for time, (state,) in states] == [(-10.0, "watching"), (-10.0, "flying")]


def test_every_line_is_in_the_encounter_too(built: Path, tmp_path: Path) -> None:
    """The encounter begins later than the run. Distances extend to the beginning of the next part."""
    run = read_run(built)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "first_encounter", lambda *_: Encounter(25.3, 30.0, 40.0, "the closest"))
        recording.write(run, tmp_path / "one.rrd")
    found = Read(tmp_path / "one.rrd")
    lines = [entity for entity in found.batches if entity.startswith(("/separation/", "/speed/"))]
    assert sum(entity.startswith("/separation/") for entity in lines) == 3
    for entity in lines:
        times = [time for time, _ in found.column(entity, "scalars", ENCOUNTER)]
        assert times[0] < -3.5, entity
        assert times[-1] > 9.0, entity


@pytest.mark.parametrize(
    ("conflicts", "bounds"),
    [
        ([50.0, 41.0, 60.0, 90.0, 150.0], (31.0, 41.0, 80.0)),
        ([5.0], (-5.0, 5.0, 25.0)),
        ([float(t) for t in range(0, 1000, 10)], (-10.0, 0.0, 300.0)),
    ],
)
def test_an_encounter_ends_after_a_time_without_conflict(
    conflicts: list[float], bounds: tuple[float, ...]
) -> None:
    one = first_encounter(np.array(conflicts), None)
    assert one is not None
    assert (one.start_s, one.zero_s, one.end_s) == bounds
    assert first_encounter(np.zeros(0), None) is None


def test_without_a_conflict_the_encounter_is_the_closest_approach(built: Path) -> None:
    (pair,) = separations(flown(read_run(built)).paths)
    one = first_encounter(np.zeros(0), pair)
    assert one is not None
    assert one.zero_s == pair.minimum_time_s
    assert one.clipped(np.array([-100.0, 32.0, 100.0])) == pytest.approx([-40.0, 0.0, 40.0], abs=0.1)


def test_pieces_end_at_the_encounters_ends() -> None:
    """A piece is either entirely inside the encounter or entirely outside."""
    one = Scene((0.0, 0.0, 0.0), (), first_encounter(np.array([40.0]), None))
    time = np.arange(0.0, PIECE_S + 30.0, 0.5)
    parts = one.pieces(time)
    assert [time[part][0] for part in parts] == [0.0, 30.0, 60.5, PIECE_S]
    assert [one.piece(time[part][0])[1] for part in parts] == [False, True, False, False]
    for part in parts:
        assert len({one.piece(t) for t in time[part]}) == 1


def test_a_position_is_not_drawn_when_no_other_follows() -> None:
    times, lengths = drawing.until_stale(np.array([0.0, 1.0, 9.0]), np.array([1, 2, 1]))
    assert (times.tolist(), lengths.tolist()) == ([0.0, 1.0, 4.0, 9.0], [1, 2, 0, 1])


def test_a_silence_across_pieces_is_blank(
    tmp_path: Path, made: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no data from 25 to 35 s, and two pieces meet at 30 s."""
    monkeypatch.setattr(scene, "PIECE_S", 30.0)
    steps = [step for step in made.steps(made.northbound, made.eastbound(500.0)) if not 25 < step.now_s < 35]
    made.write_events(tmp_path, "a", steps)
    recording.write(read_run(tmp_path), tmp_path / "a.rrd")
    rows = dict(Read(tmp_path / "a.rrd").column("/aircraft/a/own", "positions"))
    blank = [time for time, points in rows.items() if not points]
    assert blank == [pytest.approx(28.0), pytest.approx(63.0)]


def test_the_size_of_a_write_is_bounded_and_nothing_is_lost(
    tmp_path: Path, made: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This holds for long pieces and for pieces with many tracks: 601 steps, and a track at 5 Hz."""
    monkeypatch.setattr(recording, "MOST_TAKEN", 100)
    made.write_events(tmp_path, "a", made.steps(made.northbound, made.eastbound(500.0)))
    run = read_run(tmp_path)
    lengths: list[int] = []
    write = writer.Writer.steps

    def counted(self: writer.Writer, name: str, steps: Iterable[Step]) -> None:
        several = list(steps)
        lengths.append(len(several))
        write(self, name, several)

    monkeypatch.setattr(writer.Writer, "steps", counted)
    recording.write(run, tmp_path / "a.rrd")
    assert sum(lengths) == 601
    assert max(lengths) <= 100
    assert len(lengths) >= 9
    rows = Read(tmp_path / "a.rrd").column("/aircraft/a/own", "positions")
    assert len([time for time, points in rows if points]) == 601


def test_parts_of_a_line_are_sent_together_but_for_the_encounter(
    tmp_path: Path, made: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The encounter is a separate part; before and after it there are several pieces each."""
    made.write_events(tmp_path, "a", made.steps(made.northbound, made.eastbound(500.0)))
    run = read_run(tmp_path)
    one = scene.Encounter(25.0, 30.0, 40.0, "the closest approach")
    monkeypatch.setattr(recording, "first_encounter", lambda *_: one)
    recording.write(run, tmp_path / "whole.rrd")
    monkeypatch.setattr(scene, "PIECE_S", 4.0)
    recording.write(run, tmp_path / "pieces.rrd")
    monkeypatch.setattr(drawing, "HELD_ROWS", 1)
    recording.write(run, tmp_path / "at_once.rrd")
    whole, pieces, at_once = (Read(tmp_path / f"{name}.rrd") for name in ("whole", "pieces", "at_once"))
    entity = "/speed/a/flown"
    assert len(at_once.batches[entity]) > 15
    assert len(pieces.batches[entity]) == 3
    for line in (WHOLE, ENCOUNTER):
        rows = pieces.column(entity, "scalars", line)
        assert len(rows) > 50
        assert rows == whole.column(entity, "scalars", line) == at_once.column(entity, "scalars", line)
