"""A run folder of synthetic steps: two crossing aircraft, with everything that a record may contain."""

from __future__ import annotations

import functools
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion import event_record
from companion.config import AvoidanceConfig, Config, FlightConfig, IdentityConfig
from companion.event_record import Header, Step
from companion.events import (
    AnyCommand,
    AnyEvent,
    AuthorityChanged,
    Broadcast,
    Decision,
    FlightMode,
    GlobalPosition,
    ModeRefused,
    RemoteIdHeard,
    Say,
    Severity,
    TrackView,
    VehicleText,
    VehicleTime,
)
from companion.geometry import LocalFrame, Vec3
from companion.remote_id.messages import Location
from tests.support.place import HOME

UTC_S = 1_767_225_590.0
Motion = Callable[[float], Vec3]


def northbound(t: float) -> Vec3:
    """Position at a time: north through the crossing at 30 s, at 5 m/s."""
    return (5.0 * (t - 30.0), 0.0, -50.0)


@functools.cache
def eastbound(miss_m: float) -> Motion:
    """Crosses the northbound path `miss_m` north of where the other then is: closest at miss / sqrt(2)."""
    return lambda t: (miss_m, 5.0 * (t - 30.0), -50.0)


def position_event(position: Vec3, t: float) -> GlobalPosition:
    lat, lon, alt = HOME.to_geodetic(*position)
    return GlobalPosition(
        time_boot_s=t,
        lat_deg=lat,
        lon_deg=lon,
        alt_msl_m=alt,
        height_above_home_m=-position[2],
        velocity_ned_mps=(0.0, 0.0, 0.0),
    )


@functools.cache
def steps(
    me: Motion,
    other: Motion,
    clock_s: float = 0.0,
    *,
    utc: bool = True,
    positions: bool = True,
    end_s: float = 60.0,
) -> list[Step]:
    """Steps at 10 Hz; decisions at 5 Hz in a frame whose origin is not the common one."""
    origin = HOME.to_geodetic(20.0, -30.0, 0.0)
    frame = LocalFrame(*origin)
    found = []
    for tick in range(int(end_s * 10) + 1):
        t = tick / 10
        events: list[AnyEvent] = []
        commands: list[AnyCommand] = []
        if positions:
            events.append(position_event(me(t), t))
        if tick % 10 == 0:
            lat, lon, alt = HOME.to_geodetic(*other(max(t - 0.5, 0.0)))
            place = Location(lat_deg=lat, lon_deg=lon, alt_geodetic_m=alt)
            events.append(RemoteIdHeard(transport="wifi", address="c2:00:00:00:00:02", messages=(place,)))
            commands.append(Broadcast(transport="wifi", messages=(Location(lat_deg=lat, lon_deg=lon),)))
            if utc:
                events.append(VehicleTime(time_boot_s=t, utc_s=UTC_S + t))
        if tick % 2 == 0:
            commands.append(decision(frame, me(t), other(t)))
        if tick == 50:
            commands.append(
                AuthorityChanged(
                    previous="watching", state="flying", trigger="engaged", reason="mode confirmed"
                )
            )
            commands.append(Say(severity=Severity.NOTICE, text="companion flies"))
        if tick == 100:
            events.append(VehicleText(severity=2, text="battery low"))
            events.append(ModeRefused(mode=FlightMode.EXTERNAL, reason="denied"))
        found.append(Step(now_s=t + clock_s, events=tuple(events), commands=tuple(commands)))
    return found


def decision(frame: LocalFrame, me: Vec3, other: Vec3) -> Decision:
    still = (0.0, 0.0, 0.0)
    track = TrackView(
        track_id="DMUCA002",
        position_ned_m=frame.to_ned(*HOME.to_geodetic(*other)),
        velocity_ned_mps=still,
        age_s=0.5,
        radius_m=10.0,
        conflict=math.dist(me, other) < 20.0,
        time_to_closest_s=1.0,
        closest_m=3.0,
    )
    return Decision(
        origin=(frame.lat_deg, frame.lon_deg, frame.alt_m),
        position_ned_m=frame.to_ned(*HOME.to_geodetic(*me)),
        velocity_ned_mps=still,
        wanted_ned_mps=still,
        chosen_ned_mps=still,
        feasible=True,
        tracks=(track,),
    )


def write_events(
    folder: Path, name: str, found: list[Step], radius_m: float = 5.0, start_utc_s: float | None = None
) -> Path:
    """Write `<name>.events` into `folder`, which is created."""
    folder.mkdir(parents=True, exist_ok=True)
    config = Config(
        identity=IdentityConfig(uas_id=name),
        avoidance=AvoidanceConfig(conflict_radius_m=radius_m),
        flight=FlightConfig(start="engage" if start_utc_s is None else "utc", start_utc_s=start_utc_s),
    )
    header = Header(aircraft=name, software="test", config=config)
    path = folder / f"{name}.events"
    path.write_bytes(event_record.MAGIC + b"".join(event_record.encode(r) for r in (header, *found)))
    return path


def write_truth(folder: Path, name: str, motion: Motion, period_s: float = 0.1) -> Path:
    """Write `<name>.truth.csv` for the minute of `steps`."""
    rows = ["utc_s,north_m,east_m,down_m"]
    for tick in range(round(60.0 / period_s) + 1):
        north, east, down = motion(tick * period_s)
        rows.append(f"{UTC_S + tick * period_s:.3f},{north:.3f},{east:.3f},{down:.3f}")
    path = folder / f"{name}.truth.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with a closest approach of 20 / sqrt(2) m with avoidance and 2 / sqrt(2) m without. Shared
    and read-only: use `run_folder` to change it."""
    folder = tmp_path_factory.mktemp("built")
    for where, miss in ((folder, 20.0), (folder / "unavoided", 2.0)):
        write_events(where, "DMUCA001", steps(northbound, eastbound(miss)))
        write_events(where, "DMUCA002", steps(eastbound(miss), northbound))
    (folder / "manifest.json").write_text(json.dumps({"what": "test", "seed": 1}))
    (folder / "summary.json").write_text(json.dumps({"ok": True}))
    return folder


@pytest.fixture
def run_folder(tmp_path: Path, built: Path) -> Path:
    """A copy of the run folder that the test may change."""
    return Path(shutil.copytree(built, tmp_path / "20260101T000000Z-demo"))


@pytest.fixture
def made() -> SimpleNamespace:
    """The functions with which a test can build its own run folder."""
    return SimpleNamespace(
        steps=steps,
        write_events=write_events,
        write_truth=write_truth,
        northbound=northbound,
        eastbound=eastbound,
        home=HOME,
        utc_s=UTC_S,
    )
