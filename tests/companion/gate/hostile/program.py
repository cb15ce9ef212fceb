"""A hostile program above the gate. It offers setpoints, mode requests, other messages and garbage."""

from __future__ import annotations

import math
import struct
from random import Random

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing
from companion.autopilot.wire import MavlinkWriter
from companion.events import FlightMode
from tests.companion.gate.hostile.oracle import ASKED, FREE
from tests.companion.gate.hostile.vehicle import RandomVehicle

SETPOINT, COMMAND = struct.Struct("<I11fHBBB"), struct.Struct("<7fHBBB")
_MASKS, _FRAMES = (0x9C7, 0x5C7, 0xDC7, 0, 0xFFF, 0x1C7, 0xBC7), (0, 1, 7, 8, 9, 12, 255)
_ODD = (math.nan, math.inf, -math.inf, 1e9, -1e30, 3.4e38, 1e-40)


class HostileProgram(RandomVehicle):
    """Draws what is offered to the gate, from the true state of the vehicle."""

    def __init__(self, rng: Random) -> None:
        super().__init__(rng)
        self.writer = MavlinkWriter(1, 191)
        self.signing = Signing(bytes(32), 1, 0.0) if rng.random() < 0.02 else None
        self.sly = rng.choice((0.3, 0.9, 0.98, 1.0)) if not self.true else rng.choice((0.98, 1.0))
        """Share of frames that the gate might pass."""
        self.heading = rng.uniform(-math.pi, math.pi)
        self.aim = rng.choice(("wall", "wall", "vertical", "wild", "feint"))

    def _frame(self) -> tuple[bytes, bool]:
        """One frame to offer, and whether it is whole."""
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
        return COMMAND.pack(*seven, number, self.system if target is None else target, 1, 0)

    def _velocity(self) -> tuple[float, float, float]:
        """A velocity along the fence's axes and down that may pass and that leads towards a bound."""
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
            # The least deceleration that counts as slowing down.
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
        return SETPOINT.pack(*fields, 0x9C7, self.system, 1, 1)

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
        fields = list(SETPOINT.unpack(self._setpoint()))
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
        return SETPOINT.pack(*fields)
