"""The web viewer in a real browser: it draws the recording and contacts only this machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.viewer import recording
from ground_tools.inspect.viewer.palette import colour
from ground_tools.inspect.viewer.web import WebViewer
from tests.browser import chromium, viewer
from tests.support import needs

pytestmark = [
    needs.rerun,
    pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing())),
]


def test_the_web_viewer_draws_the_recording_and_nothing_leaves(tmp_path: Path, run_folder: Path) -> None:
    path = tmp_path / "x.rrd"
    recording.write(read_run(run_folder), path)
    colours = [colour(0), colour(1)]
    with WebViewer(path) as web:
        drawn, asked = viewer.picture(web.url, tmp_path / "x.png", colours, 1000, 700)
    assert set(drawn) == set(colours), f"of {colours}: {drawn}"
    own = web.url.partition("?")[0]
    assert {url.partition("?")[0] for url in asked if not url.startswith(own)} == set()
    assert own + "recording.rrd" in asked


def test_the_viewer_draws_data_while_it_is_sent(tmp_path: Path) -> None:
    import rerun as rr

    sent = (230, 30, 200)
    with WebViewer() as web:
        stream = rr.RecordingStream("dmuca", recording_id="live")
        stream.connect_grpc(web.data_url)
        stream.log("here", rr.Points3D([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], colors=[sent], radii=[-20.0]))
        drawn, _ = viewer.picture(web.url, tmp_path / "x.png", [sent], 600, 400)
        stream.disconnect()
    assert set(drawn) == {sent}
