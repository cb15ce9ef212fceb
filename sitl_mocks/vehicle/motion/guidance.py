"""Guidance of the mock vehicle in its own modes: to a point, home, down, or along its mission."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.lists.list_download import GLOBAL_FRAMES
from companion.geometry import LocalFrame, Vec3
from sitl_mocks.vehicle.firmware.behaviour import Manners
from sitl_mocks.vehicle.motion.dynamics import Body
from sitl_mocks.vehicle.served.mission import MissionBook, StoredItem

HOVER: Vec3 = (0.0, 0.0, 0.0)
_DESCENT_MPS = 1.5
_SLOW_LANDING_BELOW_M = 10.0
_LANDING_CRUISE_MPS = 1.0
_RELATIVE_FRAMES = GLOBAL_FRAMES - {mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT}
"""Frames whose altitude is above home or above the terrain."""
_WAYPOINT = int(mavlink.MAV_CMD_NAV_WAYPOINT)
_LOITER_UNLIM = int(mavlink.MAV_CMD_NAV_LOITER_UNLIM)
_LOITER_TIME = int(mavlink.MAV_CMD_NAV_LOITER_TIME)
_RETURN = int(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
_LAND = int(mavlink.MAV_CMD_NAV_LAND)
_TAKEOFF = int(mavlink.MAV_CMD_NAV_TAKEOFF)
_DELAY = int(mavlink.MAV_CMD_NAV_DELAY)
_CHANGE_SPEED = int(mavlink.MAV_CMD_DO_CHANGE_SPEED)
_NAMES = {_WAYPOINT: "WP", _TAKEOFF: "Takeoff", _LAND: "Land", _RETURN: "RTL", _LOITER_UNLIM: "LoitUnlim"}


class Steering:
    """Computes velocities (NED, m/s) towards places in the home frame (m)."""

    def __init__(
        self, body: Body, manners: Manners, *, acceleration_mps2: float, vertical_mps2: float
    ) -> None:
        self._body = body
        self._acceleration = acceleration_mps2
        self._vertical = vertical_mps2
        self._climb = min(manners.takeoff_speed_mps, body.climb)
        self._slow_takeoff_m = manners.slow_takeoff_m
        self._descent = min(_DESCENT_MPS, body.descent)
        self._land = manners.land_speed_mps

    def towards(self, target: Vec3, cruise_mps: float) -> Vec3:
        """Velocity straight towards a point, decreasing so that the vehicle stops on it."""
        body = self._body
        north, east, down = target[0] - body.north, target[1] - body.east, target[2] - body.down
        distance = math.sqrt(north * north + east * east + down * down)
        if distance < 0.01:
            return HOVER
        scale = body.speed_towards(distance, cruise_mps, self._acceleration) / distance
        limit = self._descent if down > 0.0 else self._climb_limit
        if abs(down) * scale > limit:
            scale = limit / abs(down)
        vertical = down * scale
        stop = body.speed_towards(abs(down), limit, self._vertical)
        return north * scale, east * scale, min(max(vertical, -stop), stop)

    def to_height(self, down_m: float) -> Vec3:
        """Velocity straight up or down to a height."""
        body = self._body
        return self.towards((body.north, body.east, down_m), self._climb_limit)

    @property
    def _climb_limit(self) -> float:
        body = self._body
        return self._climb if -body.down < self._slow_takeoff_m else body.climb

    def landing(self, place: tuple[float, float] | None = None) -> Vec3:
        """Velocity of a descent that is slow near the ground.

        Args:
            place: point (north, east) to descend over; None descends at the present position.
        """
        body = self._body
        above = max(-body.down - _SLOW_LANDING_BELOW_M, 0.0)
        speed = math.sqrt(self._land * self._land + 2.0 * self._vertical * above)
        north, east = 0.0, 0.0
        if place is not None:
            north, east, _ = self.towards((*place, body.down), _LANDING_CRUISE_MPS)
        return north, east, min(speed, self._descent)


class Homecoming:
    """Guidance of a return to launch: climb, fly home, land."""

    def __init__(self, body: Body, steering: Steering, manners: Manners) -> None:
        self._body = body
        self._steering = steering
        self._height_m = manners.rtl_height_m
        self._down = 0.0
        self._climbed = False
        self.over_home = False

    def begin(self) -> None:
        """Start a return from the present position."""
        self._down = min(self._body.down, -self._height_m)
        self._climbed = False
        self.over_home = False

    def step(self, cruise_mps: float) -> Vec3:
        """Return the velocity for this step."""
        body = self._body
        distance = math.hypot(body.north, body.east)
        self.over_home = self.over_home or distance < 1.0
        if self.over_home:
            return self._steering.landing((0.0, 0.0))
        self._climbed = self._climbed or body.down < self._down + 0.5
        if not self._climbed:
            return self._steering.to_height(self._down)
        return self._steering.towards((0.0, 0.0, self._down), cruise_mps)


class MissionRunner:
    """Flies the mission items in order. It remembers the current item when the vehicle leaves the mode."""

    def __init__(
        self, book: MissionBook, frame: LocalFrame, body: Body, steering: Steering, manners: Manners
    ) -> None:
        self._book = book
        self._frame = frame
        self._body = body
        self._steering = steering
        self._manners = manners
        self._home = Homecoming(body, steering, manners)
        self._revision = book.revision
        self._target: Vec3 | None = None
        self._arrived_s: float | None = None
        self.seq = 0
        self.complete = False
        self.speed_mps: float | None = None
        """Speed set by DO_CHANGE_SPEED; None: the cruise speed is flown."""
        self.reached: list[int] = []
        self.texts: list[str] = []

    def sync(self) -> None:
        """Adopt changes made by the mission protocol: restart a new mission, jump to a requested item."""
        book = self._book
        if book.revision != self._revision:
            self._revision = book.revision
            self._restart(0)
        if book.requested_seq is not None:
            seq, book.requested_seq = book.requested_seq, None
            if seq < len(book.items):
                self._restart(seq)

    def resume(self) -> None:
        """Continue with the same item when the vehicle enters the mission mode."""
        self.sync()
        if self.complete or self.seq < self._book.first_seq:
            self._restart(self._book.first_seq)
        else:
            self._begin()

    @property
    def item(self) -> StoredItem | None:
        """The item being flown; None if there is none."""
        return self._book.items[self.seq] if self.seq < len(self._book.items) else None

    @property
    def taking_off(self) -> bool:
        """Whether the current item is a take-off."""
        item = self.item
        return item is not None and item.command == _TAKEOFF and not self.complete

    @property
    def climbing(self) -> bool:
        """Whether the current item is a take-off whose height is not reached yet."""
        item = self.item
        return item is not None and self.taking_off and self._body.down >= 0.5 - self._height_m(item)

    @property
    def landing(self) -> bool:
        """Whether the current item ends on the ground."""
        item = self.item
        return item is not None and item.command in (_LAND, _RETURN)

    def step(self, now_s: float, cruise_mps: float) -> Vec3:
        """Return the velocity for this step. Items that are done are passed over."""
        self.sync()
        for _ in range(len(self._book.items) + 1):
            item = self.item
            if item is None or self.complete:
                break
            velocity = self._fly(item, now_s, self.speed_mps or cruise_mps)
            if velocity is not None:
                return velocity
            self._next()
        return HOVER if self._target is None else self._steering.towards(self._target, cruise_mps)

    def rewind(self) -> None:
        """Go back to the beginning of the mission."""
        self.seq = 0
        self.complete = False

    def _restart(self, seq: int) -> None:
        self.seq = seq
        self.complete = False
        self._begin()

    def _begin(self) -> None:
        self._target = None
        self._arrived_s = None
        self._home.begin()
        item = self.item
        if item is not None and self.seq >= self._book.first_seq and self._manners.mission_texts:
            self.texts.append(f"Mission: {self.seq} {_NAMES.get(item.command, f'Command {item.command}')}")

    def _next(self) -> None:
        self.reached.append(self.seq)
        if self.seq + 1 >= len(self._book.items):
            self.complete = True
            return
        held = self._target
        self.seq += 1
        self._begin()
        if self.item is not None and self.item.command not in (_WAYPOINT, _LOITER_UNLIM, _LOITER_TIME):
            self._target = held if self.item.command == _DELAY else None

    def _fly(self, item: StoredItem, now_s: float, cruise_mps: float) -> Vec3 | None:
        """Return the velocity while the item lasts, None when it is done."""
        command = item.command
        if command == _CHANGE_SPEED:
            if item.params[1] > 0.0:
                self.speed_mps = item.params[1]
            return None
        if command == _TAKEOFF:
            down = -self._height_m(item)
            if self._body.down >= down + 0.5:
                return self._steering.to_height(down)
            return self._fly_point(item, now_s, cruise_mps) if self._manners.flies_to_takeoff_item else None
        if command == _RETURN:
            return self._home.step(cruise_mps)
        if command == _LAND:
            return self._fly_land(item, cruise_mps)
        if command == _DELAY:
            return self._wait(now_s, item.params[0])
        if command in (_WAYPOINT, _LOITER_UNLIM, _LOITER_TIME):
            return self._fly_point(item, now_s, cruise_mps)
        return None

    def _fly_point(self, item: StoredItem, now_s: float, cruise_mps: float) -> Vec3 | None:
        target = self._target or self._place(item)
        self._target = target
        body = self._body
        radius = self._manners.acceptance_radius_m
        if item.command == _WAYPOINT and item.params[1] > 0.0:
            radius = item.params[1]
        near = math.hypot(target[0] - body.north, target[1] - body.east) <= radius
        if (near and abs(target[2] - body.down) <= max(radius, 1.0)) or self._arrived_s is not None:
            hold = 0.0 if item.command == _LOITER_UNLIM or math.isnan(item.params[0]) else item.params[0]
            if item.command != _LOITER_UNLIM and self._wait(now_s, hold) is None:
                return None
        return self._steering.towards(target, cruise_mps)

    def _fly_land(self, item: StoredItem, cruise_mps: float) -> Vec3:
        if not item.placed:
            return self._steering.landing()
        if self._target is None:
            north, east, _ = self._place(item)
            self._target = (north, east, self._body.down)
        north, east, down = self._target
        if self._arrived_s is None and math.hypot(north - self._body.north, east - self._body.east) > 0.5:
            return self._steering.towards((north, east, down), cruise_mps)
        self._arrived_s = 0.0
        return self._steering.landing((north, east))

    def _wait(self, now_s: float, seconds: float) -> Vec3 | None:
        if self._arrived_s is None:
            self._arrived_s = now_s
        return None if now_s - self._arrived_s >= seconds else HOVER

    def _height_m(self, item: StoredItem) -> float:
        """Height of an item over home. An item without a height keeps the present height."""
        if not math.isfinite(item.z):
            return -self._body.down
        return item.z if item.frame in _RELATIVE_FRAMES else item.z - self._frame.alt_m

    def _place(self, item: StoredItem) -> Vec3:
        """Place of an item in NED. An item without a place means the present position."""
        if not item.placed:
            return self._body.north, self._body.east, -self._height_m(item)
        return self._frame.to_ned(item.x * 1e-7, item.y * 1e-7, self._frame.alt_m + self._height_m(item))
