"""Reads a Remote ID message from JSON, with errors that name the key and what is allowed."""

from __future__ import annotations

import enum
from typing import Final, get_args

import msgspec

from companion.commands.remote_id.lines import shown
from companion.remote_id.messages import Location, Message, System
from companion.remote_id.wire_values import position_to_wire

_JSON: Final = msgspec.json.Decoder[Message](Message)
_TYPES: Final = {kind.__name__: kind for kind in get_args(Message)}

EXAMPLES: Final = (
    '{"type":"BasicId","id_type":1,"ua_type":2,"uas_id":"1581F6N8A23B2ML3Y3KR"}',
    '{"type":"Location","status":2,"lat_deg":47.1,"lon_deg":8.5,"alt_geodetic_m":500.0,"height_m":80.0,'
    '"direction_deg":90.0,"speed_mps":12.0,"vertical_speed_mps":0.5,"timestamp_s":1373.5}',
    '{"type":"Authentication","auth_type":1,"page":0,"data":"c2lnbmF0dXJl","last_page":0,"length":9}',
    '{"type":"SelfId","description_type":0,"text":"survey"}',
    '{"type":"System","operator_location_type":1,"operator_lat_deg":47.1,"operator_lon_deg":8.5,'
    '"operator_alt_geodetic_m":420.0,"timestamp_utc_s":1735689600.0}',
    '{"type":"OperatorId","operator_id_type":0,"operator_id":"FIN87astrdge12k8"}',
)
"""An example JSON message of each type."""


def message_from_json(line: str) -> Message:
    """The message in a line of JSON. Raises ValueError that names the key, its value and what is allowed."""
    try:
        message: Message = _JSON.decode(line)
    except msgspec.DecodeError as error:
        raise ValueError(_explain(line, str(error))) from error
    match message:
        case Location():
            _check_position("Location.", message.lat_deg, message.lon_deg)
        case System():
            _check_position("System.operator_", message.operator_lat_deg, message.operator_lon_deg)
    return message


def _check_position(prefix: str, lat_deg: float | None, lon_deg: float | None) -> None:
    """Raises ValueError for a coordinate out of range; only if there is none, for a missing coordinate."""
    position_to_wire(prefix, lat_deg or 0.0, lon_deg or 0.0)
    if (lat_deg is None) != (lon_deg is None):
        missing, given = ("lat_deg", "lon_deg") if lat_deg is None else ("lon_deg", "lat_deg")
        raise ValueError(f"{prefix}{missing}: missing; give it together with {prefix}{given}, or neither")


def _explain(line: str, words: str) -> str:
    """What is wrong with a line that is not a message; `words`, the decoder's text, if nothing else fits."""
    try:
        held = msgspec.json.decode(line)
    except msgspec.ValidationError:
        return "a number is too large"
    except msgspec.DecodeError as error:
        _, _, what = str(error).partition("JSON is malformed: ")
        return f"not JSON: {what or 'incomplete'}"
    if not isinstance(held, dict):
        return f"{shown(held)} is not a message; allowed: an object such as {EXAMPLES[3]}"
    name = held.get("type")
    kind = _TYPES.get(name) if isinstance(name, str) else None
    if kind is None:
        return f"type: {shown(name) if 'type' in held else 'missing'}; allowed: {', '.join(_TYPES)}"
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for key in held:
        if key not in fields and key != "type":
            return f"{name}: unknown key {shown(key)}; allowed: {', '.join(fields)}"
    for key, field in fields.items():
        if key not in held:
            if field.required:
                return f"{name}.{key}: missing; allowed: {_allowed(field.type)}"
            continue
        try:
            msgspec.convert(held[key], field.type)
        except msgspec.ValidationError:
            return f"{name}.{key}: {shown(held[key])}; allowed: {_allowed(field.type)}"
    return words


def _allowed(kind: object) -> str:
    """What JSON may hold for a field of this type."""
    if alternatives := get_args(kind):
        return " or ".join(map(_allowed, alternatives))
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return ", ".join(f"{member.value} {member.name.lower().replace('_', ' ')}" for member in kind)
    words: dict[object, str] = {float: "a number", int: "a whole number", str: "text", bytes: "base64 text"}
    return words.get(kind, "null")
