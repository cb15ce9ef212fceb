"""Records of real hearts over real bytes: guarded missions that meet, as the campaign of `guarding` flies them."""

from __future__ import annotations

import functools
from pathlib import Path
from types import SimpleNamespace

from companion import record
from companion.config import Config
from companion.events import Firmware
from companion.record import Header, Step
from companion.avoidance.authority import State
from tests.sitl_mocks.guarding import head_on


@functools.cache
def guarded() -> tuple[tuple[Config, tuple[Step, ...]], ...]:
    """ONE guards its mission and meets TWO, which only broadcasts, head on; the mission is resumed."""
    sky = head_on(Firmware.ARDUPILOT)
    one = sky.aircraft[0]
    sky.until(lambda: one.state is State.AVOIDING)
    sky.until(lambda: one.state is State.WATCHING)
    sky.run(3.0)
    return tuple((a.config, tuple(a.steps)) for a in sky.aircraft)


def write_guarded(folder: Path) -> SimpleNamespace:
    """A run folder of `guarded`, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for config, steps in guarded():
        name = config.identity.uas_id
        head = Header(aircraft=name, software="test", config=config)
        body = b"".join(record.encode(entry) for entry in (head, *steps))
        (folder / f"{name}.events").write_bytes(record.MAGIC + body)
    return SimpleNamespace(folder=folder)
