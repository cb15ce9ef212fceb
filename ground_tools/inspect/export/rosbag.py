"""Writes a run as a ROS 2 bag (a folder with an SQLite file), for `ros2 bag play`, RViz and PlotJuggler.

Message types are those of ROS 2 Humble, which later releases read as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from companion.errors import ConfigError
from companion.shipped import how_to_install
from ground_tools.inspect.export import topics
from ground_tools.inspect.read.flown import Flown, Separation
from ground_tools.inspect.read.read_run import Run

_VERSION: Final = 8
"""Version of the bag's format: that of Humble."""
_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40, "CRITICAL": 50}
"""Levels of rcl_interfaces/msg/Log."""
_FIX, _NO_FIX = 0, -1
"""Values of `status` in sensor_msgs/msg/NavSatStatus."""
_END_S = 2**31 - 1
"""Last second of builtin_interfaces/Time."""
Message = tuple[str, str, float, Any]
"""Topic, type, time on the run's time line (s), message."""


def write(run: Run, ways: Flown, pairs: list[Separation], path: Path) -> int:
    """Write the bag, which is the new folder `path`; returns the number of messages.

    Raises:
        ConfigError: rosbags is not installed, the folder exists already, it cannot be written, or the times
            are later than ROS 2 can write.
    """
    try:
        from rosbags.rosbag2 import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ConfigError(how_to_install("rosbags", "inspect")) from error
    if path.exists():
        raise ConfigError(f"{path}: it exists already; give the path of a new folder")
    store = get_typestore(Stores.ROS2_HUMBLE)
    zero_ns, count = topics.zero_ns(run, ways), 0
    end_s = max(record.facts.end_s + ways.offsets_s[record.name] for record in run.aircraft)
    if zero_ns / 1e9 + end_s >= _END_S:
        raise ConfigError(
            f"{path}: the run ends after 2038-01-19 03:14:07Z, the last time that ROS 2 can write; use --mcap"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with Writer(path, version=_VERSION) as writer:
            connections: dict[str, Any] = {}
            for topic, kind, time_s, message in _Messages(store.types, zero_ns).of(run, ways, pairs):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                ns = zero_ns + round(time_s * 1e9)
                writer.write(connections[topic], ns, store.serialize_cdr(message, kind))
                count += 1
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    return count


class _Messages:
    """Makes the messages of a run."""

    def __init__(self, types: Any, zero_ns: int) -> None:
        self._types = types
        self._zero_ns = zero_ns

    def of(self, run: Run, ways: Flown, pairs: list[Separation]) -> Iterator[Message]:
        names = topics.Topics()
        yield from self._paths(ways, names)
        for fix in topics.fixes(run, ways, names):
            yield from self._fix(fix)
        for apart in topics.separations(pairs, names):
            kind = "std_msgs/msg/Float64"
            yield apart.topic, kind, apart.time_s, self._types[kind](data=apart.distance_m)
        for said in topics.words(run, ways):
            kind = "rcl_interfaces/msg/Log"
            message = self._types[kind](
                stamp=self._time(said.time_s),
                level=_LEVELS[said.level],
                name=said.name,
                msg=said.text,
                file="",
                function="",
                line=0,
            )
            yield "/rosout", kind, said.time_s, message

    def _fix(self, fix: topics.Fix) -> Iterator[Message]:
        types, kind = self._types, "sensor_msgs/msg/NavSatFix"
        known = not any(map(math.isnan, (fix.lat_deg, fix.lon_deg)))
        message = types[kind](
            header=self._header(fix.time_s, fix.frame),
            status=types["sensor_msgs/msg/NavSatStatus"](status=_FIX if known else _NO_FIX, service=1),
            latitude=fix.lat_deg,
            longitude=fix.lon_deg,
            altitude=fix.alt_m,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )
        yield fix.topic, kind, fix.time_s, message
        if not fix.own:
            return
        half = fix.yaw_rad / 2.0
        rotation = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
        yield f"/{fix.frame}/pose", "geometry_msgs/msg/PoseStamped", fix.time_s, self._pose(fix, rotation)
        x, y, z = fix.enu_m
        transform = types["geometry_msgs/msg/TransformStamped"](
            header=self._header(fix.time_s, topics.MAP),
            child_frame_id=fix.frame,
            transform=types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z), rotation=rotation
            ),
        )
        kind = "tf2_msgs/msg/TFMessage"
        yield "/tf", kind, fix.time_s, types[kind](transforms=[transform])

    def _paths(self, ways: Flown, names: topics.Topics) -> Iterator[Message]:
        """Each flown path as a whole, at its beginning; where positions are missing, one message for the time
        up to the gap and one for the time after it."""
        types, kind = self._types, "nav_msgs/msg/Path"
        level = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        lines = ((path.name, *line) for path in ways.paths for line in topics.lines(path))
        for name, start_s, points in lines:
            header = self._header(start_s, topics.MAP)
            poses = [
                types["geometry_msgs/msg/PoseStamped"](
                    header=header,
                    pose=types["geometry_msgs/msg/Pose"](
                        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z), orientation=level
                    ),
                )
                for x, y, z in points.tolist()
            ]
            topic = f"/{names.frame(name)}/path"
            yield topic, kind, start_s, types[kind](header=header, poses=poses)

    def _pose(self, fix: topics.Fix, rotation: Any) -> Any:
        x, y, z = fix.enu_m
        types = self._types
        point = types["geometry_msgs/msg/Point"](x=x, y=y, z=z)
        return types["geometry_msgs/msg/PoseStamped"](
            header=self._header(fix.time_s, topics.MAP),
            pose=types["geometry_msgs/msg/Pose"](position=point, orientation=rotation),
        )

    def _header(self, time_s: float, frame: str) -> Any:
        return self._types["std_msgs/msg/Header"](stamp=self._time(time_s), frame_id=frame)

    def _time(self, time_s: float) -> Any:
        seconds, nanoseconds = divmod(self._zero_ns + round(time_s * 1e9), 10**9)
        return self._types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
