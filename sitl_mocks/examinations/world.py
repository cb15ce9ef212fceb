"""One vehicle with one companion in virtual time, with a modelled link between them and a judge.

The companion is stepped like in its flight loop: twenty times a second, and immediately when it resumes after
a stall. Everything is drawn from one seed. The whole world can be pickled (`snapshot`) and continued.
"""

from __future__ import annotations

import heapq
import io
import math
import pickle
import struct
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialects.definition import Dialect
from companion.autopilot.lists.mission import NAV_RETURN_TO_LAUNCH, NAV_TAKEOFF, NAV_WAYPOINT
from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.config import Config, FlightConfig, IdentityConfig, LimitsConfig
from companion.events import Firmware, MissionItem, RadioState
from companion.radio.null.section import NullRadio
from companion.system import CompanionSystem
from sitl_mocks.examinations.crossing import Crossing
from sitl_mocks.examinations.faults import Fault, begin, end, others_frames
from sitl_mocks.examinations.modelled_link import ModelledLink
from sitl_mocks.examinations.rule_judge import Bounds, Judge
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode
from sitl_mocks.vehicle.firmware.kinds import Manners
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import HOME, VehicleOptions

Use = Literal["guard", "fly"]
Held = TypeVar("Held")
TICK_S: Final = 0.05
UTC_AT_ZERO_S: Final = 1_767_225_600.0
HEIGHT_M: Final = 40.0
_WAYPOINTS: Final = ((0.0, 0.0), (200.0, 0.0), (200.0, 150.0), (0.0, 150.0))
_FRAME: Final = int(mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_LIMITS: Final = LimitsConfig(max_speed_mps=6.0)
_SHARED: Final = (Config, Manners, VehicleOptions, Dialect, struct.Struct)
"""Types of immutable objects, which snapshots share instead of copying."""


class World:
    """The complete state of one flight, except a plan for it.

    Args:
        seed: seed of every draw.
        link: link of the companion; None: UDP behind a router, read until nothing waits.
    """

    def __init__(self, firmware: Firmware, use: Use, seed: int, link: ModelledLink | None = None) -> None:
        self.firmware = firmware
        self.use: Use = use
        noise, others, way = (np.random.default_rng((seed, n)) for n in range(3))
        self.vehicle: MockVehicle = MockVehicle(
            VehicleOptions(
                firmware=firmware,
                mission=mission(int(MANNERS[firmware].home_is_item_zero)),
                utc_at_zero_s=UTC_AT_ZERO_S,
                gnss_horizontal_sigma_m=1.0,
                gnss_vertical_sigma_m=1.5,
                gnss_velocity_sigma_mps=0.1,
                mission_speed_mps=4.0,
            ),
            noise,
        )
        self.link = ModelledLink("udp", way) if link is None else link
        self.judge = Judge(bounds_of(firmware, use), system_id=self.vehicle.options.system_id)
        self.others = Crossing(HOME, HEIGHT_M, UTC_AT_ZERO_S, others)
        self.onboard = new_companion(use)
        self.now_s = 0.0
        self.traffic_hz = 0.0
        """Rate of foreign frames that a router sends to the companion."""
        self._traffic = others_frames()
        self._traffic_n = 0
        self._stands: tuple[float, float] | None = None
        """Begin and end of the companion's stall."""
        self._stopped_in_step = False
        self._decided_s: float | None = None
        self._stepped_s = 0.0
        self._scanner = FrameScanner(keep_unknown=True)
        self._writer = MavlinkWriter(255, 190)
        self._due: list[tuple[float, int, bool, Fault]] = []
        self._faults = 0

    # ------------------------------------------------------------ faults

    def plan(self, *faults: Fault) -> None:
        """Schedule faults."""
        for fault in faults:
            self._faults += 1
            heapq.heappush(self._due, (fault.at_s, self._faults, True, fault))

    def began(self, fault: Fault) -> None:
        """Called when a fault begins. Subclasses may override it to keep a record."""

    def stop(self, for_s: float, *, in_step: bool) -> None:
        """Stall the companion: it reads and sends nothing.

        Args:
            in_step: stall between a step and its sending; otherwise while the companion waits for bytes.
        """
        until_s = (self._next_step_s() if in_step else self.now_s) + for_s
        if self._stands is not None and self._stands[1] > self.now_s:
            self._stands = self._stands[0], max(until_s, self._stands[1])
            return
        self._stands, self._stopped_in_step = (self.now_s, until_s), in_step

    def restart_companion(self) -> None:
        """Start the companion again, in flight or on the ground."""
        self.onboard = new_companion(self.use)
        self.link.clear()

    def pilot_selects(self, *modes: VehicleMode) -> bool:
        """See `Place.pilot_selects`. The pilot uses a switch."""
        self.show()
        taken = False
        for mode in modes:
            taken = self.vehicle.pilot_selects(mode)
            if taken:
                self.judge.selects(self.now_s, MANNERS[self.firmware].custom_modes[mode])
            self.show()
            if taken:
                self.judge.accepted(self.now_s)
        return taken

    def set_trouble(self, name: str, value: Any) -> None:
        """See `Place.set_trouble`."""
        self.vehicle.troubles.set(name, value)

    def station_says(self, kind: str, *fields: Any) -> None:
        """Send a ground station's message on a separate link. It is closed again to save telemetry time."""
        message = getattr(self._writer.encoder, f"{kind}_encode")(*fields)
        self.vehicle.receive(self._writer.pack(message), self.now_s, 1)
        self.vehicle.close_link(1)
        self.show()

    def show(self) -> None:
        """Report the vehicle's mode to the judge. Call it whenever the mode may have changed."""
        self.judge.shows(self.now_s, self.vehicle.custom_mode, armed=self.vehicle.armed)

    # ------------------------------------------------------------ one step

    def step(self) -> None:
        """Advance to the companion's next step, with all events before it."""
        while self._due and self._due[0][0] <= self._next_step_s():
            at_s, number, begins, fault = heapq.heappop(self._due)
            self._fly_to(max(at_s, self.now_s))
            if not begins:
                end(self, fault)
                continue
            begin(self, fault)
            self.began(fault)
            if fault.lasts_s > 0.0:
                heapq.heappush(self._due, (fault.at_s + fault.lasts_s, number, False, fault))
        self._fly_to(self._next_step_s())
        self._step_companion()

    def _next_step_s(self) -> float:
        next_s = round((math.floor(self._stepped_s / TICK_S + 1e-6) + 1) * TICK_S, 6)
        if self._stands is not None and self._stands[0] < next_s and not self._stopped_in_step:
            return max(next_s, self._stands[1])
        if self._decided_s is not None and self._stands is not None:
            return max(next_s, self._stands[1])
        return next_s

    def _fly_to(self, until_s: float) -> None:
        while self.now_s < until_s:
            before_s, self.now_s = self.now_s, min(until_s, round(self.now_s + TICK_S, 6))
            self.vehicle.advance(self.now_s)
            self.show()
            self._tell(before_s)
            self._take()

    def _tell(self, before_s: float) -> None:
        """Send the frames of the vehicle and of others to the companion, in the order of sending."""
        vehicle, now_s = self.vehicle, self.now_s
        frames = [frame.raw for frame in self._scanner.frames(vehicle.drain())]
        if self.traffic_hz > 0.0:
            first, last = (math.floor(at_s * self.traffic_hz) for at_s in (before_s, now_s))
            foreign = [self._traffic[n % len(self._traffic)] for n in range(first, last)]
            half = len(foreign) // 2
            frames = foreign[:half] + frames + foreign[half:]
        if frames:
            self.link.tell(now_s, frames)

    def _take(self) -> None:
        """Deliver the bytes that have reached the vehicle."""
        for decided_s, data in self.link.arrived(self.now_s):
            self.judge.reaches(self.now_s, data, decided_s)
            self.vehicle.receive(data, self.now_s)
            self.show()

    def _step_companion(self) -> None:
        now_s, onboard = self.now_s, self.onboard
        late = now_s - self._stepped_s > 1.5 * TICK_S
        self._stepped_s = now_s
        portions = self.link.portions if late else None
        if self._decided_s is not None:
            # The companion stood still between a step and its sending, so the loop reads once less before the
            # next step.
            decided_s, self._decided_s = self._decided_s, None
            self._send(onboard.drain(now_s), decided_s)
            portions = None if portions is None else max(1, portions - 1)
        stands = self._stands
        if stands is not None and stands[1] <= now_s:
            self._stands = stands = None
        self.judge.reads(now_s, self.link.news(now_s))
        for heard in self.others.heard(now_s, self.vehicle.position_ned_m, self.vehicle.velocity_ned_mps):
            onboard.hear(heard)
        emptied = self._read(portions)
        onboard.tick(now_s, read_s=now_s if emptied else -math.inf)
        if stands is not None:
            self._decided_s = now_s
        else:
            self._send(onboard.drain(now_s), now_s)

    def _read(self, portions: int | None) -> bool:
        """Read waiting bytes. Returns whether nothing waits any more."""
        link, read = self.link, 0
        while link.waiting and (portions is None or read < portions):
            read += 1
            data = link.read()
            self.onboard.receive(data, self.now_s, emptied=not link.waiting)
        return not link.waiting

    def _send(self, data: bytes, decided_s: float) -> None:
        if data:
            self.judge.leaves(self.now_s, data)
            self.link.send(self.now_s, data, decided_s)
        self._take()

    # ------------------------------------------------------------ copies

    def snapshot(self) -> Snapshot:
        """Save the current state of the world, which can be continued any number of times."""
        return Snapshot(self)


class Saved(Generic[Held]):
    """An object as it was at one moment, such as a simulation that is continued several times.

    Raises (on creation):
        pickle.PicklingError, AttributeError: the object holds something that cannot be copied.
    """

    def __init__(self, held: Held) -> None:
        self.shared: list[object] = []
        file = io.BytesIO()
        _Pickler(file, self.shared).dump(held)
        self._data = file.getvalue()

    def copy(self) -> Held:
        """A copy that shares no mutable object with any other copy."""
        held: Held = _Unpickler(io.BytesIO(self._data), self.shared).load()
        return held


class Snapshot(Saved[World]):
    """A saved world. Every continuation starts from the same moment."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.now_s = world.now_s
        self.firmware, self.use = world.firmware, world.use
        self.mode = world.vehicle.mode

    def world(self) -> World:
        """A copy that shares no mutable object with any other copy."""
        return self.copy()


class _Pickler(pickle.Pickler):
    """Pickler that fails on objects it cannot copy, such as a function that closes over another object."""

    def __init__(self, file: io.BytesIO, shared: list[object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._shared = shared

    def persistent_id(self, obj: object) -> int | None:
        if not isinstance(obj, _SHARED):
            return None
        self._shared.append(obj)
        return len(self._shared) - 1


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, shared: list[object]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, pid: int) -> object:
        return self._shared[pid]


def bounds_of(firmware: Firmware, use: Use, limits: LimitsConfig = _LIMITS) -> Bounds:
    """Limits of a companion on this firmware. The default limits are those of `new_companion`."""
    modes = MANNERS[firmware].custom_modes
    given = {VehicleMode.MISSION}
    if use == "fly":
        given |= {VehicleMode.EXTERNAL} | ({VehicleMode.HOLD} if firmware is Firmware.PX4 else set())
    return Bounds(
        max_speed_mps=limits.max_speed_mps,
        max_climb_mps=limits.max_climb_mps,
        max_descent_mps=limits.max_descent_mps,
        external=modes[VehicleMode.EXTERNAL],
        given=frozenset(modes[mode] for mode in given),
        px4_modes=firmware is Firmware.PX4,
    )


def new_companion(use: Use) -> CompanionSystem:
    """A companion that has not received anything yet."""
    fly = {"trajectory": "mission", "mission_speed_mps": 4.0} if use == "fly" else {}
    onboard = CompanionSystem(
        Config(
            identity=IdentityConfig(uas_id="SOAK"),
            flight=FlightConfig(use=use, **fly),  # type: ignore[arg-type]
            limits=_LIMITS,
            radio=(NullRadio(),),
        )
    )
    onboard.hear(RadioState(can_send=("wifi",)))
    return onboard


def mission(first: int) -> tuple[MissionItem, ...]:
    """Mission with take-off, three rounds of a rectangle and return; `first` is the first item's number."""
    points = [
        (NAV_TAKEOFF, *_WAYPOINTS[0]),
        *((NAV_WAYPOINT, *point) for point in 3 * _WAYPOINTS[1:] + _WAYPOINTS[:1]),
    ]
    items = []
    for number, (command, north, east) in enumerate(points):
        lat_deg, lon_deg, _ = HOME.to_geodetic(north, east, 0.0)
        items.append(
            MissionItem(
                seq=first + number,
                command=command,
                frame=_FRAME,
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                alt_m=HEIGHT_M,
            )
        )
    return (*items, MissionItem(seq=first + len(items), command=NAV_RETURN_TO_LAUNCH, frame=_FRAME))
