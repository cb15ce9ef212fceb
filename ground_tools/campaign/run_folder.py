"""A flight of a campaign as a run folder, for `ground-tools inspect` and `picture`.

The folder records the compiled flight itself: the true positions, the input of each decision and the
commands. Only the law flew, not the whole companion. The records therefore contain no authority state, and
`companion replay` has nothing to compare with them. A message counts as received at the first decision that
used it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pymap3d
import tomli_w

from companion import __version__
from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.config import (
    Config,
    FlightConfig,
    IdentityConfig,
    TrajectoryFile,
    Waypoint,
)
from companion.errors import ConfigError
from companion.event_record import Header, Step
from companion.events import (
    AnyCommand,
    AnyEvent,
    Broadcast,
    Decision,
    FenceArea,
    GlobalPosition,
    RemoteIdHeard,
    TrackView,
    VehicleTime,
    VelocitySetpoint,
)
from companion.geometry import Vec3
from companion.radio.frames_io import radio_address
from companion.remote_id.messages import Location
from companion.runtime.record.recorder import EventFile, create_run_folder, write_json, write_manifest
from companion.toml_reader import without_none
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import outcome, vehicles
from ground_tools.campaign.cells import Cell, Look
from ground_tools.inspect.read.truth import HEADER, ORIGIN
from sitl_mocks.encounters.lockstep import UTC_AT_START_S

MOST_AIRCRAFT = 50
"""Largest number of aircraft. The record of what each decision saw of each other aircraft grows with the
square of this number."""
_TRANSPORT = "wifi"
_QUIET_LOG_S = 1.0
"""Interval at which decisions without a conflict are recorded. As in a companion's record, every decision in
conflict or recovery is recorded."""


def write(root: Path, cell: Cell, seed: int, utc_s: float) -> Path:
    """Fly one encounter again and record it, with avoidance and, in the subfolder `unavoided`, without.

    Args:
        utc_s: current time, for the folder's name.

    Returns:
        The run folder.

    Raises:
        ConfigError: a file cannot be written, or the encounter cannot be drawn.
    """
    look, unavoided = campaign.look(cell, seed), campaign.look(campaign.baseline(cell), seed)
    folder = create_run_folder(root, f"campaign-{cell.generator}-{seed}", utc_s, "--runs")
    try:
        (folder / "unavoided").mkdir()
        _write_flight(folder, look)
        _write_flight(folder / "unavoided", unavoided)
        settings = {"seed": seed, "cell": cell, "world": look.world, "avoidance": look.avoidance}
        (folder / "config.toml").write_text(tomli_w.dumps(without_none(msgspec.to_builtins(settings))))
        write_json(folder / "summary.json", _summary(cell, look, unavoided))
        write_manifest(
            folder,
            "ground-tools campaign run",
            seed=seed,
            aircraft=names(look.kinds),
            conflict_limit_m=campaign.SEPARATION_M,
            state=campaign.software(),
        )
    except OSError as error:
        raise ConfigError(f"--runs: {folder}: cannot be written: {error.strerror}") from error
    return folder


def names(kinds: Floats) -> list[str]:
    """Names of the aircraft, in order. The name of an aircraft that does not avoid contains its kind."""
    words = {float(kind): f"-{word}" for word, kind in vehicles.INTRUDERS.items()}
    return [f"uas-{number:03d}{words.get(kind, '')}" for number, kind in enumerate(kinds.tolist(), start=1)]


def _summary(cell: Cell, look: Look, unavoided: Look) -> dict[str, object]:
    row = msgspec.structs.asdict(look.row)
    first, second = row.pop("first"), row.pop("second")
    called = names(look.kinds)
    return {
        **row,
        "severity": look.row.severity,
        "closest": [called[first], called[second]],
        "unavoided_separation_m": unavoided.row.separation_m,
        "delay_s": cell.delay_s,
    }


def _write_flight(folder: Path, look: Look) -> None:
    called = names(look.kinds)
    for i, name in enumerate(called):
        header = Header(aircraft=name, software=__version__, config=_config(look, i, name))
        file = EventFile(folder / f"{name}.events", header)
        try:
            for step in _steps(look, i, called):
                file.step(step)
        finally:
            file.close()
        _write_truth(folder / f"{name}.truth.csv", look, i)


def _write_truth(path: Path, look: Look, i: int) -> None:
    world = look.world
    begin = k.path_position(look.times[i], look.points[i], world.start_s)
    with path.open("w") as file:
        file.write(HEADER + "\n")
        for tick, (north, east, down) in enumerate([begin, *look.trace[:, i].tolist()]):
            utc_s = UTC_AT_START_S + world.start_s + tick * world.step_s
            file.write(f"{utc_s:.3f},{north!r},{east!r},{down!r}\n")


def _config(look: Look, i: int, name: str) -> Config:
    """The configuration that a companion on this aircraft would have."""
    avoidance, world = look.avoidance, look.world
    if look.kinds[i] != vehicles.AVOIDS:
        avoidance = msgspec.structs.replace(avoidance, law="none")
    floor, ceiling = (h if math.isfinite(h) else None for h in (world.floor_m, world.ceiling_m))
    times, places = look.times[i].tolist(), _geodetic(look.points[i])
    return Config(
        identity=IdentityConfig(uas_id=name),
        flight=FlightConfig(use="fly", start="utc", start_utc_s=UTC_AT_START_S),
        limits=msgspec.structs.replace(look.limits[i], floor_height_m=floor, ceiling_height_m=ceiling),
        fence=_areas(look.fence),
        avoidance=avoidance,
        path=TrajectoryFile(
            altitude="msl",
            waypoint=tuple(
                Waypoint(t_s=t, lat_deg=lat, lon_deg=lon, alt_m=alt)
                for t, (lat, lon, alt) in zip(times, places, strict=True)
            ),
        ),
    )


def _areas(fence: Floats) -> tuple[FenceArea, ...]:
    """The polygon of the campaign's fence; empty without a fence."""
    if not len(fence):
        return ()
    corners = np.zeros((len(fence), 3))
    walls = k.Wall(*fence.T)
    corners[:, 0], corners[:, 1] = walls.n, walls.e
    return (FenceArea(inclusion=True, points=tuple((lat, lon) for lat, lon, _ in _geodetic(corners))),)


def _steps(look: Look, i: int, called: list[str]) -> Iterator[Step]:
    """Each decision of one aircraft as a recorded step of a companion."""
    log = outcome.Log(*(array[:, i] for array in look.log))
    places, messages = _geodetic(log.position), _messages(log)
    logged_s = -math.inf
    for d, (lat, lon, alt) in enumerate(places):
        own = outcome.Log(*(array[d] for array in log))
        now, velocity = float(own.time_s), _vec(own.velocity)
        events: list[AnyEvent] = [] if d else [VehicleTime(time_boot_s=now, utc_s=UTC_AT_START_S + now)]
        events.append(
            GlobalPosition(
                time_boot_s=now,
                lat_deg=lat,
                lon_deg=lon,
                alt_msl_m=alt,
                height_above_home_m=-float(own.position[2]),
                velocity_ned_mps=velocity,
            )
        )
        commands: list[AnyCommand] = []
        for j, location in messages.get(d, ()):
            if j == i:
                commands.append(Broadcast(transport=_TRANSPORT, messages=(location,)))
            else:
                address = radio_address(called[j])
                events.append(RemoteIdHeard(transport=_TRANSPORT, address=address, messages=(location,)))
        busy = own.conflict or own.recovering
        if busy or now - logged_s >= _QUIET_LOG_S - 1e-6:
            logged_s = now
            point = k.path_position(look.times[i], look.points[i], now - float(own.late_s))
            commands.append(_decision(own, point, called))
        commands.append(VelocitySetpoint(velocity_ned_mps=_vec(own.flown)))
        yield Step(now_s=now, events=tuple(events), commands=tuple(commands))


def _decision(own: outcome.Log, point: Vec3, called: list[str]) -> Decision:
    """The entry for one decision.

    Args:
        own: the decision's entries of the log, without their first two axes.
        point: the path's point at that time.
    """
    tracks = []
    for j in np.flatnonzero(np.isfinite(own.views[:, 0])).tolist():
        other, view = k.Other(*own.others[j].tolist()), k.Seen(*own.views[j].tolist())
        tracks.append(
            TrackView(
                track_id=called[j],
                position_ned_m=(view.n, view.e, view.d),
                velocity_ned_mps=(other.vn, other.ve, other.vd),
                age_s=other.age_s,
                radius_m=view.radius_m,
                conflict=view.conflict != 0.0,
                time_to_closest_s=view.time_s,
                closest_m=view.distance_m,
                active=view.active != 0.0,
                height_m=view.height_m,
            )
        )
    return Decision(
        origin=ORIGIN,
        position_ned_m=_vec(own.position),
        velocity_ned_mps=_vec(own.velocity),
        wanted_ned_mps=_vec(own.wanted),
        chosen_ned_mps=_vec(own.flown),
        feasible=bool(own.feasible),
        path_ned_m=point,
        tracks=tuple(tracks),
    )


def _vec(v: Floats) -> Vec3:
    n, e, d = v.tolist()
    return n, e, d


def _messages(log: outcome.Log) -> dict[int, list[tuple[int, Location]]]:
    """New messages at each decision, by the index of the decision: sender and Location.

    Args:
        log: the log of one aircraft, without the axis of the aircraft.
    """
    sent = log.message_s
    before = np.vstack([np.full((1, sent.shape[1]), math.nan), sent[:-1]])
    new = np.isfinite(sent) & (sent != before)
    found: dict[int, list[tuple[int, Location]]] = {}
    heard = k.Other(*log.others[new].T)
    places = _geodetic(np.stack([heard.n, heard.e, heard.d], axis=1))
    velocities = np.stack([heard.vn, heard.ve, heard.vd], axis=1).tolist()
    for (d, j), (lat, lon, alt), (north, east, down), sent_s in zip(
        np.argwhere(new).tolist(), places, velocities, sent[new].tolist(), strict=True
    ):
        location = Location(
            lat_deg=lat,
            lon_deg=lon,
            alt_geodetic_m=alt,
            direction_deg=math.degrees(math.atan2(east, north)) % 360.0,
            speed_mps=math.hypot(north, east),
            vertical_speed_mps=-down,
            timestamp_s=(UTC_AT_START_S + sent_s) % 3600.0,
        )
        found.setdefault(d, []).append((j, location))
    return found


def _geodetic(points: Floats) -> list[Vec3]:
    """Latitude, longitude (deg) and height (m) of NED points (n, 3)."""
    if not len(points):
        return []
    lat, lon, alt = pymap3d.ned2geodetic(points[:, 0], points[:, 1], points[:, 2], *ORIGIN)
    return list(zip(lat.tolist(), lon.tolist(), alt.tolist(), strict=True))
