"""Recordings of several runs: aligned, in one frame, and distinguishable."""

from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import (
    Firmware,
    FlightMode,
    Heartbeat,
    Landed,
    LandedState,
)
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import compare
from ground_tools.inspect.viewer import recording
from ground_tools.inspect.viewer.palette import LIMIT
from tests.ground_tools.inspect.read.test_read_tlog import with_utc
from tests.ground_tools.inspect.viewer.reading import Read, packed, verify
from tests.support import needs

pytestmark = needs.rerun


def taking_off(steps: list[Step], at_s: float) -> list[Step]:
    """The same steps, armed at the start and in the air from a given time on; no timed path that starts at a
    UTC."""
    armed = Heartbeat(
        system_id=1, firmware=Firmware.PX4, vehicle_type=2, custom_mode=0, mode=FlightMode.OTHER, armed=True
    )
    changed = []
    for step in steps:
        landed = Landed.IN_AIR if step.now_s >= at_s else Landed.ON_GROUND
        events = (armed, LandedState(landed=landed), *step.events)
        changed.append(msgspec.structs.replace(step, events=events))
    return changed


def test_runs_are_compared_from_their_take_off(tmp_path: Path, made: SimpleNamespace) -> None:
    """The same flight twice, with the clock of one record shifted by 100 s; in the air 7 s after its
    start."""
    for name, clock_s in (("first", 0.0), ("second", 100.0)):
        steps = made.steps(made.northbound, made.eastbound(20.0), clock_s, utc=False)
        made.write_events(tmp_path / name, "a", taking_off(steps, clock_s + 7.0))
    runs = [read_run(tmp_path / name) for name in ("first", "second")]
    recording.write_comparison(runs, tmp_path / "both.rrd")
    assert verify(tmp_path / "both.rrd").returncode == 0
    found = Read(tmp_path / "both.rrd")
    one, two = (found.column(f"/runs/{name}/aircraft/a/own", "positions") for name in ("first", "second"))
    assert one[0][0] == pytest.approx(-7.0)
    assert [time for time, _ in one] == pytest.approx([time for time, _ in two], abs=1e-6)
    assert [points for _, points in one[:-1]] == [points for _, points in two[:-1]]
    shades = {found.fixed(f"/runs/{name}/aircraft/a/own", "colors")[0] for name in ("first", "second")}
    assert len(shades) == 2
    assert packed(LIMIT) not in shades
    assert found.fixed("/runs/second/speed/a/flown", "names") == ["second a flown"]
    texts = [text for _, (text,) in found.column("/runs/second/events/a", "text")]
    assert all(text.startswith("second a: ") for text in texts)


def test_runs_of_timed_paths_are_compared_from_the_paths_start(tmp_path: Path, made: SimpleNamespace) -> None:
    for name, start_s in (("first", 10.0), ("second", 20.0)):
        steps = made.steps(made.northbound, made.eastbound(20.0))
        made.write_events(tmp_path / name, "a", taking_off(steps, 7.0), start_utc_s=made.utc_s + start_s)
    runs = [read_run(tmp_path / name) for name in ("first", "second")]
    recording.write_comparison(runs, tmp_path / "both.rrd")
    found = Read(tmp_path / "both.rrd")
    starts = [found.column(f"/runs/{name}/speed/a/flown", "scalars")[0][0] for name in ("first", "second")]
    assert starts == [pytest.approx(-10.0), pytest.approx(-20.0)]


def test_runs_are_drawn_in_one_frame_and_distinguishable(run_folder: Path, tmp_path: Path) -> None:
    """A run is compared with itself, so everything is drawn in the same places."""
    recording.write_comparison([read_run(run_folder)] * 2, tmp_path / "both.rrd")
    found = Read(tmp_path / "both.rrd")
    name = "/runs/20260101T000000Z\\-demo"
    roots = sorted({entity.rsplit("/aircraft")[0] for entity in found.batches if "/aircraft" in entity})
    assert len(roots) == 2
    first, second = (found.column(f"{root}/aircraft/DMUCA002/predicted", "positions") for root in roots)
    assert first == second
    assert any(root.startswith(name.split("\\")[0]) for root in roots)


def test_one_run_is_no_comparison(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="at least two runs"):
        recording.write_comparison([read_run(run_folder)], tmp_path / "one.rrd")


def test_a_clock_that_was_set_is_told_with_every_comparison(tmp_path: Path) -> None:
    runs = [with_utc(tmp_path / f"{name}.tlog", {1: 0.0}, jump) for name, jump in (("a", 0.0), ("b", 3600.0))]
    assert "problem: b: b: the clock" in compare.text(compare.compare(runs))
    recording.write_comparison(runs, tmp_path / "both.rrd")
    found = Read(tmp_path / "both.rrd")
    told = [
        any(
            "was set by about 3600 s" in text
            for _, (text,) in found.column(f"/runs/{name}/events/run", "text")
        )
        for name in ("a", "b")
    ]
    assert told == [False, True]
