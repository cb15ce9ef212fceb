"""Converts the waypoints of a trajectory file into the local frame."""

from __future__ import annotations

from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.avoidance.walls import walls_of
from companion.config import Config, TrajectoryFile
from companion.errors import ConfigError
from companion.events import SIGMA_UNKNOWN_M, VehicleParameters
from companion.geometry import LocalFrame


def local_path(path: TrajectoryFile, frame: LocalFrame, datum_msl_m: float) -> Trajectory:
    """The path in a local frame.

    Args:
        frame: local frame; its altitude datum is mean sea level.
        datum_msl_m: height above mean sea level of the datum of the file's altitudes.

    Raises:
        ConfigError: times are not strictly rising, or a number is not finite.
    """
    points = [frame.to_ned(w.lat_deg, w.lon_deg, w.alt_m + datum_msl_m) for w in path.waypoint]
    return Trajectory([w.t_s for w in path.waypoint], points)


def check_path(config: Config, name: str, vehicle: VehicleParameters | None = None) -> None:
    """Check before flight that the configured path, if there is one, keeps the limits and the fence.

    Args:
        name: name of the configuration file, for messages.
        vehicle: the vehicle's own limits; None: not known.

    Raises:
        ConfigError: names the leg, its speed and the limit, or the area of the fence.
    """
    if config.path is None:
        return
    first = config.path.waypoint[0]
    frame = LocalFrame(first.lat_deg, first.lon_deg, first.alt_m)
    path = local_path(config.path, frame, 0.0)
    check_speeds(path, config.limits, f"{name}: flight.trajectory", vehicle)
    try:
        walls_of(config.fence, frame, path, SIGMA_UNKNOWN_M)
    except ConfigError as error:
        raise ConfigError(f"{name}: flight.trajectory: {error}") from error
