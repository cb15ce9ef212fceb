"""A recording made on a real firmware, and the same script's frames at the same times against the mock.

The recordings hold both directions: component 1 is the autopilot, 191 or 236 the script that flew it.
"""

from __future__ import annotations

import gzip
import io
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.tlog import read_tlog
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from sitl_mocks.vehicle.mock_vehicle import STEP_S, MockVehicle, VehicleOptions

REPOSITORY = Path(__file__).parents[3]
THINNED = REPOSITORY / "tests" / "data"
FULL = REPOSITORY.parent / "shared" / "data" / "mavlink"
_SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
_TAIL_S = 4.0


@dataclass(slots=True)
class Flight:
    """Messages of one autopilot, in order, with their times since the start of the recording (s)."""

    said: list[tuple[float, Any]] = field(default_factory=list)
    flown: list[tuple[float, int]] = field(default_factory=list)
    """The mock's true mode after every step; a recording shows it by its heartbeats only."""

    def of(self, *names: str) -> list[tuple[float, Any]]:
        """Messages with one of these names."""
        return [(t, m) for t, m in self.said if m.get_type() in names]

    def acks(self) -> list[tuple[int, int]]:
        """Command and result of every COMMAND_ACK."""
        return [(m.command, m.result) for _, m in self.of("COMMAND_ACK")]

    def changes(self, name: str, *keys: str) -> list[tuple[float, Any]]:
        """Times at which fields of a message changed, and their new values."""
        found: list[tuple[float, Any]] = []
        for t, m in self.of(name):
            value = tuple(getattr(m, key) for key in keys)
            if not found or found[-1][1] != value:
                found.append((t, value))
        return found

    def motion(self) -> np.ndarray:
        """LOCAL_POSITION_NED, shape (n, 7): time (s), position (m) and velocity (m/s) in NED."""
        return np.array([(t, m.x, m.y, m.z, m.vx, m.vy, m.vz) for t, m in self.of("LOCAL_POSITION_NED")])

    def rate_hz(self, name: str, start_s: float, end_s: float) -> float:
        """Rate of a message (Hz)."""
        return sum(start_s <= t < end_s for t, _ in self.of(name)) / (end_s - start_s)


@dataclass(slots=True)
class Recording:
    """A recorded flight, and the frames that the script sent with their times (s)."""

    flown: Flight
    sent: list[tuple[float, bytes]]


def path_of(name: str, kind: str) -> Path | None:
    """Path of a recording; None if it does not exist."""
    path = FULL / f"{name}.tlog" if kind == "full" else THINNED / f"{name}.tlog.gz"
    return path if path.exists() else None


def read(path: Path) -> Recording:
    """Read a recording. In a thinned one every second setpoint is put back."""
    thinned = path.suffix == ".gz"
    data = gzip.decompress(path.read_bytes()) if thinned else path.read_bytes()
    recording = Recording(Flight(), [])
    reader = MavlinkReader()
    start_s: float | None = None
    for utc_s, raw in read_tlog(io.BytesIO(data), path.name):
        start_s = utc_s if start_s is None else start_s
        if raw[6] == 1:
            recording.flown.said += [(utc_s - start_s, m) for m in reader.feed(raw)]
        else:
            recording.sent.append((utc_s - start_s, raw))
    if thinned:
        recording.sent = _with_all_setpoints(recording.sent)
    return recording


def _with_all_setpoints(sent: list[tuple[float, bytes]]) -> list[tuple[float, bytes]]:
    """A copy of each setpoint half an interval after it: the thinned recordings hold every second one."""
    at = [(t, raw) for t, raw in sent if int.from_bytes(raw[7:10], "little") == _SETPOINT]
    gaps = [later - t for (t, _), (later, _) in pairwise(at)]
    copies = [
        (t + min(gap, before) / 2.0, raw)
        for (t, raw), before, gap in zip(at, gaps[:1] + gaps, [*gaps, *gaps[-1:]], strict=True)
    ]
    return sorted(sent + copies, key=lambda each: each[0])


def replay(recording: Recording, options: VehicleOptions, asked: dict[int, float]) -> Flight:
    """Fly the mock with the recorded script.

    `asked` are the rates (message id -> Hz) that had been asked for before the recording began.
    """
    vehicle = MockVehicle(options, np.random.default_rng(1))
    flight, reader, writer = Flight(), MavlinkReader(), MavlinkWriter(1, 191)
    for number, hertz in asked.items():
        command = (1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 / hertz, 0, 0, 0, 0, 0)
        vehicle.receive(writer.pack(mavlink.MAVLink_command_long_message(*command)), 0.0)
    vehicle.drain()

    def listen(now_s: float) -> None:
        flight.said.extend((now_s, m) for m in reader.feed(vehicle.drain()))
        flight.flown.append((now_s, vehicle.custom_mode))

    def advance(until_s: float) -> None:
        while vehicle.now_s + STEP_S <= until_s:
            vehicle.advance(vehicle.now_s + STEP_S)
            listen(vehicle.now_s)

    for t, raw in recording.sent:
        advance(t)
        vehicle.receive(raw, t)
        listen(t)
    advance(recording.sent[-1][0] + _TAIL_S)
    return flight


def fields_of(message: Any) -> tuple[tuple[str, Any], ...]:
    """Name and fields of a message; NaN as text, so that they compare."""
    values = message.to_dict().items()
    return tuple((k, "nan" if isinstance(v, float) and v != v else v) for k, v in values)
