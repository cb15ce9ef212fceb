"""Aircraft that fly their own missions and are guarded, in virtual time over real bytes; who is to be met."""

from __future__ import annotations

import functools
import math

import numpy as np

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.config import Config, FlightConfig, IdentityConfig, LimitsConfig, VehicleConfig
from companion.events import AuthorityChanged, Firmware, MissionItem, RadioState, Say, VelocitySetpoint
from companion.radio.frames_io import FrameReceiver, FrameSender, radio_address
from companion.radio.null.section import NullRadio
from companion.system import CompanionSystem
from sitl_mocks.examinations.world import Saved
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions
from tests.support.place import HOME

TICK_S = 0.05
DELAY_TICKS = 10
"""From one radio to the other: 0.5 s."""


def item(seq, north_m, east_m, height_m=50.0, command=16, **over):
    lat, lon, _ = HOME.to_geodetic(north_m, east_m, 0.0)
    values = {"params": (0.0, 0.0, 0.0, 0.0), "lat_deg": lat, "lon_deg": lon, "alt_m": height_m, **over}
    return MissionItem(seq=seq, command=command, frame=6, **values)


def mission(*points, first=1):
    """Take-off, then waypoints (north, east, height)."""
    items = [item(first, *points[0], command=22)]
    return (*items, *(item(first + k, *point) for k, point in enumerate(points, 1)))


class Guarded:
    """Vehicle and companion. `guarded=False`: the companion only broadcasts; `chosen=False`: it is not told
    which vehicle is its own."""

    def __init__(
        self,
        name,
        firmware,
        points,
        *,
        guarded=True,
        number=1,
        config=None,
        start_s=0.0,
        take_in_flight=True,
        chosen=True,
        **options,
    ):
        start = points[0]
        self.vehicle = MockVehicle(
            VehicleOptions(
                **{
                    "firmware": firmware,
                    "system_id": number,
                    "mission": mission(*points, first=1 if firmware is Firmware.ARDUPILOT else 0),
                    "utc_at_zero_s": 1_767_225_600.0,
                    "airborne": True,
                    "start_position_ned_m": (start[0], start[1], -start[2]),
                    "start_mode": VehicleMode.MISSION,
                    "mission_speed_mps": 5.0,
                    **options,
                }
            ),
            np.random.default_rng(number),
            start_s,
        )
        self.config = Config(
            identity=IdentityConfig(uas_id=name),
            vehicle=VehicleConfig(system_id=number if chosen else 0),
            flight=FlightConfig(use="guard" if guarded else "watch", take_in_flight=take_in_flight),
            limits=LimitsConfig(max_speed_mps=8.0),
            radio=(NullRadio(),),
        )
        self.steps = []
        self.onboard = CompanionSystem(self.config, self.steps.append)
        self.sender = FrameSender(radio_address(name))
        self.onboard.hear(RadioState(can_send=("wifi",), own_addresses=(self.sender.address,)))
        self.places = []
        self.modes = []
        self.to_vehicle = []
        """Bytes of each tick."""
        self.linked = True

    def upload(self, items, now_s):
        """A ground station uploads another mission to the vehicle, on a separate link."""
        station, reader = MavlinkWriter(255, 190), MavlinkReader()
        home = self.vehicle.options.firmware is Firmware.ARDUPILOT
        all_items = ((item(0, 0.0, 0.0, 400.0),) if home else ()) + tuple(items)
        encoder, system = station.encoder, self.vehicle.options.system_id
        self.vehicle.receive(
            station.pack(encoder.mission_count_encode(system, 1, len(all_items), 0)), now_s, 1
        )
        while True:
            messages = {m.get_type(): m for m in reader.feed(self.vehicle.drain(1))}
            if "MISSION_ACK" in messages:
                assert messages["MISSION_ACK"].type == 0
                return
            asked = messages.get("MISSION_REQUEST_INT") or messages["MISSION_REQUEST"]
            one = all_items[asked.seq]
            x, y = round(one.lat_deg * 1e7), round(one.lon_deg * 1e7)
            answer = encoder.mission_item_int_encode(
                system, 1, asked.seq, one.frame, one.command, 0, 1, *one.params, x, y, one.alt_m, 0
            )
            self.vehicle.receive(station.pack(answer), now_s, 1)

    @property
    def core(self):
        return self.onboard.core

    @property
    def state(self):
        return self.onboard.core.state

    @property
    def seq(self):
        """Mission item that the vehicle is flying."""
        return self.vehicle.mission_seq

    def of(self, kind, since=0):
        return [c for step in self.steps[since:] for c in step.commands if isinstance(c, kind)]

    def states(self):
        return [c.state for c in self.of(AuthorityChanged)]

    def texts(self):
        return [c.text for c in self.of(Say)]

    def setpoints(self, since=0):
        return self.of(VelocitySetpoint, since)


class Sky:
    """All aircraft; each receives the others' messages with a delay."""

    def __init__(self, *aircraft):
        self.aircraft = aircraft
        self.tick = 0
        self._air = []
        self._read = FrameReceiver().receive

    @property
    def now_s(self):
        return self.tick * TICK_S

    def run(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self.step()
        return self

    def until(self, done, limit_s=120.0):
        end = self.now_s + limit_s
        while not done():
            assert self.now_s < end, [(a.state, a.vehicle.mode, a.texts()) for a in self.aircraft]
            self.step()
        return self

    def step(self):
        now_s, self.tick = self.now_s, self.tick + 1
        for a in self.aircraft:
            a.vehicle.advance(now_s)
            data = a.vehicle.drain()
            if data and a.linked:
                a.onboard.receive(data, now_s)
        for at, sender, transport, frame in self._air:
            for a in self.aircraft:
                if at == self.tick and a is not sender:
                    heard = self._read(transport, sender.sender.address, frame)
                    if heard is not None:
                        a.onboard.hear(heard)
        self._air = [entry for entry in self._air if entry[0] > self.tick]
        for a in self.aircraft:
            for broadcast in a.onboard.tick(now_s):
                for frame in a.sender.frames(broadcast.transport, broadcast.messages):
                    self._air.append((self.tick + DELAY_TICKS, a, broadcast.transport, frame))
            sent = a.onboard.drain(now_s)
            a.to_vehicle.append(sent)
            if a.linked:
                a.vehicle.receive(sent, now_s)
            a.places.append(a.vehicle.position_ned_m)
            a.modes.append(a.vehicle.mode)

    def least(self):
        """Least distance of the first two (m)."""
        return min(
            math.dist(p, q) for p, q in zip(self.aircraft[0].places, self.aircraft[1].places, strict=True)
        )


def head_on(firmware, *, cooperating=False, **over):
    """One aircraft guarded, flying north; another one coming, which keeps its way unless it cooperates."""
    north = [(0.0, 0.0, 50.0), (550.0, 0.0, 50.0), (550.0, 60.0, 50.0)]
    south = [(400.0, 1.0, 50.0), (0.0, 1.0, 50.0), (-200.0, 1.0, 50.0)]
    return Sky(
        Guarded("ONE", firmware, north, **over),
        Guarded("TWO", Firmware.PX4, south, guarded=cooperating, number=2),
    )


def taken(sky):
    """Run until the companion flies the first aircraft."""
    one = sky.aircraft[0]
    return sky.until(lambda: one.core.in_control).run(1.0)


@functools.cache
def _saved(firmware, moment):
    """`head_on` at a moment, flown once for all tests that begin there."""
    if moment == "taken":
        return Saved(taken(head_on(firmware)))
    earlier = {"held": "taken", "avoiding": "taken", "recovering": "taken", "guarding": "recovering"}
    sky = head_on_at(firmware, earlier[moment])
    if moment == "held":
        return Saved(sky.run(1.0))
    one = sky.aircraft[0]
    return Saved(sky.until(lambda: one.state.value == moment))


def head_on_at(firmware, moment):
    """The flight of `head_on`, from a moment on.

    Moments: "taken", a second after the companion has control; "held", another second later; and the
    beginnings of the states "avoiding", "recovering" and "guarding", all while it has control.
    """
    return _saved(firmware, moment).copy()
