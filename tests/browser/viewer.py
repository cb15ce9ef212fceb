"""Rerun's web viewer as a browser draws it."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.browser.chromium import PATIENCE_S, opened

Colour = tuple[int, int, int]


def picture(
    url: str,
    path: Path,
    colours: Sequence[Colour],
    width: int = 1440,
    height: int = 900,
    arrange: Callable[[Any], None] = lambda page: None,
) -> tuple[dict[Colour, int], list[str]]:
    """Open the viewer and take its picture once something of each colour is drawn.

    Args:
        arrange: what to do with Playwright's page beforehand.

    Returns:
        Pixels of each colour, fewer colours than asked for when patience ended; every address that was asked.
    """
    with opened(width, height) as page:
        page.page.goto(f"{url}&renderer=webgl")
        arrange(page.page)
        give_up_s = time.monotonic() + PATIENCE_S
        while True:
            image = page.page.screenshot()
            found = _count(image, colours)
            if len(found) == len(colours) or time.monotonic() > give_up_s:
                path.write_bytes(image)
                return found, page.requests
            page.page.wait_for_timeout(1000)


def _count(image: bytes, colours: Sequence[Colour]) -> dict[Colour, int]:
    import matplotlib.image

    pixels = np.rint(255 * matplotlib.image.imread(io.BytesIO(image), format="png")[..., :3]).astype(int)
    counts = {c: int((np.abs(pixels - np.array(c)).max(axis=2) <= 12).sum()) for c in colours}
    return {c: n for c, n in counts.items() if n >= 20}
