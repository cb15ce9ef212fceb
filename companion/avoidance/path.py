"""A trajectory file's waypoints in the local frame."""

from __future__ import annotations

from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.config import Config, TrajectoryFile
from companion.geometry import LocalFrame


def local_path(path: TrajectoryFile, frame: LocalFrame, datum_msl_m: float) -> Trajectory:
    """The path in a local frame.

    Args:
        frame: its altitude datum is mean sea level.
        datum_msl_m: height above mean sea level of what the file's altitudes are measured from.

    Raises:
        ConfigError: times do not rise, or a number is not finite.
    """
    points = [frame.to_ned(w.lat_deg, w.lon_deg, w.alt_m + datum_msl_m) for w in path.waypoint]
    return Trajectory([w.t_s for w in path.waypoint], points)


def check_path(config: Config, name: str) -> None:
    """Check before flight that the configured path, where there is one, can be flown within the limits.

    Raises:
        ConfigError: names the leg, its speed and the limit.
    """
    if config.path is None:
        return
    first = config.path.waypoint[0]
    frame = LocalFrame(first.lat_deg, first.lon_deg, first.alt_m)
    check_speeds(local_path(config.path, frame, 0.0), config.limits, f"{name}: flight.trajectory")
