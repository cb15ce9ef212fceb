"""A real browser without a display: Debian's Chromium, driven by Playwright, drawing by software."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from typing import Any

_ARGUMENTS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
)
PATIENCE_S = 150.0
"""A page of the viewer is drawn in some ten seconds here, on a busy machine in many more."""


def missing() -> str | None:
    """Why there is no browser; None when there is one."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "Playwright is not installed: pip install -e '.[dev]'"
    if shutil.which("chromium") is None:
        return "no Chromium: apt-get install chromium"
    return None


class Page:
    """One page, what it asked for and what it complained of."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.requests: list[str] = []
        self.errors: list[str] = []
        page.set_default_timeout(PATIENCE_S * 1e3)
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("console", lambda line: self.errors.append(line.text) if line.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))


@contextlib.contextmanager
def opened(width: int, height: int, *, offline: bool = False) -> Iterator[Page]:
    """A page of its own browser. `offline`: every request over a network fails."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=list(_ARGUMENTS), timeout=PATIENCE_S * 1e3
        )
        try:
            context = browser.new_context(viewport={"width": width, "height": height}, offline=offline)
            yield Page(context.new_page())
        finally:
            browser.close()
