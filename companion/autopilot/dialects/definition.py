"""What one firmware does in its own way, as data and small functions."""

from __future__ import annotations

from dataclasses import dataclass

from companion.events import Firmware, FlightMode

CUSTOM_MODE_ENABLED = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED: `custom_mode` is valid. It is also param 1 of DO_SET_MODE."""
MULTIROTORS = frozenset({2, 3, 13, 14, 15, 29, 35, 43})
"""MAV_TYPE of multirotors."""
HELICOPTER = 4
"""MAV_TYPE_HELICOPTER."""
SPEEDS = ACCELERATIONS = (0.1, 100.0)
TIMEOUTS = (0.0, 3600.0)
"""Plausible ranges (SI) of a vehicle's parameters."""


@dataclass(frozen=True, slots=True)
class ModeCommand:
    """Command for one flight mode: params 2 and 3 of DO_SET_MODE, and the mode number that confirms it."""

    custom_mode: int
    param2: float
    param3: float


@dataclass(frozen=True, slots=True)
class Wanted:
    """A vehicle parameter that the companion needs."""

    field: str
    """Name of the field in `VehicleParameters`."""
    names: tuple[tuple[str, float], ...]
    """Name of the parameter in each firmware generation, with the factor that converts its unit to SI."""
    lowest: float
    highest: float
    """Plausible range in SI units, from `lowest` to `highest`. A value outside it is rejected."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """All that one firmware does in its own way: its modes, parameters and missions, and what it does when
    setpoints stop."""

    firmware: Firmware
    title: str
    """Name in messages."""
    autopilot: int
    """MAV_AUTOPILOT in its heartbeat."""
    vehicle_types: frozenset[int]
    """MAV_TYPE of the vehicles that can be commanded."""
    vehicles: str
    """Kinds of vehicles that can be commanded, in words."""
    modes: dict[int, FlightMode]
    commands: dict[FlightMode, ModeCommand]
    names: dict[int, str]
    take_from: frozenset[FlightMode]
    """Modes from which the companion may take a vehicle that it flies itself."""
    take_from_names: str
    """The modes that a pilot selects for that, in words."""
    guard_in_name: str
    """The modes that a pilot selects to have a mission guarded, in words."""
    mode_known_s: float
    """How long the mode in a heartbeat may be trusted (seconds). ArduPilot announces each change at once, so
    its mode is known until a heartbeat is missing. PX4 reports its mode once a second, so only a heartbeat
    that has just arrived counts. `mode_request.ModeTold` describes what CURRENT_MODE adds."""
    wanted: tuple[Wanted, ...]
    integers_bytewise: bool
    """True: PARAM_VALUE holds an integer's own bytes. False: every value is cast to float."""
    silence: str
    """What the autopilot does when setpoints stop for longer than its timeout, if `loss_action` is not
    known."""
    silence_by_action: dict[int, str]
    """As `silence`, for each value of `loss_action`."""
    crashing_actions: frozenset[int]
    """Values of `loss_action` that stop the motors in the air."""
    idle_fence_actions: frozenset[int]
    """Values of `fence_action` with which the vehicle flies through its own fence."""
    external_needs_setpoints: bool
    """True: the mode that flies setpoints is refused while none arrive."""
    flies_last_setpoint: bool
    """True: when setpoints stop, the vehicle flies the last one for a while. It is therefore asked to hold
    when it is released."""
    home_is_item_zero: bool
    """True: item 0 of a mission is home and no part of the mission."""
    mission_ends_in_hold: bool
    """True: after the last item of a mission the vehicle changes its mode to a hold."""
    forgets_mission_speed: bool
    """True: a speed that the mission has set is forgotten when the mission's mode is entered."""
    own_speed_limits_missions: bool
    """True: a mission is never flown faster than the vehicle's own speed parameter."""

    def mode(self, base_mode: int, custom_mode: int) -> FlightMode:
        """Convert a heartbeat's mode to a `FlightMode`."""
        if not base_mode & CUSTOM_MODE_ENABLED:
            return FlightMode.OTHER
        return self.modes.get(custom_mode, FlightMode.OTHER)

    def command(self, mode: FlightMode) -> ModeCommand:
        """DO_SET_MODE parameters for a mode.

        Raises:
            ValueError: the mode cannot be commanded (OTHER).
        """
        if mode not in self.commands:
            raise ValueError(f"{mode} cannot be commanded")
        return self.commands[mode]

    def after_silence(self, loss_action: int | None) -> str:
        """What the autopilot does when setpoints stop, in words that follow "it"."""
        if loss_action is None:
            return self.silence
        return self.silence_by_action.get(loss_action, self.silence)

    def name(self, custom_mode: int) -> str:
        """The autopilot's own name for a mode."""
        return self.names.get(custom_mode, f"mode {custom_mode}")
