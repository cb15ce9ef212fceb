"""Following a growing record gives the same output as the whole record."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion import event_record
from companion.errors import ConfigError, PeerDataError
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.viewer import recording
from ground_tools.inspect.viewer.live import Bridge, follow
from tests.support import needs

pytestmark = needs.rerun


def rows(path: Path) -> dict[str, int]:
    """Rows with a time, by entity path."""
    from rerun.chunk import RrdReader

    found: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            found[str(chunk.entity_path)] = found.get(str(chunk.entity_path), 0) + chunk.num_rows
    return found


def bridged(folder: Path, out: Path, grow: Callable[[Bridge], None]) -> None:
    import rerun as rr

    stream = rr.RecordingStream("dmuca", recording_id="live")
    stream.save(out)
    bridge = Bridge(sorted(folder.glob("*.events")), stream)
    grow(bridge)
    bridge.close()
    stream.disconnect()


def test_a_growing_record_gives_the_same_as_the_whole_one(tmp_path: Path, made: SimpleNamespace) -> None:
    path = made.write_events(tmp_path, "a", made.steps(made.northbound, made.eastbound(20.0)))
    whole = path.read_bytes()
    counts: list[int] = []

    def grow(bridge: Bridge) -> None:
        for end in range(8, len(whole) + 7_000, 7_000):  # cuts the file at arbitrary positions
            path.write_bytes(whole[:end])
            counts.append(bridge.look())

    path.write_bytes(whole[:8])
    bridged(tmp_path, tmp_path / "live.rrd", grow)
    assert sum(counts) == 601
    assert sum(count > 0 for count in counts) > 10

    recording.write(read_run(tmp_path), tmp_path / "whole.rrd")
    live, converted = rows(tmp_path / "live.rrd"), rows(tmp_path / "whole.rrd")
    for entity in ("/authority/a", "/speed/a/chosen", "/events/a"):
        assert live[entity] == converted[entity] > 0, entity
    # Only the end of a converted run removes what was drawn last.
    assert live["/aircraft/a/own"] == converted["/aircraft/a/own"] - 1 == 601
    assert live["/aircraft/a/flown"] > 10


def test_aircraft_are_drawn_once_all_positions_are_known(tmp_path: Path, made: SimpleNamespace) -> None:
    early = made.write_events(tmp_path, "a", made.steps(made.northbound, made.eastbound(20.0)))
    late = made.write_events(tmp_path, "b", made.steps(made.eastbound(20.0), made.northbound, 500.0))
    whole = late.read_bytes()
    late.write_bytes(whole[:8])
    counts: list[int] = []

    def grow(bridge: Bridge) -> None:
        counts.append(bridge.look())
        late.write_bytes(whole)
        counts.append(bridge.look())

    bridged(tmp_path, tmp_path / "live.rrd", grow)
    assert counts == [0, 1202]
    assert {"/aircraft/a/own", "/aircraft/b/own"} <= set(rows(tmp_path / "live.rrd"))
    assert early.exists()


def test_a_file_of_another_kind_is_reported_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.events").write_bytes(b"DMUCAEV1" + bytes(100))
    with pytest.raises(PeerDataError, match=r"a\.events: event record of format b'1'"):
        bridged(tmp_path, tmp_path / "live.rrd", lambda bridge: bridge.look())


def test_available_data_is_shown_after_a_timeout_and_the_rest_on_arrival(
    tmp_path: Path, made: SimpleNamespace
) -> None:
    """One aircraft knows neither UTC nor its position; the other knows both."""
    whole = made.steps(made.northbound, made.eastbound(20.0))
    bare = made.steps(made.eastbound(20.0), made.northbound, utc=False, positions=False)
    made.write_events(tmp_path, "a", whole)
    late = made.write_events(tmp_path, "b", bare[:300])
    waited: list[tuple[str, ...]] = []

    def grow(bridge: Bridge) -> None:
        assert bridge.look() == 0
        waited.append(bridge.waits_for)
        assert bridge.look(complete=False) == 601 + 300
        waited.extend((bridge.waits_for, bridge.without))
        bridge.look()
        assert not bridge.outgrown
        with late.open("ab") as file:
            file.write(event_record.encode(whole[400]))
        bridge.look()
        assert bridge.outgrown

    bridged(tmp_path, tmp_path / "live.rrd", grow)
    # Once one position is known, others are drawn as they arrive.
    assert waited == [("b: UTC and a position",), (), ("b: UTC",)]
    live = rows(tmp_path / "live.rrd")
    assert live["/aircraft/a/own"] == 601
    assert live["/authority/b"] > 0


def test_a_record_without_any_position_shows_its_other_data(tmp_path: Path, made: SimpleNamespace) -> None:
    bare = made.steps(made.northbound, made.eastbound(20.0), positions=False)
    path = made.write_events(tmp_path, "a", bare[:200])

    def grow(bridge: Bridge) -> None:
        assert (bridge.look(), bridge.waits_for) == (0, ("a: a position",))
        assert (bridge.look(complete=False), bridge.without) == (200, ("a: a position",))
        with path.open("ab") as file:
            file.write(event_record.encode(made.steps(made.northbound, made.eastbound(20.0))[200]))
        bridge.look()
        assert bridge.outgrown

    bridged(tmp_path, tmp_path / "live.rrd", grow)
    assert rows(tmp_path / "live.rrd")["/authority/a"] > 0


def test_a_damaged_record_does_not_end_the_others(tmp_path: Path, made: SimpleNamespace) -> None:
    steps = made.steps(made.northbound, made.eastbound(20.0))
    for name in ("a", "b"):
        path = made.write_events(tmp_path, name, steps)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    (tmp_path / "c.events").write_bytes(b"DMUCAEV1" + bytes(100))
    (tmp_path / "d.events").mkdir()

    def grow(bridge: Bridge) -> None:
        assert 601 < bridge.look() < 1202
        assert bridge.look() == 0
        assert [problem.split(":")[0] for problem in bridge.problems] == [
            *("d.events", "b.events", "c.events")
        ]
        assert bridge.problems[1].endswith("checksum differs; the run is shown up to there")

    bridged(tmp_path, tmp_path / "live.rrd", grow)


def test_ctrl_c_ends_it_quietly(tmp_path: Path, made: SimpleNamespace) -> None:
    """As in a terminal, the signal goes to the viewer's parent and its process group."""
    made.write_events(tmp_path, "a", made.steps(made.northbound, made.northbound, positions=False)[:50])
    with subprocess.Popen(
        [sys.executable, "-m", "ground_tools.cli", "inspect", str(tmp_path), "--live"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith("showing a live at http://127.0.0.1:")
        assert process.stdout.readline() == "waiting for a: a position\n"
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(60.0) == 0
        assert process.stderr.read() == ""


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fifo.events", "not a regular file"),
        ("loop", "cannot be read: Too many levels"),
        ("none", "this run folder does not exist"),
    ],
)
def test_records_that_cannot_be_followed_are_reported(tmp_path: Path, name: str, words: str) -> None:
    os.mkfifo(tmp_path / "fifo.events")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(ConfigError, match=words):
        follow(tmp_path / name)
