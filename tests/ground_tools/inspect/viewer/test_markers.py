"""Markers at every conflict, manoeuvre, switch and fault: in a converted run, during a flight, for the link
of a telemetry log, and in the report's time line. The record has one event of each kind."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.autopilot.tlog import TlogCounts
from companion.config import Config, IdentityConfig
from companion.event_record import Step
from companion.events import (
    AnyCommand,
    AnyEvent,
    AuthorityChanged,
    BroadcastChanged,
    EstimatorState,
    Firmware,
    FlightMode,
    Heartbeat,
    ModeRefused,
    RadioState,
    RemoteIdModule,
    Say,
    Severity,
    TrackFlagged,
    TransportsChosen,
    TwoAutopilots,
    VehicleText,
)
from ground_tools.inspect.read.flown import flown
from ground_tools.inspect.read.link_health import ComponentHealth, LinkHealth
from ground_tools.inspect.read.read_run import Run, read_run
from ground_tools.inspect.report import lanes, summary
from ground_tools.inspect.viewer import drawing, recording, writer
from ground_tools.inspect.viewer.live import Bridge
from ground_tools.inspect.viewer.palette import LEVELS
from tests.ground_tools.inspect.flights import decision, step, track, write
from tests.support import needs

pytestmark = needs.rerun
CONFIG = Config(identity=IdentityConfig(uas_id="ONE"))
TURNED = (4.0, 3.0, 0.0)
SMALL, LARGE = writer.MARK_PX[1], writer.MARK_PX[0]
EVENTS: dict[float, AnyEvent] = {
    1.0: EstimatorState(usable=False),
    2.0: EstimatorState(usable=True),
    3.0: TwoAutopilots(reason="which is ours?"),
    4.0: RemoteIdModule(component_id=236, ready=False, text="no GPS"),
    5.0: RemoteIdModule(component_id=236, ready=True),
    6.0: ModeRefused(mode=FlightMode.EXTERNAL, reason="denied"),
    7.0: RadioState(text="adapter is gone"),
    8.0: VehicleText(severity=Severity.WARNING, text="battery low"),
}
COMMANDS: dict[float, AnyCommand] = {
    10.0: BroadcastChanged(rates=(("wifi", 1.0),), legal=True, reason=""),
    11.0: BroadcastChanged(rates=(("wifi", 5.0),), legal=True, reason="crowded"),
    12.0: BroadcastChanged(rates=(("bluetooth4", 5.0),), legal=False, reason="adapter is gone"),
    13.0: TransportsChosen(rates=(("wifi", 1),), by="rule", reason="alone"),
    14.0: TransportsChosen(rates=(("wifi", 1),), by="fallback", reason="no answer"),
    15.0: AuthorityChanged(previous="standby", state="guarding", trigger="ready", reason="mode confirmed"),
    16.0: TrackFlagged(track_id="TWO", flag="speed", text="too fast"),
    16.2: TrackFlagged(track_id="THREE", flag="speed", text="too fast"),
    17.0: Say(severity=Severity.WARNING, text="no policy"),
    18.0: Say(severity=Severity.INFO, text="well"),
}
MARKED = {
    1.0: "the autopilot's estimator is not usable",
    2.0: "the autopilot's estimator is usable again",
    3.0: "which is ours?",
    4.0: "Remote ID module 236 is not ready: no GPS",
    5.0: "Remote ID module 236 is ready",
    6.0: "mode external was refused: denied",
    7.0: "radio: adapter is gone",
    8.0: "autopilot: battery low",
    9.0: "mode GUIDED -> AUTO",
    10.0: "on the air: wifi 1/s",
    11.0: "on the air: wifi 5/s (crowded)",
    12.0: "on the air: bluetooth4 5/s (adapter is gone)",
    13.0: "transports chosen by rule: wifi 1/s (alone)",
    14.0: "transports chosen by fallback: wifi 1/s (no answer)",
    15.0: "authority standby -> guarding on ready: mode confirmed",
    16.0: "TWO is doubted, speed: too fast",
    17.0: "to the pilot: no policy",
    20.0: "conflict with TWO: 1 m in 20 s, received 1.0 s ago",
    33.2: "the link to the autopilot is lost: no heartbeat for 3.2 s",
    36.0: "the link to the autopilot returned after 6.0 s",
}
QUIET = {2.0, 5.0, 9.0, 10.0, 11.0, 13.0, 15.0, 36.0}
"""Events that are reported and are no fault."""


def steps() -> list[Step]:
    """Steps at 5 Hz over 40 s: a heartbeat per second except from 30 to 36 s, a conflict and a manoeuvre from
    20 to 22 s."""
    found = []
    for tick in range(201):
        now_s = tick / 5
        events = [EVENTS[now_s]] if now_s in EVENTS else []
        if tick % 5 == 0 and not 30.0 < now_s < 36.0:
            mode, number = (FlightMode.EXTERNAL, 4) if now_s < 9.0 else (FlightMode.MISSION, 3)
            beat = Heartbeat(
                system_id=1,
                firmware=Firmware.ARDUPILOT,
                vehicle_type=2,
                custom_mode=number,
                mode=mode,
                armed=True,
            )
            events.append(beat)
        near = 20.0 <= now_s <= 22.0
        law = decision(track(), chosen=TURNED) if near else decision()
        told = [COMMANDS[now_s]] if now_s in COMMANDS else []
        found.append(step(now_s, law, *told, events=tuple(events)))
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("markers")
    write(folder, CONFIG, steps())
    return read_run(folder)


def markers(path: Path, name: str) -> list[tuple[float, str, int, float, float]]:
    """Time, text, colour, radius and north coordinate of every marker, in order of time."""
    from rerun.chunk import RrdReader

    rows = []
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) != f"/markers/{name}" or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        column = {n.rpartition(":")[2]: batch.column(n).to_pylist() for n in batch.schema.names if ":" in n}
        times = [round(value.value * 1e-9, 3) for value in batch.column(drawing.WHOLE)]
        parts = (column[part] for part in ("labels", "colors", "radii", "positions"))
        rows += [
            (time, words, colour, radius, place[1])
            for time, (words,), (colour,), (radius,), (place,) in zip(times, *parts, strict=True)
        ]
    return sorted(rows)


def check(rows: list[tuple[float, str, int, float, float]], manoeuvre: str) -> None:
    """Check that there is one marker for each event, at the aircraft's position, small if there is no
    fault."""
    (begun,) = [row for row in rows if "manoeuvre" in row[1]]
    assert begun[0] == 20.0
    assert begun[1].startswith(manoeuvre)
    rows = [row for row in rows if row is not begun]
    assert {row[0]: row[1] for row in rows} == MARKED
    assert len(rows) == len(MARKED)
    assert {row[0] for row in rows if row[3] == -SMALL} == QUIET
    assert {row[0] for row in rows if row[3] == -LARGE} == MARKED.keys() - QUIET
    blue = int.from_bytes(bytes((*LEVELS["INFO"], 255)))
    assert {row[0] for row in rows if row[2] == blue} == QUIET
    for time, *_, north in rows:
        assert north == pytest.approx(4.5e-5 * time * 111_170.0, rel=1e-3), time


def test_a_converted_run_has_a_marker_at_each(run: Run, tmp_path: Path) -> None:
    recording.write(run, tmp_path / "a.rrd")
    check(markers(tmp_path / "a.rrd", run.aircraft[0].name), "manoeuvre: The wanted velocity")


def test_a_live_run_has_a_marker_at_each(run: Run, tmp_path: Path) -> None:
    """The record is read in three parts, one of which ends within the manoeuvre. It is reported once."""
    import rerun as rr

    (path,) = run.folder.glob("*.events")
    whole, grown = path.read_bytes(), tmp_path / path.name
    every = steps()
    ends = [len(write(tmp_path / f"to{n}", CONFIG, every[:n]).read_bytes()) for n in (60, 105)]
    grown.write_bytes(whole[: ends[0]])
    stream = rr.RecordingStream("dmuca", recording_id="live")
    stream.save(tmp_path / "live.rrd")
    bridge = Bridge([grown], stream)
    counts = []
    for end in (*ends, len(whole)):
        grown.write_bytes(whole[:end])
        counts.append(bridge.look())
    bridge.close()
    assert counts == [60, 45, 96]
    check(markers(tmp_path / "live.rrd", grown.stem), "manoeuvre begins: The wanted velocity")


def test_only_a_lost_link_to_the_autopilot_is_marked(run: Run, tmp_path: Path) -> None:
    """If the log has no later messages of the autopilot, no return is marked."""

    def component(component_id: int) -> ComponentHealth:
        return ComponentHealth(
            system_id=1,
            component_id=component_id,
            frames=30,
            missing=0,
            repeated=0,
            gaps_s=np.array([[3.5, 4.0], [30.5, 9.5]]),
            seconds=np.array([[3.0, 10.0, 0.0], [7.0, 10.0, 0.0], [30.0, 10.0, 0.0]]),
        )

    link = LinkHealth(
        components=(component(1), component(191)),
        radio=np.zeros((0, 8)),
        reboots_s=np.array([9.5]),
        counts=TlogCounts(),
        unknown=0,
        bad_values=0,
    )
    one = dataclasses.replace(run.aircraft[0], link_of=lambda: link)
    recording.write(dataclasses.replace(run, aircraft=(one,)), tmp_path / "a.rrd")
    rows = [row for row in markers(tmp_path / "a.rrd", one.name) if row[1].startswith("link: ")]
    assert [(row[0], row[1], row[3]) for row in rows] == [
        (3.5, "link: nothing was received from 1/1 for 4.0 s", -LARGE),
        (7.5, "link: 1/1 was received again after 4.0 s", -SMALL),
        (9.5, "link: the vehicle's clock started again from 0", -LARGE),
        (30.5, "link: nothing was received from 1/1 for 9.5 s", -LARGE),
    ]


def test_the_reports_time_line_has_a_marker_at_each(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.axes import Axes

    drawn: dict[str, list[float]] = {}
    plot = Axes.plot

    def seen(self: Axes, *values: Any, **look: Any) -> object:
        drawn[str(look.get("label"))] = list(values[0])
        return plot(self, *values, **look)

    monkeypatch.setattr(Axes, "plot", seen)
    figures = summary.describe(run)
    text = lanes.lanes(run, flown(run), figures["aircraft"])
    assert text is not None
    assert f"{run.aircraft[0].name} events" in text
    assert {kind: drawn[kind] for kind in lanes._MARKS} == {
        "on the air switched": [10.0, 11.0, 12.0],
        "transports chosen": [13.0, 14.0],
        "conflict begins": [20.0],
        "manoeuvre begins": [20.0],
        "fault or warning": [1.0, 4.0, 6.0, 7.0, 8.0, 12.0, 16.0, 16.2, 17.0],
    }
