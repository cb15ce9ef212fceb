"""A flight of a campaign as a run folder, for `ground-tools inspect` and `picture`.

The folder records the compiled flight itself: the true positions, what each decision saw and what was
commanded. Only the law flew, not the whole companion. The records therefore contain no authority state, and
`companion replay` has nothing to compare with them. A message counts as received at the first decision that
knew it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pymap3d
import tomli_w
from numpy.typing import NDArray

from companion import __version__
from companion.avoidance import kernels as k
from companion.avoidance.law import on_plane
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
from ground_tools.campaign import flight, vehicles
from ground_tools.campaign.cells import Cell, Look
from ground_tools.inspect.read.truth import HEADER, ORIGIN
from sitl_mocks.encounters.lockstep import UTC_AT_START_S

Array = NDArray[np.float64]

MOST_AIRCRAFT = 50
"""Largest number of aircraft. The record of what each decision saw of each other aircraft grows with its
square."""
_TRANSPORT = "wifi"
_QUIET_LOG_S = 1.0
"""Interval at which decisions are recorded. As in a companion's record, every decision that sees a conflict
or recovers is recorded too."""


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


def names(kinds: Array) -> list[str]:
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
    """The configuration that a companion aboard this aircraft would have."""
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


def _areas(fence: Array) -> tuple[FenceArea, ...]:
    """The polygon of the campaign's fence; empty without a fence."""
    if not len(fence):
        return ()
    corners = np.zeros((len(fence), 3))
    corners[:, :2] = fence[:, k.W_FROM : k.W_TO]
    return (FenceArea(inclusion=True, points=tuple((lat, lon) for lat, lon, _ in _geodetic(corners))),)


def _steps(look: Look, i: int, called: list[str]) -> Iterator[Step]:
    """Each decision of one aircraft as a recorded step of a companion."""
    decided, seen = look.decided[:, i], look.seen[:, i]
    places, messages = _geodetic(decided[:, :3]), _messages(seen)
    logged_s = -math.inf
    for d, row in enumerate(decided.tolist()):
        own, out = row[: k.OWN_ENTRIES], row[k.OWN_ENTRIES :]
        now, (lat, lon, alt) = own[k.O_NOW], places[d]
        events: list[AnyEvent] = [] if d else [VehicleTime(time_boot_s=now, utc_s=UTC_AT_START_S + now)]
        events.append(
            GlobalPosition(
                time_boot_s=now,
                lat_deg=lat,
                lon_deg=lon,
                alt_msl_m=alt,
                height_above_home_m=-own[2],
                velocity_ned_mps=(own[3], own[4], own[5]),
            )
        )
        commands: list[AnyCommand] = []
        for j, location in messages.get(d, ()):
            if j == i:
                commands.append(Broadcast(transport=_TRANSPORT, messages=(location,)))
            else:
                address = radio_address(called[j])
                events.append(RemoteIdHeard(transport=_TRANSPORT, address=address, messages=(location,)))
        busy = out[k.R_CONFLICT] or out[k.R_RECOVERING]
        if busy or now - logged_s >= _QUIET_LOG_S - 1e-6:
            logged_s = now
            point = k.path_position(look.times[i], look.points[i], now - out[k.R_LATE])
            commands.append(_decision(own, out, point, seen[d], called))
        commands.append(VelocitySetpoint(velocity_ned_mps=(out[0], out[1], out[2])))
        yield Step(now_s=now, events=tuple(events), commands=tuple(commands))


def _decision(own: list[float], out: list[float], point: Vec3, seen: Array, called: list[str]) -> Decision:
    tracks = []
    for j in np.flatnonzero(np.isfinite(seen[:, flight.SEEN_VIEW])).tolist():
        heard = seen[j, flight.SEEN_NEIGHBOUR : flight.SEEN_VIEW].tolist()
        view = seen[j, flight.SEEN_VIEW :].tolist()
        tracks.append(
            TrackView(
                track_id=called[j],
                position_ned_m=(view[0], view[1], view[2]),
                velocity_ned_mps=(heard[3], heard[4], heard[5]),
                age_s=heard[k.N_AGE],
                radius_m=view[k.V_RADIUS],
                conflict=view[k.V_CONFLICT] != 0.0,
                time_to_closest_s=view[k.V_TIME],
                closest_m=view[k.V_DISTANCE],
                active=any(
                    on_plane(view[at : at + 4], out[k.R_SOLVED : k.R_SOLVED + 3])
                    for at in (k.V_PLANE, k.V_STANDING)
                ),
            )
        )
    return Decision(
        origin=ORIGIN,
        position_ned_m=(own[0], own[1], own[2]),
        velocity_ned_mps=(own[3], own[4], own[5]),
        wanted_ned_mps=(out[3], out[4], out[5]),
        chosen_ned_mps=(out[0], out[1], out[2]),
        feasible=out[k.R_FEASIBLE] != 0.0,
        path_ned_m=point,
        tracks=tuple(tracks),
    )


def _messages(seen: Array) -> dict[int, list[tuple[int, Location]]]:
    """The messages that are new at each decision, by the number of the decision: sender and Location.

    Args:
        seen: shape (decisions, A, flight.SEEN_COLUMNS), what one aircraft saw.
    """
    sent = seen[:, :, flight.SEEN_MESSAGE]
    before = np.vstack([np.full((1, sent.shape[1]), math.nan), sent[:-1]])
    new = np.isfinite(sent) & (sent != before)
    found: dict[int, list[tuple[int, Location]]] = {}
    rows = seen[new]
    for (d, j), place, row in zip(
        np.argwhere(new).tolist(), _geodetic(rows[:, 1:4]), rows.tolist(), strict=True
    ):
        (lat, lon, alt), (north, east, down) = place, row[4:7]
        location = Location(
            lat_deg=lat,
            lon_deg=lon,
            alt_geodetic_m=alt,
            direction_deg=math.degrees(math.atan2(east, north)) % 360.0,
            speed_mps=math.hypot(north, east),
            vertical_speed_mps=-down,
            timestamp_s=(UTC_AT_START_S + row[flight.SEEN_MESSAGE]) % 3600.0,
        )
        found.setdefault(d, []).append((j, location))
    return found


def _geodetic(points: Array) -> list[Vec3]:
    """Latitude, longitude (deg) and height (m) of NED points (n, 3)."""
    if not len(points):
        return []
    lat, lon, alt = pymap3d.ned2geodetic(points[:, 0], points[:, 1], points[:, 2], *ORIGIN)
    return list(zip(lat.tolist(), lon.tolist(), alt.tolist(), strict=True))
