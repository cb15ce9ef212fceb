"""Foxglove's message schemas, as far as the exports use them.

Foxglove draws a JSON message by the name of its schema, and documents the fields under
https://docs.foxglove.dev/docs/visualization/message-schemas.
"""

from __future__ import annotations

from typing import Any, Final

Schema = dict[str, Any]


def _object(title: str, **properties: Schema) -> Schema:
    return {
        "type": "object",
        "title": title,
        "properties": properties,
        "required": list(properties),
    }


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


_NUMBER: Final[Schema] = {"type": "number"}
_TEXT: Final[Schema] = {"type": "string"}
_NANOSECONDS: Final[Schema] = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME: Final = _object("time", sec={"type": "integer", "minimum": 0}, nsec=_NANOSECONDS)
_DURATION: Final = _object("duration", sec={"type": "integer"}, nsec=_NANOSECONDS)
_VECTOR: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POINT: Final = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOUR: Final = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE: Final = _object(
    "foxglove.LinePrimitive",
    type={"type": "integer", "minimum": 0, "maximum": 2},
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant={"type": "boolean"},
    points=_list(_POINT),
    color=_COLOUR,
    colors=_list(_COLOUR),
    indices=_list({"type": "integer", "minimum": 0}),
)
_SPHERE: Final = _object("foxglove.SpherePrimitive", pose=_POSE, size=_VECTOR, color=_COLOUR)
_LABEL: Final = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard={"type": "boolean"},
    font_size=_NUMBER,
    scale_invariant={"type": "boolean"},
    color=_COLOUR,
    text=_TEXT,
)
_ENTITY: Final = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    arrows=_list({"type": "object"}),
    cubes=_list({"type": "object"}),
    spheres=_list(_SPHERE),
    cylinders=_list({"type": "object"}),
    lines=_list(_LINE),
    triangles=_list({"type": "object"}),
    texts=_list(_LABEL),
    models=_list({"type": "object"}),
)

LOCATION_FIX: Final = _object(
    "foxglove.LocationFix",
    timestamp=_TIME,
    frame_id=_TEXT,
    latitude=_NUMBER,
    longitude=_NUMBER,
    altitude=_NUMBER,
    position_covariance={"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
    position_covariance_type={"type": "integer", "minimum": 0, "maximum": 3},
)
POSE_IN_FRAME: Final = _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE)
FRAME_TRANSFORM: Final = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
SCENE_UPDATE: Final = _object(
    "foxglove.SceneUpdate",
    deletions=_list({"type": "object"}),
    entities=_list(_ENTITY),
)
LOG: Final = _object(
    "foxglove.Log",
    timestamp=_TIME,
    level={"type": "integer", "minimum": 0, "maximum": 5},
    message=_TEXT,
    name=_TEXT,
    file=_TEXT,
    line={"type": "integer", "minimum": 0},
)
SEPARATION: Final = _object(
    "dmuca.Separation",
    timestamp=_TIME,
    first=_TEXT,
    second=_TEXT,
    distance_m=_NUMBER,
    required_m=_NUMBER,
)
"""A schema defined here. Foxglove's plots can show its numbers."""
