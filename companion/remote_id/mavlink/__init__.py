"""Converts between Remote ID messages and MAVLink OPEN_DRONE_ID_* payloads (common.xml, 12900-12919).

MAVLink carries the same fields as ASTM F3411-22a in its own units: 1e-7 degrees, centimetres a second,
hundredths of a degree, metres as 32-bit floats. Its special values for "unknown" are `None` here. A payload
is laid out in wire order (fields sorted by size, as in MAVLink). The tests compare every layout with
pymavlink's.

The limits of `codec` apply in both directions: a message that is encoded or decoded here can also go on the
air. MAVLink has the finer resolution, so a message received over the air passes through it unaltered. Two
kinds of timestamp are treated as unknown although they are numbers: 0, and 2106 or later. A sender whose
clock is before 2019 (PX4 without GNSS time) produces the latter.
"""

from __future__ import annotations

from companion.remote_id.mavlink.layouts import ARM_STATUS, COMPONENT_ID, MAV_TYPE, MESSAGE_PACK, NO_ID
from companion.remote_id.mavlink.read import (
    READABLE,
    Odid,
    SystemUpdate,
    decode_arm_status,
    decode_odid,
    updated,
)
from companion.remote_id.mavlink.write import encode_arm_status, encode_message_pack, encode_odid

__all__ = [
    "ARM_STATUS", "COMPONENT_ID", "MAV_TYPE", "MESSAGE_PACK", "NO_ID", "READABLE", "Odid",
    "SystemUpdate", "decode_arm_status", "decode_odid", "encode_arm_status", "encode_message_pack",
    "encode_odid", "updated",
]  # fmt: skip
