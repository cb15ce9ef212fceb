"""Tracks authority over the vehicle from its messages and the sent commands.

It checks the rules target, use, authority and mode.
"""

from __future__ import annotations

import math

from companion.autopilot.dialect import DIALECTS, flight_mode
from companion.config import Config
from companion.events import CurrentMode, FlightMode, Heartbeat, Landed
from companion.gate.rules import Broken, Rule

MODE_OLD_S = 3.0
_ASKED_S = 10.0
"""How long after a request the requested mode may still be entered."""
_LATE_S = 3.0
"""How long after a request the vehicle may obey it although the pilot has selected his mode meanwhile."""
_DOWN_S, _GROUNDED_S = 1.5, 12.0
"""How long the vehicle must report without a break that it is on the ground: `_DOWN_S` to count as having
been down, `_GROUNDED_S` to count as being on the ground."""
_FALLEN_S = 10.0
"""A vehicle that was not heard for a moment in flight must be disarmed for so long to count as having been
down: its autopilot may have restarted."""
_STORM, _STORM_S = 5, 2.0
_ASKABLE = frozenset({FlightMode.EXTERNAL, FlightMode.HOLD, FlightMode.STICKS, FlightMode.MISSION})


class Mandate:
    """Authority over one vehicle. Nothing is known until the first heartbeat.

    Times are monotonic seconds that never go back. `tests/companion/gate/test_proofs.py` compares this class
    with rule 6 after every sequence of modes, requests and setpoints.
    """

    def __init__(self, config: Config) -> None:
        self.heartbeat: Heartbeat | None = None
        self.lost: str | None = None
        """Why authority was lost, in words; None if it was not."""
        self.engaged = False
        """We control the vehicle, or have sent a command to take it, since authority was last reset."""
        self.enabled = True
        self.two_autopilots = False
        self._flight = config.flight
        self._any_vehicle = config.vehicle.system_id == 0
        self._guards = config.flight.use == "guard"
        self._mode: FlightMode | None = None
        self._mode_s = -math.inf
        self._custom = -1
        self._ours: dict[int, float] = {}
        """For each requested custom_mode: time until which it may be entered, infinite once it was."""
        self._base: int | None = None
        """custom_mode from which the vehicle is being taken, until the requested one is reported."""
        self._perhaps_entered = False
        """Whether a mode that we requested was shown since, by messages whose order is not known."""
        self._perhaps_held = False
        """Authority was lost by a message that may have been old: a mode that we requested may not be the
        pilot's."""
        self._asked: int | None = None
        """Latest requested custom_mode."""
        self._waits_s: dict[int, float] = {}
        """For each requested custom_mode that has not been reported while authority lasted: time of the
        latest request."""
        self._chosen: int | None = None
        """custom_mode that the pilot selected last, since authority was lost."""
        self._obeyed_late = False
        """The vehicle has obeyed a request of ours after the pilot selected his mode, and reports no other
        mode since."""
        self._commanded_s = -math.inf
        """Time at which a command to the vehicle was last sent."""
        self._left = False
        self._held_instead = False
        """Whether authority ended with a hold while the mission was requested, and no other mode was seen
        since."""
        self._grounded_s: float | None = None
        self._seen_down = config.flight.take_in_flight
        self._flew = self._unheard = False
        """Whether it was armed and in the air when its landed state was last reported, and whether it was
        then not heard for a moment and has not been armed since."""
        self._disarmed_s: float | None = None
        self._requests: list[float] = []

    # ------------------------------------------------------------ messages of the vehicle

    def hear_mode_message(self, event: Heartbeat | CurrentMode, now_s: float, *, overtaken: bool) -> None:
        """Take in HEARTBEAT, or CURRENT_MODE, the mode between two heartbeats.

        Args:
            overtaken: newer messages may have arrived before this one. Then it can only end authority.
                `event.overtaken`: by their numbers, some have.
        """
        if isinstance(event, Heartbeat):
            mode = event.mode
            if not overtaken:
                self.heartbeat = event
                if self._disarmed(event, now_s):
                    self._seen_down = True
                    if self._flight.rearm != "never" or not self.lost:
                        self._free()
        elif (h := self.heartbeat) is None:
            return
        else:
            mode = flight_mode(h.firmware, h.vehicle_type, 1, event.custom_mode)
        if not overtaken or self._ends(event.custom_mode, mode, now_s, old=event.overtaken):
            held = not self.lost
            self.hear_mode(event.custom_mode, mode, now_s)
            self._perhaps_held = bool(self.lost) and (self._perhaps_held or (held and overtaken))
        elif self.engaged and not (self.lost or event.overtaken or event.custom_mode == self._base):
            self._perhaps_entered, self._ours[event.custom_mode] = True, math.inf

    def unheard(self) -> None:
        """Note that the vehicle was not heard for so long that its autopilot may have restarted."""
        self._unheard = self._unheard or self._flew

    def _disarmed(self, event: Heartbeat, now_s: float) -> bool:
        """Whether a vehicle counts as disarmed: not if its autopilot may just have restarted in flight."""
        if event.armed:
            self._unheard, self._disarmed_s = False, None
            return False
        self._disarmed_s = now_s if self._disarmed_s is None else self._disarmed_s
        if self._unheard and now_s - self._disarmed_s < _FALLEN_S:
            return False
        self._flew = self._unheard = False
        return True

    def _ends(self, custom: int, mode: FlightMode, now_s: float, *, old: bool) -> bool:
        """Whether a mode ends authority even if the vehicle may have left it since: it is the pilot's, or the
        mission was handed back.

        Args:
            old: the message is certainly older than others, so it may show what was before we took control.
        """
        given = mode is (FlightMode.MISSION if self._guards else FlightMode.EXTERNAL)
        if not self.engaged or self.lost:
            return False
        if old:
            return not (given or custom == self._base or custom in self._ours)
        if custom == self._base:
            return self._perhaps_entered
        if mode is FlightMode.MISSION and custom == self._asked:
            return True
        return now_s > self._ours.get(custom, -math.inf) and not (given and not self._guards)

    def hear_mode(self, custom: int, mode: FlightMode, now_s: float) -> None:
        """Take in one reported mode. Call this in the order in which the vehicle reported them."""
        before, before_custom, before_s = self._mode, self._custom, self._mode_s
        self._mode, self._custom, self._mode_s = mode, custom, now_s
        if not self.lost:
            self._waits_s.pop(custom, None)
        left_ours, self._perhaps_entered = self._perhaps_entered, False
        given = mode is (FlightMode.MISSION if self._guards else FlightMode.EXTERNAL)
        if self.lost:
            self._held_instead = self._held_instead and mode is FlightMode.HOLD
            self._perhaps_held = self._perhaps_held and (custom in self._ours or custom == self._base)
            # A mode that changed in a silence may have changed at its beginning.
            late = custom != self._chosen and before_s - self._waits_s.get(custom, -math.inf) <= _LATE_S
            self._obeyed_late = late or (self._obeyed_late and custom == before_custom)
            if self._obeyed_late:
                self._left = self._left and not given
                return
            self._chosen = custom
            if given and self._left and self._flight.rearm == "mode" and not self._perhaps_held:
                self._free()
            self._left = self._left or not (given or self._perhaps_held)
        elif not self.engaged:
            pass
        elif custom == self._base and not left_ours:
            if mode is FlightMode.MISSION and self._guards and now_s - self._commanded_s > _ASKED_S:
                self._free()  # Our mode was never entered, and nothing was commanded since.
        elif now_s <= self._ours.get(custom, -math.inf) or (given and not self._guards):
            if mode is not FlightMode.MISSION:
                self._ours[custom], self._base = math.inf, None
            elif custom == self._asked:
                self._free()  # The mission was handed back.
            else:
                self._base = custom  # We asked for another mode since, so the mission is left again.
        else:
            self._held_instead = mode is FlightMode.HOLD and self._asked_mission(now_s)
            self._left = not given or not (before is FlightMode.EXTERNAL or left_ours)
            self.lost, self._chosen = f"the pilot selected {self.name(custom)}", custom
            if given and self._left and self._flight.rearm == "mode":
                self._free()

    def hear_landed(self, landed: Landed, now_s: float) -> None:
        """Take in EXTENDED_SYS_STATE."""
        if self.heartbeat is not None and self.heartbeat.armed:
            self._flew = landed is not Landed.ON_GROUND
        if landed is not Landed.ON_GROUND:
            self._grounded_s = None
            return
        self._grounded_s = now_s if self._grounded_s is None else self._grounded_s
        down = now_s - self._grounded_s >= _DOWN_S and not self._unheard
        self._seen_down = self._seen_down or down
        if self._grounded(now_s) and not self.lost:
            self._free()

    def mission_ended(self) -> None:
        """Note that the mission is complete. A hold that then begins by itself is not the pilot's."""
        if self.lost and self._held_instead:
            self._free()

    # ------------------------------------------------------------ checks of commands

    def check(self, now_s: float, custom: int | None = None) -> None:
        """Check what must hold for every command to the vehicle. Raises Broken otherwise.

        Args:
            custom: custom_mode that the command requests; None for any other command.
        """
        heartbeat = self.heartbeat
        if self._flight.use == "watch":
            raise Broken(Rule.USE, 'flight.use is "watch"')
        if heartbeat is None or now_s - self._mode_s > MODE_OLD_S:
            raise Broken(Rule.CURRENT, "the vehicle's mode is unknown")
        if not heartbeat.armed or self._grounded(now_s):
            raise Broken(Rule.USE, "the vehicle is disarmed or on the ground")
        if self.lost and not self._restores(custom):
            raise Broken(Rule.AUTHORITY, self.lost)
        if not self._seen_down:
            raise Broken(
                Rule.AUTHORITY,
                "the vehicle was flying when the companion started, and has not landed since",
            )
        if self.two_autopilots and self._any_vehicle and not self.engaged:
            raise Broken(Rule.TARGET, "two autopilots are heard")

    def check_setpoint(self, standing: bool) -> None:
        """Check that the vehicle flies setpoints or may be asked to. Raises Broken otherwise."""
        if not self.enabled and not standing:
            raise Broken(Rule.USE, "DMUCA_ENABLE is 0")
        if not (self._is_ours or self._may_take):
            raise Broken(Rule.AUTHORITY, f"the vehicle is in {self.name(self._custom)}")

    def check_request(self, mode: FlightMode, now_s: float) -> None:
        """Check that a mode may be requested. Raises Broken otherwise."""
        if mode not in _ASKABLE or (mode is FlightMode.MISSION and not self._guards):
            raise Broken(Rule.MODE, f"{mode.value} must not be requested")
        if not self.enabled and mode is FlightMode.EXTERNAL:
            raise Broken(Rule.USE, "DMUCA_ENABLE is 0")
        if not (self._is_ours or (mode is FlightMode.EXTERNAL and self._may_take)):
            raise Broken(Rule.MODE, f"{mode.value} must not be requested in {self.name(self._custom)}")
        self._requests = [at_s for at_s in self._requests if now_s - at_s < _STORM_S]
        if len(self._requests) >= _STORM:
            raise Broken(Rule.MODE, f"more than {_STORM} mode requests within {_STORM_S:g} s")

    def check_speed(self) -> None:
        """Check that a mission's speed is requested only with the mission. Raises Broken otherwise."""
        asked = any(self._kind(custom) is FlightMode.MISSION for custom in self._ours)
        if not self._guards or not (asked or self._mode is FlightMode.MISSION):
            raise Broken(Rule.MODE, f"a mission speed must not be requested in {self.name(self._custom)}")

    # ------------------------------------------------------------ commands that were sent

    def setpoint_left(self, now_s: float) -> None:
        """Note that a setpoint was sent."""
        self._commanded_s = now_s
        if not self.engaged:
            self.engaged, self._base = True, self._custom

    def request_left(self, custom: int, now_s: float) -> None:
        """Note that a mode request was sent."""
        self._commanded_s, self._asked = now_s, custom
        if not self.engaged or self._custom not in self._ours:
            self.engaged, self._base = True, self._custom
        self._requests.append(now_s)
        self._waits_s[custom] = now_s
        self._ours[custom] = max(self._ours.get(custom, 0.0), now_s + _ASKED_S)

    # ------------------------------------------------------------ names and kinds of modes

    def name(self, custom: int) -> str:
        """Name that the autopilot gives to a mode."""
        assert self.heartbeat is not None
        return DIALECTS[self.heartbeat.firmware].name(custom)

    def custom_of(self, param2: float, param3: float) -> tuple[int, FlightMode] | None:
        """Mode that the parameters of DO_SET_MODE request; None if they match no mode that we may request."""
        if self.heartbeat is None:
            return None
        for mode, command in DIALECTS[self.heartbeat.firmware].commands.items():
            if (command.param2, command.param3) == (param2, param3):
                return command.custom_mode, mode
        return None

    def _asked_mission(self, now_s: float) -> bool:
        return any(
            self._kind(custom) is FlightMode.MISSION and now_s <= until_s
            for custom, until_s in self._ours.items()
        )

    def _kind(self, custom: int) -> FlightMode:
        assert self.heartbeat is not None
        return DIALECTS[self.heartbeat.firmware].modes.get(custom, FlightMode.OTHER)

    def _restores(self, custom: int | None) -> bool:
        """Whether a request only restores the mode that the pilot has selected, because the vehicle obeyed an
        earlier request of ours after it."""
        if custom is None or custom != self._chosen or self._perhaps_held:
            return False
        return self._obeyed_late and self._kind(custom) is not FlightMode.EXTERNAL

    @property
    def _is_ours(self) -> bool:
        """Whether the vehicle is in a mode that we requested or from which we take it.

        With `use = "fly"` this includes GUIDED or OFFBOARD if the pilot selected it.
        """
        chosen = self._mode is FlightMode.EXTERNAL and not self._guards
        return chosen or (self.engaged and (self._custom in self._ours or self._custom == self._base))

    @property
    def _may_take(self) -> bool:
        """Whether the vehicle may be taken from its present mode."""
        assert self.heartbeat is not None
        if self._mode is FlightMode.HOLD and not self._guards:
            return FlightMode.HOLD in DIALECTS[self.heartbeat.firmware].take_from
        return self._mode is FlightMode.MISSION

    def _grounded(self, now_s: float) -> bool:
        return self._grounded_s is not None and now_s - self._grounded_s >= _GROUNDED_S

    def _free(self) -> None:
        self.lost, self.engaged, self._left, self._base = None, False, False, None
        self._held_instead = self._perhaps_entered = self._perhaps_held = False
        self._asked = self._chosen = None
        self._obeyed_late = False
        self._ours.clear()
        self._waits_s.clear()
