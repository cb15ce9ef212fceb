"""The package name under which the project is installed: its version and its public rooms (packages).

`dmuca.remote_id` is `companion.remote_id`, and so on for each name in `ROOMS`; docs/library.md describes
them. A room is imported on first use, so `import dmuca` alone is fast and needs no extra. The form
`from dmuca.remote_id import encode` works too.

In an installed copy this folder also holds `config` and `results`, which `companion.shipped` finds.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Final

from companion import __version__

ROOMS: Final = {
    "remote_id": "companion.remote_id",
    "traffic": "companion.traffic",
    "avoidance": "companion.avoidance",
    "atmc": "companion.atmc",
    "channel": "sitl_mocks.channel",
    "training": "ground_tools.atmc",
}
"""Public rooms: the name here, and the module that it refers to. `training` needs the extra `train`."""

__all__ = ["ROOMS", "__version__"]


def __getattr__(name: str) -> ModuleType:
    """Return a public room, imported on first use.

    Raises:
        AttributeError: there is no such room.
    """
    if name not in ROOMS:
        raise AttributeError(f"dmuca has no room {name!r}; its rooms are {', '.join(ROOMS)}")
    return importlib.import_module(f"{__name__}.{name}")


def __dir__() -> list[str]:
    return sorted({*globals(), *ROOMS})
