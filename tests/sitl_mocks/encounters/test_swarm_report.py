"""The verdict on a run in real time fails whatever it cannot see, and every aircraft that does not fly."""

from __future__ import annotations

import numpy as np
import pytest

from companion import event_record
from companion.config import Config, IdentityConfig
from sitl_mocks.air.pair_statistics import PairStats
from sitl_mocks.encounters import swarm_report
from sitl_mocks.encounters.scenario_file import DEFAULT
from sitl_mocks.encounters.swarm_report import report_of

START_S = 1_000_000.0
SECONDS = 40.0
PATHS = {
    "A": np.array([[0.0, -50.0, 0.0, -60.0], [SECONDS, 50.0, 0.0, -60.0]]),
    "B": np.array([[0.0, 0.0, -90.0, -60.0], [SECONDS, 0.0, 10.0, -60.0]]),
}
"""Two crossing paths, whose aircraft are 28 m apart at least."""
GOOD = {"setpoints_received": 800, "setpoint_gaps_over_100ms": 0, "largest_setpoint_gap_s": 0.06}


class Flight:
    """Files and statistics of a flight in which everything is as it should be."""

    def __init__(self, folder):
        self.folder = folder
        self.times = np.arange(-2.0, SECONDS + 2.0, 0.1)
        self.places = {
            name: np.column_stack([np.interp(self.times, path[:, 0], path[:, k]) for k in (1, 2, 3)])
            for name, path in PATHS.items()
        }
        self.rows = {name: np.column_stack([START_S + self.times, self.places[name]]) for name in PATHS}
        sent = PairStats(sent=40, delivered=40).to_dict()
        self.air = {"pairs": {"A>B": sent, "B>A": sent}}
        self.heard = {"A": 40, "B": 40}
        self.vehicles = {name: dict(GOOD) for name in PATHS}
        self.bad = []

    def report(self, *, interrupted=False):
        for name, rows in self.rows.items():
            lines = [",".join(f"{value:.3f}" for value in row) + "\n" for row in rows]
            (self.folder / f"{name}.truth.csv").write_text("utc_s,north_m,east_m,down_m\n" + "".join(lines))
        times = START_S, SECONDS
        return report_of(
            self.folder, DEFAULT, self.vehicles, self.air, self.bad, PATHS, times, interrupted=interrupted
        )


@pytest.fixture
def flight(tmp_path, monkeypatch):
    made = Flight(tmp_path)
    other = {"A": "B", "B": "A"}
    monkeypatch.setattr(
        swarm_report, "_heard", lambda folder, receiver, addresses: {other[receiver]: made.heard[receiver]}
    )
    return made


def failed(report, word):
    assert not report["ok"]
    (reason,) = report["reasons"]
    assert word in reason


def test_a_good_flight_is_ok(flight):
    report = flight.report()
    assert report["ok"]
    assert report["reasons"] == []
    assert report["min_separation_m"] == pytest.approx(40.0 / np.sqrt(2.0), abs=0.02)
    assert [one["final_m"] for one in report["deviations"]] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_aircraft_that_keep_apart_because_they_do_not_fly_have_failed(flight):
    """A vehicle that ignores every setpoint is never near another."""
    for rows in flight.rows.values():
        rows[:, 1:] = rows[0, 1:]
    report = flight.report()
    assert report["min_separation_m"] > 90.0
    assert not report["ok"]
    assert [word.split(":")[0] for word in report["reasons"]] == ["A", "B"]
    assert "100.0 m from its path at the end" in report["reasons"][0]


@pytest.mark.parametrize(("final_m", "returns"), [(14.0, True), (16.0, False), (30.0, False)])
def test_an_aircraft_must_be_on_its_way_back(flight, final_m, returns):
    flight.rows["B"][:, 1] -= np.interp(flight.times, [10.0, 20.0, SECONDS], [0.0, 30.0, final_m])
    report = flight.report()
    assert report["deviations"][1]["largest_m"] == pytest.approx(30.0, abs=0.1)
    assert report["ok"] == returns
    if not returns:
        failed(report, "did not return")


def test_a_pair_that_came_near_between_two_rows_has_failed(flight):
    flight.rows["B"][:, 1:] = flight.rows["A"][:, 1:] + (0.0, 20.0, 0.0)
    at = len(flight.times) // 2
    flight.rows["B"][at, 2] = -20.0  # It passes within 0.1 s, and no row is nearer than 20 m.
    flight.rows["B"][at + 1 :, 2] -= 20.0 * 2.0
    back = flight.times > SECONDS - 5.0
    flight.rows["B"][back] = np.column_stack([START_S + flight.times, flight.places["B"]])[back]
    report = flight.report()
    assert report["min_separation_m"] < 1.0
    failed(report, "came within 10 m")


def test_a_record_that_is_cut_off_has_failed(flight):
    """What it does not hold may be what the aircraft did not hear."""
    header = event_record.Header(
        aircraft="A", software="x", config=Config(identity=IdentityConfig(uas_id="A"))
    )
    step = event_record.Step(now_s=1.0, events=(), commands=())
    record = event_record.MAGIC + event_record.encode(header) + event_record.encode(step)
    file = flight.folder / "20260101T000000Z-A" / "A.events"
    file.parent.mkdir()
    file.write_bytes(record)
    assert flight.report()["ok"]
    file.write_bytes(record[:-5])
    left = len(event_record.encode(step)) - 5
    failed(flight.report(), f"A: its record is cut off; its last {left} bytes are not a whole record")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["A", "B"])
def test_a_position_that_is_not_finite_has_failed(flight, name, value):
    flight.rows[name][200, 2] = value
    report = flight.report()
    assert not report["ok"]
    assert f"{name}: a true position is not finite" in report["reasons"]


@pytest.mark.parametrize(
    ("kept", "missing_s"), [((0.0, 15.0), 25.0), ((10.0, 99.0), 10.0), ((-9.0, -1.0), 40.0)]
)
def test_positions_of_a_part_of_the_flight_are_not_enough(flight, kept, missing_s):
    inside = (flight.times > kept[0]) & (flight.times < kept[1])
    flight.rows["A"] = flight.rows["A"][inside]
    report = flight.report()
    assert not report["ok"]
    (reason,) = [word for word in report["reasons"] if "true positions are missing" in word]
    assert float(reason.split(" s of")[0].rsplit(" ", 1)[1]) == pytest.approx(missing_s, abs=1.2)


def test_a_hole_of_two_seconds_has_failed(flight):
    flight.rows["B"] = flight.rows["B"][(flight.times < 20.0) | (flight.times > 22.0)]
    failed(flight.report(), "missing for 2.")


def test_no_positions_at_all(flight):
    flight.rows["A"] = flight.rows["A"][:0]
    report = flight.report()
    assert "A: there are no true positions" in report["reasons"]
    assert "there is no pair of aircraft" in report["reasons"]
    del flight.rows["A"]
    (flight.folder / "A.truth.csv").unlink()
    assert "cannot be read" in flight.report()["reasons"][0]


def test_an_air_that_knows_no_pair_has_failed(flight):
    flight.air = {}
    report = flight.report()
    assert not report["ok"]
    assert report["reasons"] == ["A heard 40 of 0 frames of B", "B heard 40 of 0 frames of A"]


def test_one_that_never_sent_has_failed(flight):
    flight.air["pairs"]["A>B"] = PairStats().to_dict()
    flight.heard["B"] = 0
    failed(flight.report(), "B heard 0 of 0 frames of A")


def test_frames_that_were_not_received_have_failed(flight):
    flight.heard["B"] = 36
    failed(flight.report(), "B heard 36 of 40 frames of A")
    flight.heard["B"] = 37
    assert flight.report()["ok"]


@pytest.mark.parametrize(
    "changed",
    [
        {"setpoints_received": 1},
        {"largest_setpoint_gap_s": 0.51},
        {"setpoint_gaps_over_100ms": 2},
    ],
)
def test_setpoints_that_came_late_have_failed(flight, changed):
    flight.vehicles["B"] |= changed
    failed(flight.report(), "B: its setpoints")
    flight.vehicles["B"] = {}
    failed(flight.report(), "B: its setpoints")


def test_a_process_that_ended_badly_and_an_interruption_have_failed(flight):
    flight.bad = ["ether (exit code 1)"]
    assert not flight.report()["ok"]
    flight.bad = []
    failed(flight.report(interrupted=True), "interrupted")
