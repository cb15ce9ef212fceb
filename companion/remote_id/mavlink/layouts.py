"""Message numbers, payload layouts and special values of MAVLink's OPEN_DRONE_ID_* messages (common.xml)."""

from __future__ import annotations

import struct
from typing import Final

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.remote_id.wire_values import EPOCH_2019_UTC_S

BASIC_ID: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID
LOCATION: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION
AUTHENTICATION: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_AUTHENTICATION
SELF_ID: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SELF_ID
SYSTEM: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM
OPERATOR_ID: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_OPERATOR_ID
MESSAGE_PACK: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_MESSAGE_PACK
ARM_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS
SYSTEM_UPDATE: Final[int] = mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM_UPDATE

COMPONENT_ID: Final[int] = mavlink.MAV_COMP_ID_ODID_TXRX_1
"""The usual component ID of a vehicle's Remote ID transmitter."""
MAV_TYPE: Final[int] = mavlink.MAV_TYPE_ODID
NO_ID: Final = bytes(20)
"""`id_or_mac` for own data. Any other value marks data that a receiver got from another aircraft."""

DIRECTION_UNKNOWN: Final = 36100
SPEED_UNKNOWN: Final = 25500
CLIMB_UNKNOWN: Final = 6300
ALTITUDE_UNKNOWN_M: Final = -1000.0
TIMESTAMP_UNKNOWN_S: Final = 65535.0
UNDERFLOW: Final = 2**32 - round(EPOCH_2019_UTC_S)
"""Unix time 0 as seconds since 2019, wrapped to an unsigned 32-bit integer."""
GOOD_TO_ARM: Final[int] = mavlink.MAV_ODID_ARM_STATUS_GOOD_TO_ARM
PRE_ARM_FAIL: Final[int] = mavlink.MAV_ODID_ARM_STATUS_PRE_ARM_FAIL_GENERIC

# All but ARM_STATUS hold target_system and target_component; of these, all but SYSTEM_UPDATE also hold
# id_or_mac.
BASIC_ID_LAYOUT: Final = struct.Struct("<BB20sBB20s")
LOCATION_LAYOUT: Final = struct.Struct("<iiffffHHhBB20sBBBBBBB")
AUTHENTICATION_LAYOUT: Final = struct.Struct("<IBB20sBBBB23s")
SELF_ID_LAYOUT: Final = struct.Struct("<BB20sB23s")
SYSTEM_LAYOUT: Final = struct.Struct("<iifffIHHBB20sBBBB")
OPERATOR_ID_LAYOUT: Final = struct.Struct("<BB20sB20s")
MESSAGE_PACK_LAYOUT: Final = struct.Struct("<BB20sBB225s")
ARM_STATUS_LAYOUT: Final = struct.Struct("<B50s")
SYSTEM_UPDATE_LAYOUT: Final = struct.Struct("<iifIBB")
