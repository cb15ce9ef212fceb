"""Rerun's web viewer in a process of its own, bound to loopback.

The viewer comes with rerun: `rerun --serve-web` serves its page and the recording. By itself it listens on
all interfaces; here it listens on 127.0.0.1 only.
"""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import subprocess
import time
from pathlib import Path
from types import TracebackType
from urllib.parse import quote

from companion.errors import ConfigError
from sitl_mocks.signals import end_signals

_START_S = 20.0
_STOP_S = 5.0
_POLL_S = 0.05
_LOOK_S = 0.2


def serve(recording: Path) -> None:
    """Serve a recording until Ctrl-C or SIGTERM.

    Raises:
        ConfigError: rerun is not installed, or ended by itself.
    """
    with end_signals() as ended, WebViewer(recording) as viewer:
        print(f"{recording} at {viewer.url}; on this machine only, until Ctrl-C", flush=True)
        while not ended:
            viewer.check()
            time.sleep(_LOOK_S)


class WebViewer:
    """A web viewer that runs until it is closed.

    Args:
        recording: file to show; None to show what is sent to `data_url`.

    Raises:
        ConfigError: rerun is not installed, or does not serve.
    """

    def __init__(self, recording: Path | None = None) -> None:
        program = _program()
        page, data = _free_ports()
        self.data_url = f"rerun+http://127.0.0.1:{data}/proxy"
        self.url = f"http://127.0.0.1:{page}/?url={quote(self.data_url, safe='')}"
        """What a browser opens. A browser without WebGPU needs `&renderer=webgl` behind it."""
        words = ["--bind", "127.0.0.1", "--serve-web", "--port", str(data), "--web-viewer-port", str(page)]
        words += [] if recording is None else [str(recording)]
        self._process = subprocess.Popen(
            [program, *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            # Ctrl-C is ours: it must not end before what sends to it.
            start_new_session=True,
        )
        try:
            for port in (data, page):
                self._wait_for(port)
        except BaseException:
            self.close()
            raise

    def _wait_for(self, port: int) -> None:
        give_up_s = time.monotonic() + _START_S
        while time.monotonic() < give_up_s:
            self.check()
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
                return
            time.sleep(_POLL_S)
        raise ConfigError(f"rerun's web viewer does not serve after {_START_S:g} s")

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def check(self) -> None:
        """Raises ConfigError when it ended by itself."""
        if self._process.poll() is not None:
            raise ConfigError(f"rerun's web viewer ended with exit code {self._process.returncode}")

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> WebViewer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _program() -> Path:
    """The viewer itself: `python -m rerun` would start it as a child that outlives its parent."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise ConfigError("rerun is not installed; in the checkout: pip install -e '.[inspect]'")
    return Path(found.origin).with_name("rerun")


def _free_ports() -> tuple[int, int]:
    """Two that nobody listens on now."""
    with socket.socket() as first, socket.socket() as second:
        first.bind(("127.0.0.1", 0))
        second.bind(("127.0.0.1", 0))
        return first.getsockname()[1], second.getsockname()[1]
