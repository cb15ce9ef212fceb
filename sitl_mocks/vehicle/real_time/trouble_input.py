"""Troubles of a served vehicle, read from a pipe while it flies: one JSON object a line.

{"answers": "disobeyed"}
{"gnss_lost": true, "sticks": [0.5, 0.0, 0.0, 0.0]}
"""

from __future__ import annotations

import json
import os

from companion.errors import ConfigError
from sitl_mocks.vehicle.troubles import Troubles

_READ_BYTES = 65536


class TroubleInput:
    """Reads lines from a file descriptor without blocking, and sets the troubles that they name."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._rest = b""
        os.set_blocking(fd, False)

    def read(self, troubles: Troubles) -> None:
        """Set the troubles named in the lines that have arrived since the last call.

        Raises:
            ConfigError: a line is no JSON object, or its trouble or value is unknown.
        """
        try:
            self._rest += os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return
        *lines, self._rest = self._rest.split(b"\n")
        for line in lines:
            try:
                given = dict(json.loads(line))
            except (TypeError, ValueError) as error:
                raise ConfigError(
                    f"trouble {line.decode(errors='replace')!r}: expected a JSON object"
                ) from error
            for name, value in given.items():
                troubles.set(name, value)
