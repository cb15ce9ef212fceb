"""The steps of `ground-tools fly`. Each step commands all vehicles and then waits for all of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.lists.mission import NAV_LAND, NAV_RETURN_TO_LAUNCH, NAV_TAKEOFF
from companion.events import FlightMode, MissionItem
from companion.geometry import LocalFrame
from ground_tools.fly.missions import begins_with_takeoff, first_moving
from ground_tools.fly.modes import COMING_DOWN
from ground_tools.fly.vehicle import ARM_DISARM, SILENT_S, Vehicle, VehicleError

MISSION_START = int(mavlink.MAV_CMD_MISSION_START)
READY_S = 90.0
"""Timeout until a vehicle can be armed. ArduPilot takes 30 to 45 s after a cold start."""
_AGAIN_S = 2.0
_TRIES, _GO_S = 5, 1.0
_START_S = 10.0
_SETTLED_S = 0.5
"""Time after an ACK by which earlier messages have arrived."""
_ELSEWHERE_S = 3.0
"""If a vehicle is in an unexpected mode for longer than this, a pilot or a failsafe has chosen it."""
_SLOW_MPS = 0.3
"""Slowest climb and descent rate that the timeouts allow."""
_AT_START_M = 3.0
_POLL_S = 0.1
_ENDS = frozenset({NAV_LAND, NAV_RETURN_TO_LAUNCH})
_UNKNOWN, _ACTIVE, _COMPLETE = (
    int(getattr(mavlink, f"MISSION_STATE_{name}")) for name in ("UNKNOWN", "ACTIVE", "COMPLETE")
)
"""Values of MISSION_STATE. Firmware that does not report the state also sends 0."""
_NO_TOTAL = 0xFFFF
"""Value of MISSION_CURRENT.total in firmware that does not report it; 0: older firmware, or no mission."""


def finished(state: int, reached: int | None, last_seq: int) -> bool:
    """Whether a mission is complete, by MISSION_STATE or, if that is unknown, by the last item reached."""
    return state == _COMPLETE or (state == _UNKNOWN and reached == last_seq)


class Fleet:
    """Vehicles that fly together.

    Args:
        vehicles: The vehicles.
        say: Takes one line of progress.
        ended: Not empty after the user interrupted; the running step then raises KeyboardInterrupt.
    """

    def __init__(self, vehicles: Sequence[Vehicle], say: Callable[[str], None], ended: Sequence[int]) -> None:
        self.vehicles = vehicles
        self._say = say
        self._ended = ended
        self._missions: list[tuple[MissionItem, ...]] = [()] * len(vehicles)
        self._elsewhere_s: dict[str, float] = {}
        """Time (monotonic, s) since which a vehicle is in an unexpected mode, by name."""
        self._began_s: dict[str, float] = {}
        """Time (monotonic, s) at which a vehicle's mission was started, by name."""
        self._ending: set[str] = set()
        """Names of the vehicles that have reached the landing at the end of their mission."""

    def wait_for_home(self) -> None:
        """Wait until every vehicle has a home position. Raises VehicleError."""

        def known(vehicle: Vehicle) -> bool:
            return bool(vehicle.last("HOME_POSITION"))

        self._until(known, READY_S, "home", lambda v: "it is not known yet", quiet=True)

    def upload(self, missions: Sequence[tuple[MissionItem, ...]]) -> None:
        """Upload one mission to each vehicle.

        Raises:
            VehicleError: An upload failed, or a vehicle flies a mission, which the upload would replace in
                flight.
        """
        for vehicle in self.vehicles:
            if vehicle.armed and vehicle.mode == vehicle.modes.mission:
                raise VehicleError(
                    f"{vehicle.name}: it flies a mission in {vehicle.mode}; change its mode before the upload"
                )
        self._missions = list(missions)
        for vehicle, items in zip(self.vehicles, missions, strict=True):
            self._check_interrupt()
            vehicle.upload(items)
            self._say(
                f"{vehicle.name}: mission uploaded ({len(items)} items) and verified by reading it back"
            )

    def take_off(self, height_m: float) -> None:
        """Take off from the ground to a height above home. Raises VehicleError."""
        for vehicle in self.vehicles:
            if not vehicle.on_ground:
                raise VehicleError(
                    f"{vehicle.name}: cannot take off: it is already in the air, at {vehicle.height_m:.1f} m"
                )
        self._wait_ready()
        self.wait_for_home()  # The readiness of an armed vehicle does not tell its home.
        for vehicle in self.vehicles:
            self._arm(vehicle)
            self._check_interrupt()
            vehicle.ours = vehicle.modes.climbing
            if vehicle.modes.takes_off_above_msl:
                # Yaw and position are left open.
                vehicle.command(NAV_TAKEOFF, 0.0, 0.0, 0.0, None, None, None, vehicle.home[2] + height_m)
            else:
                vehicle.command(NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)
            self._say(f"{vehicle.name}: armed and taking off to {height_m:g} m")
        enough_m = height_m - max(0.5, 0.05 * height_m)

        def up(vehicle: Vehicle) -> bool:
            self._must_fly_in(vehicle, vehicle.modes.climbing | {vehicle.modes.external})
            return vehicle.height_m >= enough_m and not vehicle.on_ground

        self._until(up, 30.0 + height_m / _SLOW_MPS, "take-off", lambda v: f"{v.height_m:.0f} m")

    def start(self) -> None:
        """Start all missions. A mission that begins with a take-off may start from the ground.

        Raises:
            VehicleError: A vehicle failed, or is on the ground while its mission begins in the air.
        """
        # A disarmed vehicle stands on the ground, also if its land detector is not heard.
        standing = [vehicle for vehicle in self.vehicles if vehicle.on_ground or not vehicle.armed]
        for vehicle, items in zip(self.vehicles, self._missions, strict=True):
            if vehicle in standing and not begins_with_takeoff(items):
                raise VehicleError(
                    f"{vehicle.name}: it is on the ground, and its mission does not begin with a take-off; "
                    "add --takeoff"
                )
        if standing:
            self._wait_ready()
        for vehicle in standing:
            self._arm(vehicle)
        for vehicle, items in zip(self.vehicles, self._missions, strict=True):
            self._check_interrupt()
            if items and vehicle.modes.resumes and vehicle not in standing:
                self._rewind(vehicle, items)
            self._start(vehicle)
            self._say(f"{vehicle.name}: flying its mission")

    def gather(self) -> None:
        """Wait until all vehicles are at their first waypoint, then let all continue. Raises VehicleError."""
        far: dict[str, float] = {}

        def there(vehicle: Vehicle) -> bool:
            for one in self.vehicles:  # Also those that have arrived and wait.
                self._must_be_heard(one)
                self._must_fly_in(one, {one.modes.mission, one.modes.external})
            item = self._missions[self.vehicles.index(vehicle)][0]
            assert item.lat_deg is not None
            assert item.lon_deg is not None
            assert item.alt_m is not None
            start = LocalFrame(item.lat_deg, item.lon_deg, item.alt_m)
            far[vehicle.name] = math.hypot(*start.to_ned(*vehicle.place))
            return far[vehicle.name] <= _AT_START_M

        self._until(there, math.inf, "flight to the start", lambda v: f"{far[v.name]:.0f} m away")
        self._say("all vehicles have reached their start points and continue")
        for _ in range(_TRIES):
            waiting = [vehicle for vehicle in self.vehicles if vehicle.item < 2]
            if not waiting:
                return
            for vehicle in waiting:
                vehicle.go_on_with(2)
            self._sleep(_GO_S)
        raise VehicleError(f"{waiting[0].name}: it does not continue with item 2 of its mission")

    def wait(self) -> None:
        """Wait until all missions are complete. Raises VehicleError."""
        self._until(self._is_finished, math.inf, "mission", self._progress)

    def land(self) -> None:
        """Land all vehicles where they are, except those that descend already. Raises VehicleError."""
        for vehicle in self.vehicles:
            self._check_interrupt()
            if (vehicle.on_ground and not vehicle.armed) or vehicle.mode in COMING_DOWN:
                continue
            vehicle.command(NAV_LAND, 0.0, 0.0, 0.0, None)
            vehicle.ours = COMING_DOWN
            self._say(f"{vehicle.name}: lands from {vehicle.height_m:.1f} m")
        highest_m = max((v.height_m for v in self.vehicles if not v.on_ground), default=0.0)

        def down(vehicle: Vehicle) -> bool:
            if vehicle.on_ground and not vehicle.armed:
                return True
            if not vehicle.on_ground:
                self._must_fly_in(vehicle, COMING_DOWN)
            return False

        self._until(down, 60.0 + max(highest_m, 0.0) / _SLOW_MPS, "landing", lambda v: f"{v.height_m:.0f} m")

    def make_safe(self) -> dict[str, str]:
        """Leave every vehicle in a safe state after a failure or Ctrl-C. Returns what was done, by name.

        A vehicle in the air is commanded to hold and never disarmed. A vehicle that is flown by somebody
        else, or that descends already, is left alone. A vehicle on the ground that we armed is disarmed,
        unless its autopilot refuses.
        """
        done = {}
        for vehicle in self.vehicles:
            try:
                done[vehicle.name] = self._leave(vehicle)
            except Exception as error:  # A failure of one vehicle must not affect the others.
                done[vehicle.name] = f"could not be commanded ({error}); its own failsafe applies"
        return done

    # ------------------------------------------------------------ internals

    def _leave(self, vehicle: Vehicle) -> str:
        if not vehicle.ours and not vehicle.armed_by_us:
            return "was not commanded to move"
        vehicle.hear_again()
        if not vehicle.armed:
            return "is disarmed"
        if vehicle.on_ground and vehicle.armed_by_us:
            try:
                vehicle.command(ARM_DISARM, 0.0)
            except VehicleError:
                pass  # It is taking off after all.
            else:
                return "is on the ground and was disarmed"
        if vehicle.mode in COMING_DOWN:
            return f"descends at {vehicle.height_m:.1f} m and was left in {vehicle.mode}"
        if vehicle.mode not in (*vehicle.ours, vehicle.modes.holding):
            return f"is flown by another operator at {vehicle.height_m:.1f} m and was left in {vehicle.mode}"
        if vehicle.mode != vehicle.modes.holding:
            vehicle.set_mode(FlightMode.HOLD)
        return f"holds at {vehicle.height_m:.1f} m in {vehicle.mode} and is armed; land it"

    def _wait_ready(self) -> None:
        missing: dict[str, str | None] = {}

        def ready(vehicle: Vehicle) -> bool:
            missing[vehicle.name] = None if vehicle.armed else vehicle.not_ready()
            return missing[vehicle.name] is None

        self._until(ready, READY_S, "readiness", lambda v: missing[v.name] or "", quiet=True)

    def _arm(self, vehicle: Vehicle) -> None:
        """Enter a mode that allows take-off, then arm. Retries after a refusal while the estimator
        settles."""
        if vehicle.mode not in vehicle.modes.climbing:
            vehicle.set_mode(vehicle.modes.armed_in)
        end_s = time.monotonic() + READY_S
        told = ""
        while not vehicle.armed:
            try:
                vehicle.arm()
            except VehicleError as error:
                if time.monotonic() > end_s:
                    raise
                if str(error) != told:
                    told = str(error)
                    self._say(f"{error}; trying again")
                self._sleep(_AGAIN_S)

    def _rewind(self, vehicle: Vehicle, items: Sequence[MissionItem]) -> None:
        """Make item 1 of an uploaded mission the next one."""
        first = first_moving(items)
        for _ in range(_TRIES):
            vehicle.go_on_with(1)
            self._sleep(_GO_S)
            if first is None or vehicle.item <= first.seq:
                return
        raise VehicleError(f"{vehicle.name}: it does not go back to item 1 of its mission")

    def _start(self, vehicle: Vehicle) -> None:
        """Repeat the start command until the mission flies.

        PX4 acknowledges the command while it still checks the mission, but then does not enter the mode.
        """
        end_s = time.monotonic() + _START_S
        self._began_s[vehicle.name] = time.monotonic()
        while True:
            # Until the mission flies, the vehicle stays in the mode that we commanded before.
            vehicle.ours |= {vehicle.modes.mission}
            vehicle.command(MISSION_START)
            acked_s = time.monotonic() + _SETTLED_S
            while time.monotonic() < acked_s + 1.0:
                state = vehicle.last("MISSION_CURRENT", acked_s).get("mission_state")
                if vehicle.mode == vehicle.modes.mission and state in (_UNKNOWN, _ACTIVE, _COMPLETE):
                    vehicle.ours = frozenset({vehicle.modes.mission})
                    return
                self._sleep(_POLL_S)
            if time.monotonic() > end_s:
                said = vehicle.said(end_s - _START_S)
                raise VehicleError(
                    f"{vehicle.name}: it acknowledged the start of its mission but stays in {vehicle.mode}"
                    + (f": {said}" if said else "")
                )

    def _is_finished(self, vehicle: Vehicle) -> bool:
        items = self._missions[self.vehicles.index(vehicle)]
        current = vehicle.last("MISSION_CURRENT")
        # Without items of ours, the mission was already on the vehicle. PX4's total counts all its items,
        # ArduPilot's leaves out home.
        count = len(items) or current.get("total", 0)
        last_seq = count - 1 + vehicle.first_seq
        # An item that was reached before the start is one of an earlier flight.
        began_s = self._began_s.get(vehicle.name, -math.inf)
        reached = vehicle.last("MISSION_ITEM_REACHED", began_s).get("seq")
        if finished(current.get("mission_state", _UNKNOWN), reached, last_seq):
            return True
        modes = {vehicle.modes.mission, vehicle.modes.external}
        # Where the number of items is unknown, the last one cannot be told from any other.
        at_end = 0 < count < _NO_TOTAL and current.get("seq", 0) >= last_seq
        if at_end and (not items or items[-1].command in _ENDS):
            self._ending.add(vehicle.name)
        if vehicle.name in self._ending:
            # PX4 flies the RTL at the end of a mission in its RTL mode; before the end, RTL is a failsafe.
            # ArduPilot returns to its first item after it has landed and disarmed.
            if vehicle.on_ground and not vehicle.armed:
                return True
            modes |= COMING_DOWN
        self._must_fly_in(vehicle, modes)
        return False

    def _progress(self, vehicle: Vehicle) -> str:
        return f"item {vehicle.item}, {vehicle.mode}"

    def _must_be_heard(self, vehicle: Vehicle) -> None:
        """Raise VehicleError if the link to a vehicle is lost."""
        if vehicle.age_s("HEARTBEAT") > SILENT_S:
            raise VehicleError(f"{vehicle.name}: no heartbeat for {SILENT_S:g} s")

    def _must_fly_in(self, vehicle: Vehicle, modes: set[str] | frozenset[str]) -> None:
        """Raise VehicleError if disarmed, or in none of these modes for longer than `_ELSEWHERE_S`."""
        now_s = time.monotonic()
        if vehicle.armed and vehicle.mode in modes:
            self._elsewhere_s.pop(vehicle.name, None)
            return
        since_s = self._elsewhere_s.setdefault(vehicle.name, now_s)
        said = vehicle.said(since_s - _ELSEWHERE_S)
        why = f": {said}" if said else ""
        if not vehicle.armed:
            raise VehicleError(f"{vehicle.name}: it disarmed by itself{why}")
        if now_s - since_s > _ELSEWHERE_S:
            wanted = " or ".join(sorted(modes))
            raise VehicleError(
                f"{vehicle.name}: it is in {vehicle.mode}, not {wanted}; a pilot or a failsafe changed "
                f"the mode{why}"
            )

    def _until(
        self,
        done: Callable[[Vehicle], bool],
        patience_s: float,
        what: str,
        where: Callable[[Vehicle], str],
        *,
        quiet: bool = False,
    ) -> None:
        """Wait until `done` has been true once for each vehicle. Raises VehicleError."""
        self._elsewhere_s.clear()
        left = list(self.vehicles)
        end_s = time.monotonic() + patience_s
        told: dict[str, str] = {}
        told_s = time.monotonic()
        while left:
            self._check_interrupt()
            for vehicle in list(left):
                self._must_be_heard(vehicle)
                if done(vehicle):
                    left.remove(vehicle)
                    if not quiet:
                        self._say(f"{vehicle.name}: {what} done")
            if left and time.monotonic() > end_s:
                vehicle = left[0]
                raise VehicleError(
                    f"{vehicle.name}: {what} did not finish within {patience_s:.0f} s: {where(vehicle)}"
                )
            if time.monotonic() - told_s > 5.0:
                told_s = time.monotonic()
                for vehicle in left:
                    if told.get(vehicle.name) != where(vehicle):
                        told[vehicle.name] = where(vehicle)
                        self._say(f"{vehicle.name}: {what}: {where(vehicle)}")
            time.sleep(_POLL_S)

    def _sleep(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._check_interrupt()
            time.sleep(_POLL_S)

    def _check_interrupt(self) -> None:
        if self._ended:
            raise KeyboardInterrupt
