"""A random vehicle: it says anything in any order, and in half of the histories it flies what was sent to
it.

What it says goes to whatever listens (`_hear` and its neighbours) and, in plain numbers, to the oracle.
"""

from __future__ import annotations

import math
from random import Random

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
    LocalPosition,
    MissionCurrent,
    Parameter,
    Settings,
    TwoAutopilots,
    VehicleParameters,
    VehicleTime,
)
from tests.companion.gate.hostile.heard import Terms, Told
from tests.companion.gate.hostile.oracle import Oracle
from tests.support.place import HOME

_LAT = HOME.to_geodetic(1.0, 0.0, 0.0)[0] - HOME.lat_deg
_LON = HOME.to_geodetic(0.0, 1.0, 0.0)[1] - HOME.lon_deg
"""Degrees for a metre north and a metre east. Over a few hundred metres the error is a few centimetres."""
MODES = {
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


class RandomVehicle:
    """One configuration and one vehicle, drawn at random. Subclasses define what listens to it."""

    longest_alone_s = math.inf
    """A mode that was delayed for longer comes only after a message that shows the delay by its time."""

    def __init__(self, rng: Random) -> None:
        self.rng = rng
        self.true = rng.random() < 0.5
        """The vehicle reports its true position and flies the setpoints that were sent."""
        self.firmware = rng.choice(list(Firmware))
        self.custom_modes = list(MODES[self.firmware])
        self.config, self.terms = self._draw_terms()
        self.oracle = Oracle(self.terms)
        self.now_s = rng.uniform(0.0, 1e5)
        self.boot_s = rng.uniform(0.0, 1e4) - self.now_s
        """The vehicle's clock minus ours."""
        self.system = rng.choice((1, 1, 1, 7, 255))
        self.armed = rng.random() < 0.1
        self.custom = rng.choice(self.custom_modes)
        self.on_ground = True
        self.step_s = rng.choice((0.05, 0.05, 0.1, 0.2) if self.true else (0.02, 0.05, 0.05, 0.1))
        self.last = (0.0, 0.0, 0.0)
        """The last setpoint that was sent, along the fence's axes and down."""
        self.released_s = -math.inf
        """Time at which it was sent."""
        self.crossed = False
        self.nearest = math.inf
        """Least room to a wall, the floor or the ceiling (m)."""
        self.delayed_s = 0.0
        """How long the message that is being reported was delayed, while newer ones were not."""
        self.longest_s = 0.0
        """Greatest age of the own position at which a setpoint was sent."""

    # ------------------------------------------------------------ what listens

    def _hear(self, event: Event) -> None:
        """Report one event of the vehicle to what is tested."""
        raise NotImplementedError

    def _hear_old(self, event: Heartbeat | CurrentMode) -> None:
        """Report a mode that newer messages, which have arrived, have overtaken by `delayed_s`."""
        raise NotImplementedError

    def _emptied(self) -> None:
        """The input was read until it was empty."""
        self.oracle.emptied(self.now_s)

    def _behind(self) -> None:
        """The input holds more than could be read."""
        self.oracle.behind()

    # ------------------------------------------------------------ configuration

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

    # ------------------------------------------------------------ messages of the vehicle

    def _heartbeat(self, custom: int, *, armed: bool) -> Heartbeat:
        return Heartbeat(
            system_id=self.system,
            firmware=self.firmware,
            vehicle_type=2,
            custom_mode=custom,
            mode=MODES[self.firmware][custom],
            armed=armed,
        )

    def _beat(self) -> None:
        self._hear(self._heartbeat(self.custom, armed=self.armed))
        self.oracle.heartbeat(self.system, self.custom, self.armed, self.now_s)

    def _current_mode(self) -> None:
        self._hear(CurrentMode(custom_mode=self.custom))
        self.oracle.current_mode(self.custom, self.now_s)

    def _position(self, delay_s: float) -> None:
        rng = self.rng
        if not self.true and rng.random() < 0.1:
            self.u, self.v, self.h = self.u + rng.gauss(0, 20), self.v + rng.gauss(0, 20), rng.uniform(0, 120)
            self.vel = [rng.gauss(0, 6), rng.gauss(0, 6), rng.gauss(0, 2)]
        measured = self.now_s - delay_s
        if measured + self.boot_s < 0.0:
            return  # The vehicle had not started yet.
        lat, lon = self._degrees(self.u - delay_s * self.vel[0], self.v - delay_s * self.vel[1])
        # Velocities have the resolution of GLOBAL_POSITION_INT, because small differences decide (rule 11).
        a, b, down = self.vel
        north, east = round(self.cos * a - self.sin * b, 2), round(self.sin * a + self.cos * b, 2)
        a, b, down = self.cos * north + self.sin * east, self.cos * east - self.sin * north, round(down, 2)
        height = self.h + delay_s * down
        event = GlobalPosition(
            time_boot_s=measured + self.boot_s,
            lat_deg=lat,
            lon_deg=lon,
            alt_msl_m=400.0 + height,
            height_above_home_m=height,
            velocity_ned_mps=(north, east, down),
        )
        self._hear(event)
        place = self.u - delay_s * a, self.v - delay_s * b
        told = Told(measured, measured + self.boot_s, place, height, (a, b, down), (north, east))
        self.oracle.told(told, self.now_s)

    def _clock(self, delay_s: float) -> None:
        """A message other than the position that carries the vehicle's clock."""
        boot_s = self.now_s - delay_s + self.boot_s
        if boot_s < 0.0:
            return
        if self.rng.random() < 0.5:
            self._hear(VehicleTime(time_boot_s=boot_s, utc_s=None))
        else:
            here = (0.0, 0.0, 0.0)
            self._hear(LocalPosition(time_boot_s=boot_s, position_ned_m=here, velocity_ned_mps=here))
        self.oracle.clock(self.now_s - delay_s, boot_s, self.now_s)

    def _landed(self) -> None:
        landed = Landed.ON_GROUND if self.on_ground else Landed.IN_AIR
        self._hear(LandedState(landed=landed))
        self.oracle.landed(self.on_ground, self.now_s)

    def _own_fence(self, walls: tuple[float, float, float, float] | None) -> None:
        areas = () if walls is None else (self._area(walls),)
        self._hear(FenceDownloaded(areas=areas))
        if self.config.limits.fence == "vehicle":
            self.oracle.terms.walls = walls

    def _rare(self) -> None:
        """One of the rare events."""
        rng = self.rng
        match rng.randrange(16):
            case 11 | 12 | 13 | 14 | 15:
                self._old_messages(rng.choice((rng.uniform(0.3, 0.7), rng.uniform(0.3, 9.5))))
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
                    self._hear(VehicleParameters(firmware=self.firmware, **own))
                    self.oracle.parameters(*low)
            case 3:
                enable = rng.random() < 0.6
                self._hear(Settings(enable=enable))
                self.oracle.enabled = enable
            case 4 if self.any_vehicle:
                self._hear(TwoAutopilots(reason="two"))
                self.oracle.two = True
            case 5:
                complete = rng.random() < 0.6
                self._hear(MissionCurrent(seq=1, complete=complete))
                if complete:
                    self.oracle.mission_complete()
            case 6 if not self.true:
                wide = [rng.uniform(5, 300) for _ in range(4)]
                walls = self.u - wide[0], self.u + wide[1], self.v - wide[2], self.v + wide[3]
                self._own_fence(walls if rng.random() < 0.8 else None)
            case 7 if not self.true:
                self.boot_s = rng.uniform(0.0, 100.0) - self.now_s
            case 8:
                self._behind()
            case _:
                self._pause(rng.choice((0.2, 0.3, 0.6, 1.2, 3.5, 13.0)))

    def _pause(self, seconds: float) -> None:
        """Nothing is read for a while, and then perhaps messages that had waited."""
        self._moved(seconds)
        if self.rng.random() < 0.5:
            self._beat()
            report = self.rng.choice((self._position, self._clock))
            report(min(seconds, self.rng.uniform(0.0, seconds)))

    def _old_messages(self, delay_s: float) -> None:
        """A message with the vehicle's clock, a mode or both arrive after newer messages."""
        written_s = self.oracle.written_s
        if written_s is None or written_s <= self.now_s - delay_s or self.now_s - self.oracle.clock_s > 0.9:
            return
        if self.rng.random() < 0.5:  # The gate needs a mode before it permits a command again.
            self._behind()
            self._emptied()
        self.delayed_s = delay_s
        alone = delay_s <= self.longest_alone_s and self.rng.random() < 0.5
        if not alone:
            self.rng.choice((self._position, self._clock))(delay_s)
        if alone or self.rng.random() < 0.7:
            custom = self.rng.choice(self.custom_modes)
            if self.rng.random() < 0.7:
                self._hear_old(self._heartbeat(custom, armed=self.rng.random() < 0.5))
            else:
                self._hear_old(CurrentMode(custom_mode=custom))
            self.oracle.old_mode(custom, self.now_s)
        self.delayed_s = 0.0

    def _silence(self, steps: int) -> None:
        """The vehicle is silent while the input is read, then perhaps sends something without a mode."""
        for _ in range(steps):
            self._moved(0.2)
            self._emptied()
        if self.rng.random() < 0.5:
            self.rng.choice((self._position, self._clock))(0.01)

    # ------------------------------------------------------------ motion

    def _moved(self, seconds: float) -> None:
        """Move a point mass, each axis by itself. Half a second after a setpoint it brakes."""
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
                # A change that takes less than `dt` is made at its beginning.
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
        """Mode that the vehicle flies."""
        return MODES[self.firmware][self.custom]

    def _look(self) -> None:
        """Report to the oracle when a wall, the floor or the ceiling was crossed."""
        terms, walls = self.terms, self.config.fence and self.terms.walls
        # Allow for one step of the program, and for the change of velocity since it was last reported.
        a = terms.acceleration
        error = 0.15 + terms.speed * self.step_s + 0.5 * a * self.longest_s**2
        # A fast vehicle that is slowed down with nine tenths of the acceleration needs more room than the
        # gate computes, and so does one that is slowed down only after a pause.
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
