"""What people open, in a real browser: the web viewer draws the recording, and asks this machine alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_tools.inspect import recording
from ground_tools.inspect.palette import colour
from ground_tools.inspect.read_run import read_run
from ground_tools.inspect.web import WebViewer
from tests.browser import chromium, viewer

pytest.importorskip("rerun")
pytestmark = pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing()))


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
