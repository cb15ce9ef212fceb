"""Pictures of docs/inspect.md: `python -m tests.browser.pictures RUN FOLDER` (inspect.png, report.png)."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

from ground_tools.inspect.read.read_run import Run, read_run
from ground_tools.inspect.report import summary
from ground_tools.inspect.report.page import write
from ground_tools.inspect.viewer import recording
from ground_tools.inspect.viewer.palette import LIMIT, colour
from ground_tools.inspect.viewer.web import WebViewer
from tests.browser import chromium, viewer

SIZE = 1600, 1000
SMALL = 320, 240
LOAD_S, SETTLE_S = 75.0, 25.0
"""Software draws few pixels often and many seldom, and a recording is taken in between two frames: it loads
in a small window."""
PLAY_PX, CLOSEST_PX = (29, 984), (790, 984)
"""The button that stops playing, and the place on the time line near the closest approach."""
REPORT_SIZE = 1120, 1420


def main(run_folder: str, folder: str) -> None:
    """Draw both."""
    run = read_run(Path(run_folder))
    _viewer(run, Path(folder) / "inspect.png")
    _report(run, Path(folder) / "report.png")


def _viewer(run: Run, picture: Path) -> None:
    colours = [colour(index) for index in range(len(run.aircraft))]
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "inspect.rrd"
        recording.write(run, path)
        with WebViewer(path) as web:
            drawn, _ = viewer.picture(web.url, picture, [*colours, LIMIT], *SIZE, _arranged)
    _shrink(picture)
    print(f"wrote {picture}: {drawn}")


def _arranged(page: Any) -> None:
    page.set_viewport_size(dict(zip(("width", "height"), SMALL, strict=True)))
    page.wait_for_timeout(1e3 * LOAD_S)
    page.set_viewport_size(dict(zip(("width", "height"), SIZE, strict=True)))
    for place in (PLAY_PX, CLOSEST_PX):
        page.wait_for_timeout(1e3 * SETTLE_S)
        page.mouse.click(*place)
    page.wait_for_timeout(1e3 * SETTLE_S)


def _report(run: Run, picture: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        page = Path(name) / "report.html"
        write(run, summary.describe(run), page)
        with chromium.opened(*REPORT_SIZE, offline=True) as browser:
            browser.page.goto(page.as_uri())
            browser.page.screenshot(path=picture)
    _shrink(picture)
    print(f"wrote {picture}")


def _shrink(picture: Path) -> None:
    """To 256 colours: less than half the bytes."""
    with Image.open(picture) as image:
        few = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    few.save(picture, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
