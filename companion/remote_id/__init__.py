"""Remote ID messages (ASTM F3411-22a) and all their byte formats, without sockets or clocks.

`messages` holds the message types in SI units (`BasicId`, `Location`, `System`, ...). `codec` converts
messages and packs to payloads and back, on top of `wire_messages` and `wire_values`; `frames` converts
payloads to the frames of each transport; `mavlink` converts messages to MAVLink payloads. `authentication`
splits data into pages and puts pages together, `identity` checks identities, and `region.Region` is what a
region's law requires of a broadcast. The subfolders sign and verify (`drip`), read capture files (`captures`)
and check the codec against reference vectors (`conformance`). This room may import the rooms before it in
`ROOMS` of tests/test_imports.py, but needs only `errors`. Start reading at `messages`, then `codec`.
"""

from companion.remote_id.authentication import Assembler, AuthenticationData
from companion.remote_id.codec import Payload, decode, decode_pack, encode, encode_pack, read_payload
from companion.remote_id.frames import (
    Counters,
    Frame,
    NotRemoteIdError,
    build_beacon,
    build_ble4,
    build_ble5,
    build_nan_action,
    build_nan_sync_beacon,
    parse_frame,
    parse_frames,
)
from companion.remote_id.identity import (
    check_operator_id_eu,
    check_registration,
    check_serial,
    check_session,
)
from companion.remote_id.mavlink import Odid, decode_odid, encode_odid
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    ClassificationType,
    HeightType,
    IdType,
    Location,
    Message,
    OperatorId,
    OperatorLocationType,
    SelfId,
    Status,
    System,
    UaType,
)
from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4, BLE5, MAX_RATE, WIFI_BEACON, WIFI_NAN

__all__ = [
    "BLE4",
    "BLE5",
    "MAX_RATE",
    "WIFI_BEACON",
    "WIFI_NAN",
    "Assembler",
    "Authentication",
    "AuthenticationData",
    "BasicId",
    "ClassificationType",
    "Counters",
    "Frame",
    "HeightType",
    "IdType",
    "Location",
    "Message",
    "NotRemoteIdError",
    "Odid",
    "OperatorId",
    "OperatorLocationType",
    "Payload",
    "Region",
    "SelfId",
    "Status",
    "System",
    "UaType",
    "build_beacon",
    "build_ble4",
    "build_ble5",
    "build_nan_action",
    "build_nan_sync_beacon",
    "check_operator_id_eu",
    "check_registration",
    "check_serial",
    "check_session",
    "decode",
    "decode_odid",
    "decode_pack",
    "encode",
    "encode_odid",
    "encode_pack",
    "parse_frame",
    "parse_frames",
    "read_payload",
]
