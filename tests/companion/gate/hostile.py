"""`python -m tests.companion.gate.hostile`: anything at all wants to leave through the gate, in any state.

Each history is one configuration, one vehicle and one program above the gate, drawn at random: modes in any
order, arming, landing, parameters, fences, pauses in reading, backlogs; and setpoints, mode requests, other
messages, garbage. `oracle` judges what has left. In half of the histories the vehicle is a point mass that
does what has left, and its walls, floor and ceiling must hold. A history comes back with `--history NUMBER`.
Exit status: 0 no rule broken, 1 one was, 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import signal
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing
from companion.autopilot.wire import MavlinkWriter
from companion.config import Config, FlightConfig, IdentityConfig, LimitsConfig, VehicleConfig
from companion.events import (
    CurrentMode,
    Event,
    FenceArea,
    FenceDownloaded,
    Firmware,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    Landed,
    LandedState,
    MissionCurrent,
    Parameter,
    Settings,
    TwoAutopilots,
    VehicleParameters,
)
from companion.gate.gate import Gate
from tests.companion.gate.oracle import ASKED, FREE, Oracle, Terms, Told
from tests.support.place import HOME

_LAT = HOME.to_geodetic(1.0, 0.0, 0.0)[0] - HOME.lat_deg
_LON = HOME.to_geodetic(0.0, 1.0, 0.0)[1] - HOME.lon_deg
"""Degrees for a metre north, for a metre east: a few hundred metres are flat to a few centimetres."""
_SETPOINT, _COMMAND = struct.Struct("<I11fHBBB"), struct.Struct("<7fHBBB")
_MODES = {
    Firmware.ARDUPILOT: {
        4: FlightMode.EXTERNAL,
        3: FlightMode.MISSION,
        17: FlightMode.HOLD,
        5: FlightMode.STICKS,
        6: FlightMode.OTHER,
        9: FlightMode.OTHER,
        0: FlightMode.OTHER,
    },
    Firmware.PX4: {
        0x60000: FlightMode.EXTERNAL,
        0x4040000: FlightMode.MISSION,
        0x3040000: FlightMode.HOLD,
        0x30000: FlightMode.STICKS,
        0x5040000: FlightMode.OTHER,
        0x6040000: FlightMode.OTHER,
        0x10000: FlightMode.OTHER,
    },
}
_MASKS, _FRAMES = (0x9C7, 0x5C7, 0xDC7, 0, 0xFFF, 0x1C7, 0xBC7), (0, 1, 7, 8, 9, 12, 255)
_ODD = (math.nan, math.inf, -math.inf, 1e9, -1e30, 3.4e38, 1e-40)
_SAY_EVERY_S = 15.0
_BLOCK = 50


class AnyGate(Protocol):
    """The gate's public face."""

    def hear(self, event: Event, now_s: float) -> None: ...
    def emptied(self, now_s: float) -> None: ...
    def answered(self, asked_s: float, now_s: float) -> None: ...
    def behind(self) -> None: ...
    def decided(self, now_s: float) -> None: ...
    def release(self, data: bytes, now_s: float) -> bytes: ...


@dataclass
class Block:
    """What became of some histories."""

    histories: int = 0
    commands: int = 0
    setpoints: int = 0
    requests: int = 0
    slowed: int = 0
    near: int = 0
    """Histories in which a wall, the floor or the ceiling was reached to a metre."""
    refused: Counter[str] = field(default_factory=Counter)
    broken: list[tuple[int, str, str]] = field(default_factory=list)
    """History, rule, words."""


class History:
    """One gate, one vehicle, one hostile program."""

    def __init__(
        self, seed: int, number: int, commands: int, make: Callable[[Config], AnyGate] = Gate
    ) -> None:
        self.rng = rng = Random(f"{seed}/{number}")
        self.left = commands
        self.true = rng.random() < 0.5
        """The vehicle tells where it is, and does what has left."""
        self.firmware = rng.choice(list(Firmware))
        self.custom_modes = list(_MODES[self.firmware])
        self.config, self.terms = self._draw_terms()
        self.gate = make(self.config)
        self.oracle = Oracle(self.terms)
        self.writer = MavlinkWriter(1, 191)
        self.signing = Signing(bytes(32), 1, 0.0) if rng.random() < 0.02 else None
        self.now_s = rng.uniform(0.0, 1e5)
        self.boot_s = rng.uniform(0.0, 1e4) - self.now_s
        self.system = rng.choice((1, 1, 1, 7, 255))
        self.armed = rng.random() < 0.1
        self.custom = rng.choice(self.custom_modes)
        self.on_ground = True
        self.pending: list[int] = []
        self.sly = rng.choice((0.3, 0.9, 0.98, 1.0)) if not self.true else rng.choice((0.98, 1.0))
        """Share of frames that might pass."""
        self.step_s = rng.choice((0.05, 0.05, 0.1, 0.2) if self.true else (0.02, 0.05, 0.05, 0.1))
        self.pilot = rng.choice((0.0, 0.01, 0.05, 0.3)) if not self.true else rng.choice((0.0, 0.0, 0.01))
        self.trouble = rng.choice((0.0, 0.005, 0.05)) if not self.true else rng.choice((0.0, 0.0, 0.01))
        self.beats = rng.choice((0.2, 0.5, 1.0))
        self.positions = rng.choice((0.2, 0.5, 1.0))
        self.heading = rng.uniform(-math.pi, math.pi)
        self.aim = rng.choice(("wall", "wall", "vertical", "wild", "feint"))
        self.answers = rng.choice((0.0, 0.7, 0.9, 1.0, 1.0))
        """Share of steps in which the vehicle answers a question."""
        self.last = (0.0, 0.0, 0.0)
        self.released_s = -math.inf
        self.crossed = False
        self.nearest = math.inf
        self.longest_s = 0.0
        """Oldest position that something was decided on."""

    def _draw_terms(self) -> tuple[Config, Terms]:
        rng = self.rng
        use = rng.choice(("guard", "fly")) if self.true or rng.random() < 0.95 else "watch"
        rearm = rng.choice(("mode", "disarm", "never"))
        any_vehicle, in_flight = rng.random() < 0.3, rng.random() < 0.6
        self.any_vehicle = any_vehicle
        speed, climb, descent = rng.uniform(1.0, 12.0), rng.uniform(0.5, 4.0), rng.uniform(0.5, 3.0)
        acceleration, stale = rng.uniform(0.5, 5.0), rng.choice((0.2, 0.5, 1.0, 2.0))
        turn = rng.uniform(-math.pi, math.pi)
        room = speed * (0.5 + 0.5 * speed / acceleration)
        self.u, self.v, self.h = rng.uniform(-50, 50), rng.uniform(-50, 50), rng.uniform(30, 90)
        self.vel = [0.0, 0.0, 0.0]
        walls = None
        if rng.random() < 0.7:
            wide = [room + rng.uniform(0.5, 6.0) for _ in range(4)]
            walls = (self.u - wide[0], self.u + wide[1], self.v - wide[2], self.v + wide[3])
        up = climb * (0.5 + 0.5 * climb / acceleration)
        sink = descent * (0.5 + 0.5 * descent / acceleration)
        floor = self.h - sink - rng.uniform(1.0, 4.0) if rng.random() < 0.6 else None
        ceiling = self.h + up + rng.uniform(1.0, 4.0) if rng.random() < 0.6 else None
        own_fence = walls is not None and rng.random() < 0.3
        terms = Terms(
            use, rearm, self.firmware.value, any_vehicle, in_flight, stale, speed, climb, descent,
            acceleration, floor, ceiling, turn, None if own_fence else walls,
        )  # fmt: skip
        self.cos, self.sin = math.cos(turn), math.sin(turn)
        self.own_walls = walls if own_fence else None
        config = Config(
            identity=IdentityConfig(uas_id="HOSTILE"),
            vehicle=VehicleConfig(system_id=0 if any_vehicle else 1, stale_after_s=stale),
            flight=FlightConfig(use=use, rearm=rearm, take_in_flight=in_flight),  # type: ignore[arg-type]
            limits=LimitsConfig(
                max_speed_mps=speed,
                max_climb_mps=climb,
                max_descent_mps=descent,
                max_acceleration_mps2=acceleration,
                floor_height_m=floor,
                ceiling_height_m=ceiling,
                fence="vehicle" if own_fence else None,
            ),
            fence=() if own_fence or walls is None else (self._area(walls),),
        )
        return config, terms

    def _area(self, walls: tuple[float, float, float, float]) -> FenceArea:
        a, b, c, d = walls
        corners = ((a, c), (b, c), (b, d), (a, d))
        return FenceArea(inclusion=True, points=tuple(self._degrees(*corner) for corner in corners))

    def _degrees(self, u: float, v: float) -> tuple[float, float]:
        north, east = self.cos * u - self.sin * v, self.sin * u + self.cos * v
        return HOME.lat_deg + north * _LAT, HOME.lon_deg + east * _LON

    # ------------------------------------------------------------ what the vehicle says

    def _beat(self) -> None:
        mode = _MODES[self.firmware][self.custom]
        event = Heartbeat(
            system_id=self.system,
            firmware=self.firmware,
            vehicle_type=2,
            custom_mode=self.custom,
            mode=mode,
            armed=self.armed,
        )
        self.gate.hear(event, self.now_s)
        self.oracle.heartbeat(self.system, self.custom, self.armed, self.now_s)

    def _current_mode(self) -> None:
        self.gate.hear(CurrentMode(custom_mode=self.custom), self.now_s)
        self.oracle.current_mode(self.custom, self.now_s)

    def _position(self, delay_s: float) -> None:
        rng = self.rng
        if not self.true and rng.random() < 0.1:
            self.u, self.v, self.h = self.u + rng.gauss(0, 20), self.v + rng.gauss(0, 20), rng.uniform(0, 120)
            self.vel = [rng.gauss(0, 6), rng.gauss(0, 6), rng.gauss(0, 2)]
        measured = self.now_s - delay_s
        lat, lon = self._degrees(self.u - delay_s * self.vel[0], self.v - delay_s * self.vel[1])
        a, b, down = self.vel
        north, east = self.cos * a - self.sin * b, self.sin * a + self.cos * b
        height = self.h + delay_s * down
        event = GlobalPosition(
            time_boot_s=measured + self.boot_s,
            lat_deg=lat,
            lon_deg=lon,
            alt_msl_m=400.0 + height,
            height_above_home_m=height,
            velocity_ned_mps=(north, east, down),
        )
        self.gate.hear(event, self.now_s)
        place = self.u - delay_s * a, self.v - delay_s * b
        told = Told(measured, measured + self.boot_s, place, height, (a, b, down), (north, east))
        self.oracle.told(told, self.now_s)

    def _landed(self) -> None:
        landed = Landed.ON_GROUND if self.on_ground else Landed.IN_AIR
        self.gate.hear(LandedState(landed=landed), self.now_s)
        self.oracle.landed(self.on_ground, self.now_s)

    def _own_fence(self, walls: tuple[float, float, float, float] | None) -> None:
        areas = () if walls is None else (self._area(walls),)
        self.gate.hear(FenceDownloaded(areas=areas), self.now_s)
        if self.config.limits.fence == "vehicle":
            self.oracle.terms.walls = walls

    def _rare(self) -> None:
        """Something that happens once in a while."""
        rng = self.rng
        match rng.randrange(11):
            case 10:
                self._silence(rng.choice((2, 3, 4, 8)))
            case 0:
                self.armed = not self.armed
            case 1:
                self.on_ground = not self.on_ground
            case 2:
                low = [rng.uniform(0.5, 15.0), rng.uniform(0.3, 5.0), rng.uniform(0.3, 4.0), 0.0]
                low[3] = rng.uniform(0.5, 6.0)
                names = ("speed_mps", "climb_mps", "descent_mps", "acceleration_mps2")
                if not self.true:
                    own = {n: Parameter(name=n, value=x) for n, x in zip(names, low, strict=True)}
                    self.gate.hear(VehicleParameters(firmware=self.firmware, **own), self.now_s)
                    self.oracle.parameters(*low)
            case 3:
                enable = rng.random() < 0.6
                self.gate.hear(Settings(enable=enable), self.now_s)
                self.oracle.enabled = enable
            case 4 if self.any_vehicle:
                self.gate.hear(TwoAutopilots(reason="two"), self.now_s)
                self.oracle.two = True
            case 5:
                complete = rng.random() < 0.6
                self.gate.hear(MissionCurrent(seq=1, complete=complete), self.now_s)
                if complete:
                    self.oracle.mission_complete()
            case 6 if not self.true:
                wide = [rng.uniform(5, 300) for _ in range(4)]
                walls = self.u - wide[0], self.u + wide[1], self.v - wide[2], self.v + wide[3]
                self._own_fence(walls if rng.random() < 0.8 else None)
            case 7 if not self.true:
                self.boot_s = rng.uniform(0.0, 100.0) - self.now_s
            case 8:
                self.gate.behind()
                self.oracle.behind()
            case _:
                self._pause(rng.choice((0.2, 0.3, 0.6, 1.2, 3.5, 13.0)))

    def _pause(self, seconds: float) -> None:
        """Nothing is read for a while; then, perhaps, what had waited."""
        self._moved(seconds)
        if self.rng.random() < 0.5:
            self._beat()
            self._position(min(seconds, self.rng.uniform(0.0, seconds)))

    def _silence(self, steps: int) -> None:
        """The input is read, but the vehicle says nothing; then perhaps something that shows no mode."""
        for _ in range(steps):
            self._moved(0.2)
            self._emptied()
        if self.rng.random() < 0.5:
            self._position(0.01)

    def _emptied(self) -> None:
        self.gate.emptied(self.now_s)
        self.oracle.emptied(self.now_s)

    # ------------------------------------------------------------ the vehicle

    def _moved(self, seconds: float) -> None:
        """A point mass, each axis for itself: it does what left last, and half a second later it brakes."""
        self.now_s += seconds
        if not self.true:
            return
        a, most = self.terms.acceleration, 0.05
        while seconds > 1e-9:
            dt = min(seconds, most)
            at_s = self.now_s - seconds
            flown = self.firmware_mode() is FlightMode.EXTERNAL and at_s - self.released_s <= 0.5
            wanted = self.last if flown else (0.0, 0.0, 0.0)
            for axis in range(3):
                before = self.vel[axis]
                change = max(-a * dt, min(a * dt, wanted[axis] - before))
                self.vel[axis] = before + change
                # What it changes by at once, it changes by at the beginning.
                step = dt * (before + change) if abs(change) < a * dt else dt * (before + 0.5 * change)
                if axis == 0:
                    self.u += step
                elif axis == 1:
                    self.v += step
                else:
                    self.h -= step
            seconds -= dt
        self._look()

    def firmware_mode(self) -> FlightMode:
        """The mode that the vehicle is in."""
        return _MODES[self.firmware][self.custom]

    def _look(self) -> None:
        """Whether a wall, the floor or the ceiling was crossed."""
        terms, walls = self.terms, self.config.fence and self.terms.walls
        # A step of the program, and what a velocity may change by after it was last told.
        a = terms.acceleration
        error = 0.15 + terms.speed * self.step_s + 0.5 * a * self.longest_s**2
        # Slowing down with nine tenths of the acceleration is less than a fast vehicle needs, and one that is
        # slowed down only after a pause has used up its half second.
        error += max(0.0, 0.1 * terms.speed - 0.4 * a) ** 2 / (0.18 * a) + 0.5 * self.oracle.late_mps
        rooms = [math.inf]
        if walls:
            rooms += [walls[1] - self.u, self.u - walls[0], walls[3] - self.v, self.v - walls[2]]
        worst = min(rooms)
        height = min(
            math.inf if terms.floor is None else self.h - terms.floor,
            math.inf if terms.ceiling is None else terms.ceiling - self.h,
        )
        self.nearest = min(self.nearest, worst, height)
        if self.crossed:
            return
        if worst < -error:
            self.crossed = True
            self.oracle.found.append(("fence", f"crossed by {-worst:.2f} m, allowed {error:.2f}"))
        elif height < -1.0 - error:
            self.crossed = True
            self.oracle.found.append(("height", f"crossed by {-height:.2f} m, allowed {1.0 + error:.2f}"))

    # ------------------------------------------------------------ the hostile program

    def _frame(self) -> tuple[bytes, bool]:
        """Something that wants to leave, and whether it is whole."""
        rng = self.rng
        if rng.random() >= self.sly:
            return self._nonsense()
        draw = rng.random()
        external = self.firmware_mode() is FlightMode.EXTERNAL
        if draw < (0.01 if external and self.true else 0.04 if external else 0.12):
            customs = list(ASKED[self.firmware.value])
            custom = customs[0]
            if external and rng.random() < 0.9:
                custom = rng.choice(customs[2:] if self.config.flight.use == "fly" else customs[1:])
            return self._packed(76, self._command(176, (1.0, *map(float, custom)))), True
        if draw < 0.13 and self.firmware_mode() is FlightMode.MISSION and rng.random() < 0.2:
            return self._packed(76, self._command(178, (1.0, rng.uniform(0.5, 8.0), -1.0))), True
        if 0.13 < draw < 0.14:
            return self._packed(rng.choice((0, 4, 77)), bytes((1,)) * 6), True
        return self._packed(84, self._setpoint()), True

    def _packed(self, number: int, payload: bytes) -> bytes:
        frame = self.writer.pack_payload(number, payload)
        return frame if self.signing is None else self.signing.sign(frame)

    def _command(self, number: int, params: tuple[float, ...], target: int | None = None) -> bytes:
        seven = (*params, *(0.0,) * (7 - len(params)))
        return _COMMAND.pack(*seven, number, self.system if target is None else target, 1, 0)

    def _velocity(self) -> tuple[float, float, float]:
        """In the fence's axes, and down: what may pass and leads to where it hurts."""
        rng, terms = self.rng, self.terms
        if rng.random() < 0.02:
            self.heading = rng.uniform(-math.pi, math.pi)
        reach = terms.acceleration * self.step_s
        fast = terms.speed * rng.choice((0.5, 0.9, 0.99))
        u, v, down = fast * math.cos(self.heading), fast * math.sin(self.heading), 0.0
        if self.aim == "vertical":
            down = (terms.descent if self.heading > 0.0 else -terms.climb) * rng.choice((0.5, 0.99))
            u, v = 0.3 * u, 0.3 * v
        elif self.aim == "wild":
            a = terms.acceleration * rng.uniform(0.0, 1.3)
            course = rng.uniform(-math.pi, math.pi)
            u, v = self.vel[0] + a * math.cos(course), self.vel[1] + a * math.sin(course)
            faster = max(1.0, math.hypot(u, v) / (0.99 * terms.speed)) if rng.random() < 0.98 else 1.0
            return u / faster, v / faster, 0.0
        if self.aim == "feint" and self._cannot_stop():
            # As slow as it must be to pass for braking.
            told = self.oracle.position.velocity if self.oracle.position else self.vel
            flown = math.hypot(*told)
            slower = max(0.0, 1.0 - 0.075 * terms.acceleration / flown) if flown else 0.0
            return told[0] * slower, told[1] * slower, told[2] * slower
        lu, lv, ld = self.last if self.now_s - self.released_s <= 1.0 else self.vel
        wide = math.hypot(u - lu, v - lv)
        share = min(1.0, reach / wide) if wide else 1.0
        return lu + share * (u - lu), lv + share * (v - lv), ld + max(-reach, min(reach, down - ld))

    def _cannot_stop(self) -> bool:
        a, walls = self.terms.acceleration, self.terms.walls
        if walls is None:
            return False
        rooms = walls[1] - self.u, self.u - walls[0], walls[3] - self.v, self.v - walls[2]
        towards = self.vel[0], -self.vel[0], self.vel[1], -self.vel[1]
        return any(
            v > 0.0 and v * (0.5 + 0.5 * v / a + 2.0 * self.step_s) > room
            for v, room in zip(towards, rooms, strict=True)
        )

    def _setpoint(self) -> bytes:
        rng = self.rng
        if rng.random() < 0.03:
            u = v = down = 0.0
        else:
            u, v, down = self._velocity()
        north, east = self.cos * u - self.sin * v, self.sin * u + self.cos * v
        fields = [0, 0.0, 0.0, 0.0, north, east, down, 0.0, 0.0, 0.0, 0.0, 0.0]
        return _SETPOINT.pack(*fields, 0x9C7, self.system, 1, 1)

    def _nonsense(self) -> tuple[bytes, bool]:
        rng = self.rng
        match rng.randrange(9):
            case 0:
                return rng.randbytes(rng.randrange(1, 60)).replace(b"\xfd", b"\0", 1), False
            case 1:
                frame = self._packed(84, self._setpoint())
                return frame[: rng.randrange(1, len(frame) - 1)], False
            case 2:
                number = rng.choice((23, 11, 70, 82, 86, 75, 44, 39, 256, rng.randrange(300)))
                if number in FREE or number in (76, 84) or number not in mavlink.mavlink_map:
                    number = 23
                return self._packed(number, b"\1" * 8), True
            case 3:
                numbers = (400, 21, 20, 185, 209, 300, rng.randrange(60000))
                return self._packed(76, self._command(rng.choice(numbers), (1.0,))), True
            case 4:
                params = rng.choice(((1.0, 6.0, 0.0), (0.0, 4.0, 0.0), (1.0, math.nan, 0.0), (1.0, 4.0, 5.0)))
                return self._packed(76, self._command(176, params)), True
            case 5:
                target = rng.choice((0, self.system + 1 & 0xFF, 42))
                params = 1.0, *map(float, rng.choice(list(ASKED[self.firmware.value])))
                return self._packed(76, self._command(rng.choice((176, 178)), params, target)), True
            case 6:
                return self._packed(
                    110, bytes((0, self.system, 1, 0, 0, 0, rng.choice((7, 128, 129)), 1))
                ), True
            case 7:
                return self._packed(rng.choice((76, 84)), b"\1" * rng.choice((54, 60, 255))), True
        return self._packed(84, self._odd_setpoint()), True

    def _odd_setpoint(self) -> bytes:
        rng = self.rng
        fields = list(_SETPOINT.unpack(self._setpoint()))
        for _ in range(rng.randrange(1, 3)):
            match rng.randrange(5):
                case 0:
                    fields[rng.randrange(1, 12)] = rng.choice(_ODD)
                case 1:
                    fields[12] = rng.choice(_MASKS)
                case 2:
                    fields[15] = rng.choice(_FRAMES)
                case 3:
                    fields[rng.choice((13, 14))] = rng.randrange(256)
                case _:
                    far = self.terms.speed * rng.uniform(0.5, 3.0)
                    fields[rng.randrange(4, 7)] = far * rng.choice((-1, 1))
        return _SETPOINT.pack(*fields)

    # ------------------------------------------------------------ the history

    def run(self) -> Oracle:
        """All of it; what was found is in the oracle."""
        self._begin()
        while self.left > 0:
            self._step()
        return self.oracle

    def _begin(self) -> None:
        """Mostly a vehicle that was seen down, is armed and flies."""
        self._emptied()
        if self.rng.random() < 0.8:
            self.armed = False
            self._beat()
            self.armed, self.on_ground = True, False
            if self.rng.random() < 0.8:
                self.custom = self.custom_modes[self.rng.randrange(2)]
        self._position(0.0)
        self._beat()
        if self.own_walls is not None:
            self._own_fence(self.own_walls)
        if self.rng.random() < 0.5:
            self._moved(0.05)
            self._emptied()
            self._beat()

    def _step(self) -> None:
        rng = self.rng
        self._moved(self.step_s)
        if rng.random() < self.pilot:
            self.custom = rng.choice(self.custom_modes)
        elif self.pending and rng.random() < 0.5:
            self.custom = self.pending.pop()
            self.pending.clear()
        if rng.random() < self.trouble:
            self._rare()
        if rng.random() < self.positions:
            self._position(rng.uniform(0.0, 0.02))
        if rng.random() < self.beats:
            self._beat()
        elif self.firmware is Firmware.PX4 and rng.random() < 0.3:
            self._current_mode()
        if rng.random() < 0.2:
            self._landed()
        if rng.random() < 0.97:
            self._emptied()
        if self.answers and rng.random() < self.answers:
            asked_s = self.now_s - (rng.uniform(0.0, 0.2) if rng.random() < 0.95 else rng.uniform(0.2, 2.0))
            self.gate.answered(asked_s, self.now_s)
            self.oracle.answered(asked_s, self.now_s)
        if rng.random() < 0.97:
            self.gate.decided(self.now_s)
            self.oracle.decided_s = self.now_s
        self._offer()

    def _offer(self) -> None:
        offered: list[bytes] = []
        whole: list[bool] = []
        for _ in range(1 if self.true or self.rng.random() < 0.7 else self.rng.randrange(1, 8)):
            frame, is_whole = self._frame()
            offered.append(frame)
            whole.append(is_whole)
            if not is_whole:
                break
        self.left -= len(offered)
        data = b"".join(offered)
        out = self.gate.release(data, self.now_s)
        self.oracle.judge(offered, whole, out, self.now_s)
        if out:
            self._obeyed(offered, out)
        if len(out) < len(data):
            self._refused()

    def _refused(self) -> None:
        rng, oracle = self.rng, self.oracle
        if oracle.gone or not self.armed or self.on_ground:
            if rng.random() < 0.1:  # another flight
                self.armed = False
                self._beat()
                self.armed, self.on_ground = True, False
                self.custom = self.custom_modes[rng.randrange(2)]
        elif rng.random() < 0.6:
            self._wait()

    def _wait(self) -> None:
        """Until a gate that was shut by a fault is open again."""
        for _ in range(16):
            self._moved(0.2)
            self._position(0.01)
            self._beat()
            self._emptied()
        if self.rng.random() < 0.7:
            self.heading += math.pi
            self.custom = self.custom_modes[self.rng.randrange(2)]

    def _obeyed(self, offered: list[bytes], out: bytes) -> None:
        at = 0
        for frame in offered:
            if not out.startswith(frame, at):
                continue
            at += len(frame)
            if len(frame) < 12 or frame[0] != 0xFD:
                continue
            payload = frame[10 : 10 + frame[1]]
            if frame[7] == 84:
                _, *numbers, _, _, _, _ = _SETPOINT.unpack(payload[:53].ljust(53, b"\0"))
                north, east, down = numbers[3:6]
                self.last = self.cos * north + self.sin * east, self.cos * east - self.sin * north, down
                self.released_s = self.now_s
                position = self.oracle.position
                if position is not None:
                    self.longest_s = max(self.longest_s, self.now_s - position.measured_s)
            elif frame[7] == 76:
                fields = _COMMAND.unpack(payload[:33].ljust(33, b"\0"))
                custom = ASKED[self.firmware.value].get((fields[1], fields[2]))  # type: ignore[call-overload]
                if fields[7] == 176 and custom is not None and self.rng.random() < 0.8:
                    self.pending.append(custom)


def run_block(
    seed: int, first: int, count: int, commands: int, make: Callable[[Config], AnyGate] = Gate
) -> Block:
    """Some histories."""
    block = Block()
    for number in range(first, first + count):
        history = History(seed, number, commands, make)
        oracle = history.run()
        block.histories += 1
        block.commands += commands - history.left
        block.setpoints += oracle.setpoints
        block.requests += oracle.requests
        block.slowed += oracle.slowed
        block.near += history.true and history.nearest < 1.0
        block.refused.update(getattr(history.gate, "counts", {}))
        block.broken += [(number, rule, words) for rule, words in oracle.found[:3]]
    return block


def _work(job: tuple[int, int, int, int]) -> Block:
    return run_block(*job)


def _line(total: Block, began_s: float) -> str:
    seconds = time.monotonic() - began_s
    return (
        f"{total.histories:,} histories, {total.commands:,} commands in {seconds:,.0f} s "
        f"({total.commands / seconds:,.0f}/s); left: {total.setpoints:,} setpoints ({total.slowed:,} slowing "
        f"down), {total.requests:,} mode requests; {total.near:,} came within a metre; "
        f"{len(total.broken)} broken"
    )


def _add(total: Block, block: Block) -> None:
    for name in ("histories", "commands", "setpoints", "requests", "slowed", "near"):
        setattr(total, name, getattr(total, name) + getattr(block, name))
    total.refused += block.refused
    for number, rule, words in block.broken:
        if len(total.broken) < 20:
            print(f"BROKEN: history {number}: {rule}: {words}", flush=True)
        total.broken.append((number, rule, words))


def main(argv: Sequence[str] | None = None) -> int:
    """Run a campaign."""
    parser = argparse.ArgumentParser(prog="python -m tests.companion.gate.hostile", description=__doc__)
    parser.add_argument("--histories", type=int, default=1000)
    parser.add_argument("--commands", type=int, default=100, help="in each history (default 100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--history", type=int, help="run this one alone, in this process")
    arguments = parser.parse_args(argv)
    if min(arguments.histories, arguments.commands, arguments.jobs) < 1:
        parser.error("--histories, --commands and --jobs must be above 0")
    total, began_s = Block(), time.monotonic()
    said_s = began_s
    if arguments.history is not None:
        _add(total, run_block(arguments.seed, arguments.history, 1, arguments.commands))
    else:
        jobs = [
            (arguments.seed, first, min(_BLOCK, arguments.histories - first), arguments.commands)
            for first in range(0, arguments.histories, _BLOCK)
        ]
        with multiprocessing.Pool(arguments.jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            for block in pool.imap_unordered(_work, jobs):
                _add(total, block)
                if time.monotonic() - said_s > _SAY_EVERY_S:
                    said_s = time.monotonic()
                    print(_line(total, began_s), flush=True)
    for rule, count in sorted(total.refused.items()):
        print(f"  {rule:12}{count:14,} refused")
    print(_line(total, began_s))
    print("a rule was broken" if total.broken else "no rule broken")
    return 1 if total.broken else 0


if __name__ == "__main__":
    sys.exit(main())
