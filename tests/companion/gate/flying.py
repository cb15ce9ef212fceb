"""A gate and its vehicle. The gate hears events, and pymavlink makes the frames that are offered to it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import Config, FlightConfig, IdentityConfig, LimitsConfig, VehicleConfig
from companion.events import (
    CurrentMode,
    FenceArea,
    Firmware,
    FlightMode,
    GateRefused,
    GlobalPosition,
    Heartbeat,
    Landed,
    LandedState,
)
from companion.gate.gate import Gate
from companion.geometry import Vec3
from tests.support.place import HOME

EXTERNAL, MISSION, HOLD, STICKS, OTHER = (
    FlightMode.EXTERNAL,
    FlightMode.MISSION,
    FlightMode.HOLD,
    FlightMode.STICKS,
    FlightMode.OTHER,
)
ARDUPILOT, PX4 = Firmware.ARDUPILOT, Firmware.PX4
CUSTOM = {
    ARDUPILOT: {EXTERNAL: 4, MISSION: 3, HOLD: 17, STICKS: 5, OTHER: 6},
    PX4: {
        EXTERNAL: 6 << 16,
        MISSION: 4 << 16 | 4 << 24,
        HOLD: 4 << 16 | 3 << 24,
        STICKS: 3 << 16,
        OTHER: 4 << 16 | 5 << 24,
    },
}
"""OTHER is RTL."""
_ASKED = {
    ARDUPILOT: {EXTERNAL: (4, 0), MISSION: (3, 0), HOLD: (17, 0), STICKS: (5, 0), OTHER: (6, 0)},
    PX4: {EXTERNAL: (6, 0), MISSION: (4, 4), HOLD: (4, 3), STICKS: (3, 0), OTHER: (4, 5)},
}
RTL = OTHER
STEP_S = 0.05


@lru_cache
def _geodetic(place: Vec3) -> Vec3:
    return HOME.to_geodetic(*place)


def config(
    use: str = "fly",
    *,
    limits: dict[str, Any] | None = None,
    system_id: int = 1,
    fence: tuple[FenceArea, ...] = (),
    **flight: Any,
) -> Config:
    """A configuration. `flight` holds keys of the section [flight]."""
    return Config(
        identity=IdentityConfig(uas_id="GATE"),
        vehicle=VehicleConfig(system_id=system_id),
        flight=FlightConfig(use=use, **flight),  # type: ignore[arg-type]
        limits=LimitsConfig(**(limits or {})),
        fence=fence,
    )


def rectangle(south: float, west: float, north: float, east: float, *, inclusion: bool = True) -> FenceArea:
    """A fence given in metres around home."""
    corners = [(south, west), (north, west), (north, east), (south, east)]
    points = tuple(HOME.to_geodetic(*corner, 0.0)[:2] for corner in corners)
    return FenceArea(inclusion=inclusion, points=points)


class Flying:
    """One gate and the vehicle that it hears at 20 Hz. The vehicle stays where a test puts it."""

    def __init__(self, configured: Config | None = None, firmware: Firmware = ARDUPILOT) -> None:
        self.config = config() if configured is None else configured
        self.firmware = firmware
        self.gate = Gate(self.config)
        self.encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self.now_s = 100.0
        self.boot_s = 0.0
        """Time at which the vehicle's clock was 0."""
        self.system_id = 1
        self.mode, self.armed, self.landed = HOLD, False, Landed.ON_GROUND
        self.place, self.velocity = (0.0, 0.0, -50.0), (0.0, 0.0, 0.0)

    def custom(self, mode: FlightMode) -> int:
        """Number (`custom_mode`) of a mode."""
        return CUSTOM[self.firmware][mode]

    # ------------------------------------------------------------ messages to the gate

    def beat(
        self, mode: FlightMode | None = None, *, armed: bool | None = None, overtaken: bool = False
    ) -> None:
        """HEARTBEAT."""
        self.mode = self.mode if mode is None else mode
        self.armed = self.armed if armed is None else armed
        event = Heartbeat(
            system_id=self.system_id,
            firmware=self.firmware,
            vehicle_type=2,
            custom_mode=self.custom(self.mode),
            mode=self.mode,
            armed=self.armed,
            overtaken=overtaken,
        )
        self.gate.hear(event, self.now_s)

    def current_mode(self, mode: FlightMode, *, overtaken: bool = False) -> None:
        """CURRENT_MODE."""
        self.mode = mode
        self.gate.hear(CurrentMode(custom_mode=self.custom(mode), overtaken=overtaken), self.now_s)

    def position(self, age_s: float = 0.0) -> None:
        """GLOBAL_POSITION_INT, measured `age_s` ago."""
        lat_deg, lon_deg, alt_m = _geodetic(self.place)
        event = GlobalPosition(
            time_boot_s=self.now_s - self.boot_s - age_s,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_msl_m=alt_m,
            height_above_home_m=-self.place[2],
            velocity_ned_mps=self.velocity,
        )
        self.gate.hear(event, self.now_s)

    def ground(self, landed: Landed) -> None:
        """EXTENDED_SYS_STATE."""
        self.landed = landed
        self.gate.hear(LandedState(landed=landed), self.now_s)

    def run(self, seconds: float = STEP_S, *, beats: bool = True) -> Flying:
        """Let time pass with all input read in time. Position, landed state and heartbeat arrive at 20 Hz."""
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.position()
            self.ground(self.landed)
            if beats:
                self.beat()
            self.gate.emptied(self.now_s)
            self.gate.decided(self.now_s)
        return self

    def airborne(self, mode: FlightMode) -> Flying:
        """Report the vehicle on the ground, then armed, then flying in `mode`."""
        self.run(2.0)
        self.landed, self.armed, self.mode = Landed.IN_AIR, True, mode
        return self.run(1.0)

    def taken(self) -> Flying:
        """Make the companion fly the vehicle, in GUIDED or OFFBOARD as it requested."""
        self.airborne(MISSION)
        assert self.asks(EXTERNAL)
        self.mode = EXTERNAL
        self.run()
        assert self.flies()
        return self

    # ------------------------------------------------------------ frames offered to the gate

    def out(self, message: Any) -> bool:
        """Whether a message leaves."""
        return self.leaves(self.packed(message))

    def packed(self, message: Any) -> bytes:
        """A frame made by pymavlink."""
        return bytes(message.pack(self.encoder))

    def leaves(self, frame: bytes) -> bool:
        """Whether a frame leaves unchanged."""
        released = self.gate.release(frame, self.now_s)
        assert released in (frame, b"")
        return bool(released)

    def setpoint(
        self,
        north: float = 0.0,
        east: float = 0.0,
        down: float = 0.0,
        *,
        target: tuple[int, int] = (1, 1),
        frame: int = 1,
        mask: int = 0x9C7,
        yaw: float = 0.0,
        yaw_rate: float = 0.0,
        place: tuple[float, float, float] = (0.0, 0.0, 0.0),
        push: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED."""
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, *target, frame, mask, *place, north, east, down, *push, yaw, yaw_rate
        )

    def flies(self, north: float = 0.0, east: float = 0.0, down: float = 0.0, **fields: Any) -> bool:
        """Whether a setpoint leaves."""
        return self.out(self.setpoint(north, east, down, **fields))

    def command(self, number: int, *params: float, target: tuple[int, int] = (1, 1)) -> bool:
        """Whether a COMMAND_LONG leaves."""
        seven = (*params, *(0.0,) * (7 - len(params)))
        return self.out(mavlink.MAVLink_command_long_message(*target, number, 0, *seven))

    def asks(self, mode: FlightMode, **fields: Any) -> bool:
        """Whether a request for a mode leaves."""
        return self.command(176, 1.0, *map(float, _ASKED[self.firmware][mode]), **fields)

    def refused(self) -> list[int]:
        """Numbers of the rules that were broken since the last call."""
        return [told.rule for told in self.broken()]

    def broken(self) -> list[GateRefused]:
        """The gate's refusals since the last call."""
        return self.gate.broken()


def flown_at(one: Flying, *velocity: float) -> Flying:
    """Let the vehicle fly a velocity already, so that a setpoint with this velocity is no change."""
    one.velocity = velocity[0], velocity[1], velocity[2]
    return one.run()
