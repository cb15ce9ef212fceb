"""Writes a run as an MCAP file for Foxglove: JSON messages with Foxglove's schemas."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from companion.errors import ConfigError
from companion.shipped import how_to_install
from ground_tools.inspect.export import foxglove, topics
from ground_tools.inspect.read.flown import Flown, Separation
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.viewer.palette import colour

if TYPE_CHECKING:
    from mcap.writer import Writer

_LEVELS = {"INFO": 2, "WARN": 3, "ERROR": 4, "CRITICAL": 5}
_NO_ROTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_LINE_M, _LABEL_M = 0.5, 3.0
_TRANSPARENT, _OPAQUE = 0.3, 1.0
Message = tuple[str, foxglove.Schema, float, dict[str, Any]]
"""Topic, schema, time on the run's time line (s), content without its time stamp."""


def write(run: Run, ways: Flown, pairs: list[Separation], path: Path) -> int:
    """Write the MCAP file `path`; returns the number of messages.

    Raises:
        ConfigError: mcap is not installed, or the file cannot be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise ConfigError(how_to_install("mcap", "inspect")) from error
    try:
        with path.open("wb") as stream:
            return _write(run, ways, pairs, Writer(stream))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def _write(run: Run, ways: Flown, pairs: list[Separation], writer: Writer) -> int:
    writer.start(profile="", library="dmuca")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    zero_ns, count = topics.zero_ns(run, ways), 0
    for topic, schema, time_s, content in _messages(run, ways, pairs):
        title = schema["title"]
        if title not in schemas:
            schemas[title] = writer.register_schema(title, "jsonschema", json.dumps(schema).encode())
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "json", schemas[title])
        ns = zero_ns + round(time_s * 1e9)
        stamp = {"sec": ns // 10**9, "nsec": ns % 10**9}
        stamped = {"timestamp": stamp, **content}
        if "entities" in content:
            stamped = {**content, "entities": [{"timestamp": stamp, **one} for one in content["entities"]]}
        data = json.dumps(stamped, separators=(",", ":")).encode()
        writer.add_message(channels[topic], ns, data, ns, count)
        count += 1
    writer.finish()  # type: ignore[no-untyped-call]
    return count


def _messages(run: Run, ways: Flown, pairs: list[Separation]) -> Iterator[Message]:
    names = topics.Topics()
    yield from _scene(run, ways, names)
    for fix in topics.fixes(run, ways, names):
        yield from _fix(fix)
    for apart in topics.separations(pairs, names):
        first, second = apart.pair
        content = {"first": first, "second": second}
        numbers = {"distance_m": apart.distance_m, "required_m": apart.required_m}
        yield apart.topic, foxglove.SEPARATION, apart.time_s, content | numbers
    for said in topics.words(run, ways):
        content = {"message": said.text, "name": said.name, "file": ""}
        yield "/log", foxglove.LOG, said.time_s, {**content, "level": _LEVELS[said.level], "line": 0}


def _fix(fix: topics.Fix) -> Iterator[Message]:
    if not any(map(math.isnan, (fix.lat_deg, fix.lon_deg))):
        place = {
            "frame_id": fix.frame,
            "latitude": fix.lat_deg,
            "longitude": fix.lon_deg,
            # An unknown altitude cannot be left out, and JSON has no NaN.
            "altitude": 0.0 if math.isnan(fix.alt_m) else fix.alt_m,
            "position_covariance": [0.0] * 9,
            "position_covariance_type": 0,
        }
        yield fix.topic, foxglove.LOCATION_FIX, fix.time_s, place
    if not fix.own:
        return
    position = _vector(fix.enu_m)
    half = fix.yaw_rad / 2.0
    rotation = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
    pose = {"frame_id": topics.MAP, "pose": {"position": position, "orientation": rotation}}
    yield f"/{fix.frame}/pose", foxglove.POSE_IN_FRAME, fix.time_s, pose
    frames = {"parent_frame_id": topics.MAP, "child_frame_id": fix.frame}
    yield (
        "/tf",
        foxglove.FRAME_TRANSFORM,
        fix.time_s,
        {**frames, "translation": position, "rotation": rotation},
    )


def _scene(run: Run, ways: Flown, names: topics.Topics) -> Iterator[Message]:
    """The paths as lines, and around each aircraft its conflict volume with its name."""
    for index, path in enumerate(ways.paths):
        name = names.frame(path.name)
        red, green, blue = (part / 255.0 for part in colour(index))
        ends = {"r": red, "g": green, "b": blue}
        pose = {"position": _vector((0.0, 0.0, 0.0)), "orientation": _NO_ROTATION}
        lines = [
            {
                "type": 0,
                "pose": pose,
                "thickness": _LINE_M,
                "scale_invariant": False,
                "points": [_vector(point) for point in points.tolist()],
                "color": {**ends, "a": _OPAQUE},
                "colors": [],
                "indices": [],
            }
            for _, points in topics.lines(path)
        ]
        diameter_m = 2.0 * path.radius_m
        sphere = {
            "pose": pose,
            "size": _vector((diameter_m,) * 3),
            "color": {**ends, "a": _TRANSPARENT},
        }
        above = {"position": _vector((0.0, 0.0, path.radius_m)), "orientation": _NO_ROTATION}
        label = {
            "pose": above,
            "billboard": True,
            "font_size": _LABEL_M,
            "scale_invariant": False,
            "color": {**ends, "a": _OPAQUE},
            "text": path.name,
        }
        entities = [
            _entity(f"{name} path", topics.MAP, lines=lines),
            _entity(f"{name} volume", name, spheres=[sphere], texts=[label]),
        ]
        start_s = float(path.time_s[0])
        yield f"/{name}/scene", foxglove.SCENE_UPDATE, start_s, {"deletions": [], "entities": entities}


def _entity(name: str, frame: str, **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: primitives.get(kind, []) for kind in kinds},
    }


def _vector(values: tuple[float, ...] | list[float]) -> dict[str, float]:
    x, y, z = values
    return {"x": x, "y": y, "z": z}
