"""Our own parameters for ground stations: the answering side of the parameter protocol.

PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET of other systems are answered with PARAM_VALUE. A name or
index that does not exist gets no answer. All parameters are MAV_PARAM_TYPE_REAL32, because ground stations
read the bytes of an integer as the vehicle's firmware would write them, in one of two ways.

Requests are queued once per parameter and answered one at a time, so that neither a list nor a flood of
requests fills a slow link.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adjustable_parameters import NAMES, changed, value_of
from companion.autopilot.encoders import Outgoing
from companion.autopilot.readers import unpack
from companion.autopilot.wire import Frame
from companion.config import Config
from companion.errors import ConfigError
from companion.events import Settings

PERIOD_S = 0.2
"""Time from one answer to the next."""
_LIST = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST
_READ = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ
_SET = mavlink.MAVLINK_MSG_ID_PARAM_SET
MESSAGE_IDS = frozenset({_LIST, _READ, _SET})
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_VALUE = struct.Struct("<fHH16sB")
_INDEX = {name.encode("ascii"): index for index, name in enumerate(NAMES)}


class Answer(NamedTuple):
    """Result of one request."""

    value: Outgoing
    """PARAM_VALUE with the value that now applies."""
    changed: Settings | None
    """The new settings, if a PARAM_SET changed something."""
    refused: str | None
    """Why a PARAM_SET was refused, and what is allowed."""


class OwnParameters:
    """Holds the settings and answers requests for them."""

    def __init__(self, config: Config, settings: Settings) -> None:
        """Begin with settings that have been checked."""
        self.settings = settings
        self._config = config
        self._asked: dict[int, tuple[float, int] | None] = {}
        """Index -> value and MAV_PARAM_TYPE to set, or None if only the value is requested; in order of
        arrival."""
        self._next_s = -math.inf

    def handle(self, frame: Frame, system_id: int, component_id: int) -> bool:
        """Take one message of `MESSAGE_IDS`. Returns False if it is not for us.

        A list may be requested from everybody (0). A read or a set must be addressed to us alone.

        Args:
            system_id, component_id: our own.
        """
        fields = unpack(frame.message_id, frame.payload)
        if frame.message_id == _LIST:
            if fields[0] not in (0, system_id) or fields[1] not in (0, component_id):
                return False
            for index in range(len(NAMES)):
                self._asked.setdefault(index, None)
            return True
        if fields[1:3] != (system_id, component_id):
            return False
        if frame.message_id == _READ:
            index = fields[0] if fields[0] >= 0 else _index(fields[3])
            if 0 <= index < len(NAMES):
                self._asked.setdefault(index, None)
        elif (index := _index(fields[3])) >= 0:
            self._asked[index] = fields[0], fields[4]
        return True

    def due(self, now_s: float) -> Answer | None:
        """The next answer, if one is due."""
        if not self._asked or now_s < self._next_s:
            return None
        self._next_s = now_s + PERIOD_S
        index = next(iter(self._asked))
        wanted, name = self._asked.pop(index), NAMES[index]
        before, refused = self.settings, None
        if wanted is not None:
            value, kind = wanted
            try:
                if kind != _REAL32:
                    raise ConfigError(f"{name}: MAV_PARAM_TYPE {kind}: allowed: {_REAL32} (REAL32)")
                self.settings = changed(name, value, self._config, before)
            except ConfigError as error:
                refused = str(error)
        told = value_of(name, self._config, self.settings)
        return Answer(
            value=(
                mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
                _VALUE.pack(told, len(NAMES), index, name.encode("ascii"), _REAL32),
            ),
            changed=None if self.settings == before else self.settings,
            refused=refused,
        )


def _index(name_field: bytes) -> int:
    """Index of a parameter name; -1 if there is none."""
    return _INDEX.get(name_field.split(b"\0", 1)[0], -1)
