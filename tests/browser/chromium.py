"""A real browser without a display: Debian's Chromium, driven by Playwright, drawing by software."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
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


@contextlib.contextmanager
def stopped() -> Iterator[None]:
    """All browsers that this process has started stand still, as on a phone that sleeps."""
    browsers = [pid for pid in _descendants() if "chrom" in _read(pid, "comm")]
    assert browsers
    for pid in browsers:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in browsers:
            os.kill(pid, signal.SIGCONT)


def _descendants() -> list[int]:
    parents = {int(path.name): _parent(int(path.name)) for path in Path("/proc").glob("[0-9]*")}
    found = [os.getpid()]
    for pid in found:
        found += [child for child, parent in parents.items() if parent == pid]
    return found[1:]


def _parent(pid: int) -> int:
    fields = _read(pid, "stat").rpartition(")")[2].split()
    return int(fields[1]) if fields else 0


def _read(pid: int, name: str) -> str:
    try:
        return Path(f"/proc/{pid}/{name}").read_text()
    except OSError:
        return ""
