"""Logs that autopilots write on board: ArduPilot's DataFlash (.bin) and PX4's ULog (.ulg).

`dataflash` and `ulog` read the two formats as streams. `ardupilot` and `px4` turn their messages into the
events that a companion's link would make of the same vehicle's MAVLink, in `Step`s. `logged` holds what both
share: putting events in order of time, and facts about the vehicle that are found while its log is read.
"""

from __future__ import annotations

from companion.flight_logs import ardupilot, dataflash, px4, ulog
from companion.flight_logs.logged import About

__all__ = ["KINDS", "About"]

KINDS = {dataflash.HEAD: ardupilot.read_steps, ulog.MAGIC[:4]: px4.read_steps}
"""The function that reads a log's steps, by the log's first bytes."""
