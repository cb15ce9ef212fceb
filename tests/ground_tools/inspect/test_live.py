"""A record followed while it grows: what comes out is what the whole record holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.errors import PeerDataError
from ground_tools.inspect import recording
from ground_tools.inspect.live import Bridge
from ground_tools.inspect.read_run import read_run

rr = pytest.importorskip("rerun")


def rows(path: Path) -> dict[str, int]:
    """Rows with a time, by entity path."""
    from rerun.chunk import RrdReader

    found: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            found[str(chunk.entity_path)] = found.get(str(chunk.entity_path), 0) + chunk.num_rows
    return found


def bridged(folder: Path, out: Path, grow: Callable[[Bridge], None]) -> None:
    stream = rr.RecordingStream("dmuca", recording_id="live")
    stream.save(out)
    bridge = Bridge(sorted(folder.glob("*.events")), stream)
    grow(bridge)
    bridge.close()
    stream.disconnect()


def test_a_growing_record_gives_what_the_whole_one_gives(tmp_path: Path, made: SimpleNamespace) -> None:
    path = made.write_events(tmp_path, "a", made.steps(made.northbound, made.eastbound(20.0)))
    whole = path.read_bytes()
    counts: list[int] = []

    def grow(bridge: Bridge) -> None:
        for end in range(8, len(whole) + 7_000, 7_000):  # cuts records anywhere
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
    # The end of a converted run takes away what is drawn.
    assert live["/aircraft/a/own"] == converted["/aircraft/a/own"] - 1 == 601
    assert live["/aircraft/a/flown"] > 10


def test_several_are_drawn_once_all_have_told_where_they_are(tmp_path: Path, made: SimpleNamespace) -> None:
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


def test_another_file_is_said_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.events").write_bytes(b"DMUCAEV1" + bytes(100))
    with pytest.raises(PeerDataError, match=r"a\.events: event record of format b'1'"):
        bridged(tmp_path, tmp_path / "live.rrd", lambda bridge: bridge.look())
