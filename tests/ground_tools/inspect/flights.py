"""Records of real cores in which guarded missions meet, and parts with which tests build records."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from companion import event_record
from companion.authority.table import State
from companion.config import Config
from companion.event_record import Header, Step
from companion.events import AnyCommand, AnyEvent, Decision, Firmware, GlobalPosition, TrackView
from companion.geometry import Vec3
from ground_tools.inspect import command
from ground_tools.inspect.read.read_run import AircraftRecord, read_run
from tests.sitl_mocks.with_companion.guarding import head_on
from tests.support.place import HOME


def inspect(*arguments: object) -> int:
    """Run `ground-tools inspect` in this process. Returns its exit code."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(a) for a in arguments]))


@functools.cache
def guarded() -> tuple[tuple[Config, tuple[Step, ...]], ...]:
    """ONE guards its mission and meets TWO head-on, which only broadcasts. The mission is resumed."""
    sky = head_on(Firmware.ARDUPILOT)
    one = sky.aircraft[0]
    sky.until(lambda: one.state is State.AVOIDING)
    sky.until(lambda: one.state is State.WATCHING)
    sky.run(3.0)
    return tuple((a.config, tuple(a.steps)) for a in sky.aircraft)


def write(folder: Path, config: Config, steps: Iterable[Step]) -> Path:
    """Write the event record of one aircraft into a new folder."""
    folder.mkdir(parents=True, exist_ok=True)
    name = config.identity.uas_id
    entries = (Header(aircraft=name, software="test", config=config), *steps)
    path = folder / f"{config.identity.file_name}.events"
    path.write_bytes(event_record.MAGIC + b"".join(event_record.encode(entry) for entry in entries))
    return path


def read(folder: Path, config: Config, steps: Iterable[Step]) -> AircraftRecord:
    """Write such a record and read it back."""
    write(folder, config, steps)
    return read_run(folder).aircraft[0]


def track(name: str = "TWO", **over: Any) -> TrackView:
    """A track head-on: 200 m ahead of an aircraft that flies north and 1 m above it, closing at 10 m/s."""
    values: dict[str, Any] = {
        "position_ned_m": (200.0, 0.0, -51.0),
        "velocity_ned_mps": (-5.0, 0.0, 0.0),
        "age_s": 1.0,
        "radius_m": 14.0,
        "conflict": True,
        "active": True,
        "time_to_closest_s": 20.0,
        "closest_m": 1.0,
    }
    return TrackView(track_id=name, **(values | over))


def decision(
    *tracks: TrackView, chosen: Vec3 = (5.0, 0.0, 0.0), wanted: Vec3 = (5.0, 0.0, 0.0), **over: Any
) -> Decision:
    """Decision of an aircraft that flies north at 5 m/s, 50 m above the origin."""
    values: dict[str, Any] = {
        "origin": (HOME.lat_deg, HOME.lon_deg, HOME.alt_m),
        "position_ned_m": (0.0, 0.0, -50.0),
        "velocity_ned_mps": (5.0, 0.0, 0.0),
        "feasible": True,
    }
    return Decision(wanted_ned_mps=wanted, chosen_ned_mps=chosen, tracks=tracks, **(values | over))


def step(now_s: float, *commands: AnyCommand, events: tuple[AnyEvent, ...] = ()) -> Step:
    """A step with a position, so that the record can be drawn."""
    place = GlobalPosition(
        time_boot_s=now_s,
        lat_deg=HOME.lat_deg + 4.5e-5 * now_s,
        lon_deg=HOME.lon_deg,
        alt_msl_m=450.0,
        height_above_home_m=50.0,
        velocity_ned_mps=(5.0, 0.0, 0.0),
    )
    return Step(now_s=now_s, events=(place, *events), commands=commands)
