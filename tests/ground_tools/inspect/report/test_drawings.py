"""Content of the report's plots, read from the matplotlib figures."""

from __future__ import annotations

import gzip
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from companion.config import Config, FlightConfig, IdentityConfig
from companion.event_record import Step
from companion.events import Broadcast, Firmware, FlightMode, GlobalPosition, Heartbeat
from ground_tools.common.figure import styled
from ground_tools.inspect.read.flown import MAX_GAP_S, flown, placed
from ground_tools.inspect.read.read_run import Run, read_run
from ground_tools.inspect.report import lanes, plots
from ground_tools.inspect.report.summary import describe
from tests.ground_tools.inspect.flights import decision, step, track, write
from tests.support.place import HOME

pytest.importorskip("matplotlib")
DATA = Path(__file__).parents[3] / "data"
ONE = Config(identity=IdentityConfig(uas_id="ONE"), flight=FlightConfig(use="fly"))


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were drawn, in their order."""
    figures = []

    def keep(size_in, draw):
        with styled(size_in, **plots._SVG) as figure:
            draw(figure)
        figures.append(figure)
        return ""

    monkeypatch.setattr(plots, "svg", keep)
    return figures


@pytest.fixture
def adsb_log(tmp_path):
    """The log of an ArduPilot that received 19 aircraft and has no own position from 0.6 to 10.8 s."""
    path = tmp_path / "ardupilot_sitl_odid_adsb.tlog"
    with gzip.open(DATA / f"{path.name}.gz") as packed, path.open("wb") as plain:
        shutil.copyfileobj(packed, plain)
    return read_run(path)


def at(now_s: float, height_m: float, north_m: float = 0.0) -> Step:
    lat, lon, alt = HOME.to_geodetic(north_m, 0.0, -height_m)
    place = GlobalPosition(
        time_boot_s=now_s,
        lat_deg=lat,
        lon_deg=lon,
        alt_msl_m=alt,
        height_above_home_m=height_m,
        velocity_ned_mps=(5.0, 0.0, 0.0),
    )
    return Step(now_s=now_s, events=(place,), commands=())


def run_of(folder: Path, steps: list[Step]) -> Run:
    write(folder, ONE, steps)
    return read_run(folder)


def legs(line) -> np.ndarray:
    """Lengths of the legs that a line draws (m)."""
    lengths = np.hypot(np.diff(line.get_xdata()), np.diff(line.get_ydata()))
    return lengths[~np.isnan(lengths)]


def test_no_leg_is_drawn_over_a_gap_without_positions(adsb_log, drawn):
    ways = flown(adsb_log)
    (path,) = ways.paths
    apart = np.diff(path.time_s)
    across = np.linalg.norm(np.diff(path.position_ned_m, axis=0), axis=1)[apart > MAX_GAP_S]
    assert (len(across), across.max()) == (1, pytest.approx(231.0, abs=5.0)), "the log has such a gap"
    plots.paths(ways, [])
    plots.heights(adsb_log, ways)
    for figure in drawn:
        line = figure.axes[0].lines[0]
        assert np.isnan(line.get_xdata()).sum() == 1
    assert legs(drawn[0].axes[0].lines[0]).max() < 3.0


def test_a_thinned_line_keeps_its_gaps_and_peaks(monkeypatch):
    monkeypatch.setattr(plots, "MOST_POINTS", 20)
    time = np.concatenate([np.arange(0.0, 50.0, 0.1), np.arange(80.0, 130.0, 0.1)])
    values = np.zeros(len(time))
    values[333], values[700] = 7.0, 9.0
    shown, kept = plots.open_at_gaps(time, values, extreme=True)
    assert len(shown) < 60
    assert np.isnan(shown).sum() == 1
    assert {7.0, 9.0} <= set(kept.tolist())
    assert shown[0] == 0.0
    assert np.nanmax(shown) == time[-1]


@pytest.mark.parametrize("count", [1203, 2401, 6004])
@pytest.mark.parametrize("index", [0, 700, -2, -1])
def test_the_least_separation_is_drawn_wherever_it_is(count, index):
    """Also if it is the last sample, as when a recording ends in a collision."""
    time, values = np.arange(float(count)), np.full(count, 100.0)
    values[index] = 1.0
    shown, kept = plots.lowest(time, values)
    assert len(shown) <= 1.5 * plots.MOST_POINTS
    assert shown[kept == 1.0].tolist() == [time[index]]


def test_a_long_flight_is_drawn_with_its_greatest_height(tmp_path, drawn):
    heights = np.full(5 * plots.MOST_POINTS, 50.0)
    heights[1002:1004], heights[2503] = 75.0, 30.0
    run = run_of(tmp_path, [at(k / 5, height) for k, height in enumerate(heights.tolist())])
    plots.heights(run, flown(run))
    line = drawn[0].axes[0].lines[0].get_ydata()
    assert (np.nanmax(line), np.nanmin(line)) == (75.0, 30.0)
    low, high = drawn[0].axes[0].get_ylim()
    assert low < 30.0 < 75.0 < high


def test_the_usual_interval_of_rare_positions_is_no_gap():
    time = np.arange(0.0, 100.0, 5.0)
    assert not np.isnan(plots.open_at_gaps(time, time)[0]).any()


def test_the_worst_age_is_on_the_axis(tmp_path, drawn):
    """The panels share one axis. The limits of a first panel with small values must not apply to the next."""
    for name, worst in (("ONE", 0.8), ("TWO", 2.96), ("THREE", 1.5)):
        config = Config(identity=IdentityConfig(uas_id=name), flight=FlightConfig(use="fly"))
        ages = [worst if k == 17 else 0.4 for k in range(40)]
        write(tmp_path, config, [step(float(k), decision(track(age_s=age))) for k, age in enumerate(ages)])
    run = read_run(tmp_path)
    plots.ages(run, flown(run))
    (figure,) = drawn
    tops = [np.nanmax(line.get_ydata()) for axes in figure.axes for line in axes.lines]
    assert sorted(tops) == pytest.approx([0.8, 1.5, 2.96])
    for axes in figure.axes:
        assert axes.get_ylim()[1] > 2.96
        assert axes.get_ylim()[0] == 0.0


@pytest.mark.parametrize("count", [6, 18, 25])
def test_every_mode_has_a_distinct_look(tmp_path, drawn, count):
    """An ordinary guarded flight has six modes."""
    beats = [Heartbeat(1, Firmware.ARDUPILOT, 2, mode, FlightMode.OTHER, True) for mode in range(count)]
    steps = [step(10.0 * k, events=(beat,)) for k, beat in enumerate(beats)]
    run = run_of(tmp_path, [*steps, step(10.0 * count)])
    figures = describe(run)["aircraft"]
    lanes.lanes(run, flown(run), figures)
    bars = drawn[0].axes[0].collections
    looks = {(tuple(bar.get_facecolor()[0]), bar.get_hatch()) for bar in bars}
    assert len(looks) == len(figures[0]["flight"]["modes"]) == count


def test_level_flight_looks_level(tmp_path, drawn):
    run = run_of(tmp_path, [at(k / 5, 50.0 + 0.004 * math.sin(k), k) for k in range(100)])
    plots.heights(run, flown(run))
    axes = drawn[0].axes[0]
    low, high = axes.get_ylim()
    assert high - low >= 10.0
    assert low < 50.0 < high
    assert "above home" in axes.get_ylabel()


def test_one_bad_altitude_is_marked_and_does_not_stretch_the_axis(tmp_path, drawn):
    heights = [40.0 + 0.5 * k for k in range(60)]
    heights[30] = -590.0
    run = run_of(tmp_path, [at(k / 5, height, k) for k, height in enumerate(heights)])
    plots.heights(run, flown(run))
    axes = drawn[0].axes[0]
    low, high = axes.get_ylim()
    assert 30.0 < low < 40.0
    assert 69.0 < high < 80.0
    line, mark = axes.lines
    assert np.nanmin(line.get_ydata()) == pytest.approx(40.0)
    assert mark.get_xdata() == pytest.approx([6.0])
    assert low < mark.get_ydata()[0] < high, "at the edge, but to be seen"
    assert mark.get_label() == "1 outside, as far as -590 m"
    assert describe(run)["aircraft"][0]["flight"]["max_height_m"] == pytest.approx(69.5)


def test_a_steep_descent_is_no_bad_altitude(tmp_path, drawn):
    heights = [*np.full(30, 300.0), *np.arange(300.0, 0.0, -6.0), *np.zeros(30)]  # 30 m/s
    run = run_of(tmp_path, [at(k / 5, float(height), float(k)) for k, height in enumerate(heights)])
    plots.heights(run, flown(run))
    assert len(drawn[0].axes[0].lines) == 1


def test_a_gap_is_not_bridged_by_the_least_separation(tmp_path, drawn):
    """One of two aircraft has no positions for 20 s in the middle."""
    for name, north in (("ONE", 0.0), ("TWO", 40.0)):
        config = Config(identity=IdentityConfig(uas_id=name), flight=FlightConfig(use="fly"))
        times = [k / 5 for k in range(300) if name == "ONE" or not 100 < k < 200]
        write(tmp_path, config, [at(t, 50.0, north + t) for t in times])
    run = read_run(tmp_path)
    from ground_tools.inspect.read.flown import separations

    plots.separation([pair for pair in separations(flown(run).paths) if pair.minimum_m is not None])
    least = next(line for line in drawn[0].axes[0].lines if line.get_label() == "minimum of all pairs")
    time = np.asarray(least.get_xdata())
    assert np.diff(time)[~np.isnan(np.diff(time))].max() < 1.0
    assert np.isnan(time).sum() == 1


def test_rates_are_open_in_silences_and_keep_the_lowest(tmp_path, drawn):
    """10 Hz, with a pause of 1.5 s and a silence of a minute."""
    times = np.arange(0.0, 1300.0, 0.1)
    times = times[~((times > 333.35) & (times < 334.75)) & ~((times > 700.05) & (times < 760.0))]
    sent = Broadcast(transport="wifi", messages=())
    run = run_of(tmp_path, [Step(now_s=float(t), events=(), commands=(sent,)) for t in times])
    plots.rates(run, placed(run))
    (line,) = drawn[0].axes[0].get_lines()
    time, rate = line.get_xdata(), line.get_ydata()
    assert len(time) < 3 * plots.MOST_POINTS
    assert np.nanmax(np.diff(time)) < 3.0
    before = time < 700.0
    assert rate[before].min() == pytest.approx(5 / 1.9, abs=0.02)
    assert np.nanmin(rate) == pytest.approx(5 / (60.0 + 0.4), abs=0.01)
