"""Judges what has passed the gate by the whole history. It was written from docs/gate.md, without the gate's
code.

It knows what the vehicle has said, in plain numbers, and also where the walls are in the fence's own axes.
The list `found` holds what it finds, as pairs of a rule's name and a text.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

from tests.companion.gate.hostile.heard import Heard, Told

FREE = {0, 4, 20, 22, 40, 43, 47, 51, 77, 110, 111, 148, 247, 253, 396, 397, 12900, 12918}
MESSAGE_COMMANDS = {511, 512}
ASKED = {
    "ardupilot": {(4, 0): 4, (3, 0): 3, (17, 0): 17, (5, 0): 5},
    "px4": {(6, 0): 0x60000, (4, 4): 0x4040000, (4, 3): 0x3040000, (3, 0): 0x30000},
}
_S = struct.Struct("<I11fHBBB")
_C = struct.Struct("<7fHBBB")


@dataclass
class Oracle(Heard):
    """Oracle of one history."""

    found: list[tuple[str, str]] = field(default_factory=list)
    setpoints: int = 0
    requests: int = 0
    slowed: int = 0
    """Number of setpoints that were too fast for a wall and slowed the vehicle down."""
    late_mps: float = 0.0
    """Greatest speed of those that came after a pause in which the vehicle flew on."""

    def judge(self, offered: list[bytes], whole: list[bool], out: bytes, now_s: float) -> None:
        """Judge `out`, which has passed, against the frames that were offered and whether each is whole."""
        at, answer_s = 0, self.answer_s
        for frame, is_whole in zip(offered, whole, strict=True):
            left = out.startswith(frame, at)
            if left:
                at += len(frame)
                self._frame(frame, is_whole, now_s)
                if is_whole and self._commands(frame):
                    self.answer_s = -math.inf
                    if self.asked_at is not None and now_s - answer_s > 0.1:
                        self._broken("answer", f"{now_s - answer_s} s")
            if not is_whole or (not left and self._is_wrong(frame)):
                self.shut_s = now_s + 3.0
            if not is_whole:
                break
        if at != len(out):
            self._broken("whole", f"{len(out) - at} bytes left that were not offered, or behind garbage")

    def _broken(self, rule: str, words: str) -> None:
        self.found.append((rule, words))

    def _commands(self, frame: bytes) -> bool:
        """Whether a frame is a setpoint, a mode request or a speed."""
        number = int.from_bytes(frame[7:10], "little")
        payload = frame[10 : 10 + frame[1]].ljust(33, b"\0")
        return number == 84 or (number == 76 and _C.unpack(payload[:33])[7] in (176, 178))

    def _is_wrong(self, frame: bytes) -> bool:
        """Whether a frame is certainly a fault of the program above, and not only early or late."""
        number = int.from_bytes(frame[7:10], "little")
        return number not in FREE and number not in (76, 84)

    def _frame(self, frame: bytes, whole: bool, now_s: float) -> None:
        if not whole or frame[0] != 0xFD:
            return self._broken("whole", frame.hex())
        number = int.from_bytes(frame[7:10], "little")
        payload = frame[10 : 10 + frame[1]]
        if number in FREE or (number == 110 and payload[6:7] in (b"\x80", b"\x81")):
            return None
        if number == 84:
            if len(payload) > 53:
                return self._broken("whole", "a long setpoint")
            return self._setpoint(_S.unpack(payload.ljust(53, b"\0")), now_s)
        if number != 76:
            return self._broken("kind", f"message {number}")
        if len(payload) > 33:
            return self._broken("whole", "a long command")
        fields = _C.unpack(payload.ljust(33, b"\0"))
        if fields[7] in MESSAGE_COMMANDS:
            return None
        if fields[7] == 176:
            return self._request(fields, now_s)
        if fields[7] == 178:
            return self._speed(fields, now_s)
        return self._broken("kind", f"command {fields[7]}")

    def _commanded(self, target: tuple[int, int], now_s: float, custom: int | None = None) -> None:
        terms = self.terms
        if not self.heard or target != (self.system, 1):
            self._broken("target", f"{target}")
        if self.two and terms.any_vehicle and not self.engaged:
            self._broken("target", "two autopilots")
        if now_s - self.emptied_s > 0.25 or self.mode_turn <= self.gap_ended:
            self._broken("current", f"emptied at {self.emptied_s}, {self.mode_turn} <= {self.gap_ended}")
        if now_s - self.said_s > 0.5:
            self._broken("current", f"silent for {now_s - self.said_s} s")
        if now_s < self.mixed_until_s:
            self._broken("current", f"old messages among new ones until {self.mixed_until_s} s")
        if now_s - self.mode_s > 3.0:
            self._broken("current", f"mode {now_s - self.mode_s} s old")
        on_ground = self.grounded_s is not None and now_s - self.grounded_s >= 12.0
        if terms.use == "watch" or not self.armed or on_ground:
            self._broken("use", f"{terms.use}, armed {self.armed}, on ground {on_ground}")
        chosen = custom is not None and custom == self.chosen
        restores = self.overruled and chosen and self.kinds.get(custom) != "external"
        if self.gone and not restores:
            self._broken("authority", f"mode {self.custom}")
        if not self.down:
            self._broken("authority", "was flying")

    def _held(self) -> bool:
        ours = self.custom in self.entered or self.custom in self.asked or self.custom == self.taken_from
        chosen = self.terms.use == "fly" and self.kinds.get(self.custom) == "external"
        return chosen or (self.engaged and ours)

    def _takeable(self) -> bool:
        kind = self.kinds.get(self.custom)
        px4_hold = self.terms.use == "fly" and self.terms.firmware == "px4" and kind == "hold"
        return kind == "mission" or px4_hold

    def _request(self, fields: tuple[float, ...], now_s: float) -> None:
        self.requests += 1
        custom = ASKED[self.terms.firmware].get((fields[1], fields[2]))  # type: ignore[call-overload]
        self._commanded((int(fields[8]), int(fields[9])), now_s, custom)
        if custom is None or fields[0] != 1.0:
            return self._broken("mode", f"{fields}")
        kind = self.kinds[custom]
        if kind == "mission" and self.terms.use == "fly":
            self._broken("mode", "mission while flying")
        if not self.enabled and kind == "external":
            self._broken("use", "disabled")
        if not (self._held() or (kind == "external" and self._takeable())):
            self._broken("mode", f"{kind} from {self.custom}")
        self.asked_s = [s for s in self.asked_s if now_s - s < 2.0]
        self.asked_s.append(now_s)
        if len(self.asked_s) > 5:
            self._broken("mode", "storm")
        if now_s < self.shut_s and kind != "hold":
            self._broken("age", "request after a fault")
        self._take()
        self.asked[custom] = now_s + 10.0
        self.open[custom] = now_s
        self.newest, self.commanded_s = custom, now_s
        return None

    def _take(self) -> None:
        if not self.engaged:
            self.engaged, self.taken_from = True, self.custom

    def _speed(self, fields: tuple[float, ...], now_s: float) -> None:
        self._commanded((int(fields[8]), int(fields[9])), now_s)
        mission = self.kinds.get(self.custom) == "mission" or any(
            self.kinds[c] == "mission" for c in self.asked
        )
        if self.terms.use != "guard" or not mission:
            self._broken("mode", "speed without a mission")
        if not 0.0 < fields[1] <= 100.0:
            self._broken("speed", f"{fields[1]}")
        if now_s < self.shut_s:
            self._broken("age", "speed after a fault")

    def _setpoint(self, fields: tuple[float, ...], now_s: float) -> None:
        self.setpoints += 1
        self.now_s = now_s
        _, *numbers, mask, system, component, frame = fields
        north, east, down = numbers[3:6]
        self._commanded((int(system), int(component)), now_s)
        if not all(map(math.isfinite, numbers)) or frame != 1 or mask not in (0x9C7, 0x5C7) or numbers[10]:
            return self._broken("form", f"{fields}")
        standing = north == east == down == 0.0
        if not self.enabled and not standing:
            self._broken("use", "disabled")
        if not (self._held() or self._takeable()):
            self._broken("authority", f"setpoint in {self.custom}")
        if abs(now_s - self.decided_s) > 0.25:
            self._broken("age", f"decided {now_s - self.decided_s} s ago")
        if now_s < self.shut_s:
            self._broken("age", "after a fault")
        position, terms = self.position, self.terms
        age_s = math.inf if position is None else now_s - position.measured_s
        if age_s > terms.stale_s + 0.5 + self.least_s + 0.02:
            return self._broken("age", f"position {age_s} s old")
        assert position is not None
        if not standing:
            if math.hypot(north, east, down) > terms.speed + 0.002:
                self._broken("speed", f"{(north, east, down)}")
            if not -terms.climb - 0.002 <= down <= terms.descent + 0.002:
                self._broken("speed", f"{down} down")
            self._change(position, north, east, now_s)
            self._bounds(position, north, east, down, now_s)
        self._take()
        self.commanded_s = now_s
        self.last = now_s, north, east
        return None

    def _change(self, position: Told, north: float, east: float, now_s: float) -> None:
        a = self.terms.acceleration
        n, e = position.north_east
        flown = math.hypot(n, e, position.velocity[2])
        slower = min(1.0, self.terms.speed / flown) if flown else 1.0
        near = math.hypot(north - slower * n, east - slower * e) <= a + 1.0 + 0.01
        if self.last is None or now_s - self.last[0] > 1.0:
            self.changes = []
            if not near:
                self._broken("change", f"{(north, east)} at {(n, e)}")
            return
        self.changes.append((self.last[0], math.hypot(north - self.last[1], east - self.last[2])))
        # Over any interval, the changes add up to at most what the interval plus one second allows.
        total, most = 0.0, -math.inf
        for since_s, change in reversed(self.changes[-60:]):
            total += change
            most = max(most, total - a * (now_s - since_s))
        if most <= a + 0.01:
            return
        self.changes = []
        if not near:
            self._broken("change", f"{most} m/s beyond the time, at {(n, e)}")

    def _bounds(self, position: Told, north: float, east: float, down: float, now_s: float) -> None:
        terms, age_s = self.terms, now_s - position.measured_s
        height = position.height - age_s * position.velocity[2]
        slack = 1.0 + 0.05 + 0.03 * abs(position.velocity[2])
        for rule, room, towards, flown in (
            ("floor", terms.floor and height - terms.floor, down, position.velocity[2]),
            ("ceiling", terms.ceiling and terms.ceiling - height, -down, -position.velocity[2]),
        ):
            if room is not None and self._too_fast(room + slack, towards, flown):
                self._broken("height", f"{rule}: {towards} m/s, {room} m, flown {flown}")
        if terms.walls is None:
            return
        cos, sin = math.cos(terms.turn), math.sin(terms.turn)
        u, v = cos * north + sin * east, cos * east - sin * north
        fu, fv = position.velocity[:2]
        pu, pv = position.place[0] + age_s * fu, position.place[1] + age_s * fv
        low_u, high_u, low_v, high_v = terms.walls
        slack = 0.05 + 0.03 * math.hypot(fu, fv)
        near_u, near_v = min(max(pu, low_u), high_u), min(max(pv, low_v), high_v)
        away = math.hypot(pu - near_u, pv - near_v)
        if away > slack:
            ou, ov = (pu - near_u) / away, (pv - near_v) / away
            outward = u * ou + v * ov
            if away > 10 * slack and outward > 0.3 and outward > fu * ou + fv * ov + 0.1:
                self._broken("fence", f"{outward} m/s further out, {away} m")
            return
        if min(high_u - pu, pu - low_u, high_v - pv, pv - low_v) < slack:
            return  # The position is on the wall, and outside of it the other walls do not count.
        for room, towards, flown in (
            (high_u - pu, u, fu),
            (pu - low_u, -u, -fu),
            (high_v - pv, v, fv),
            (pv - low_v, -v, -fv),
        ):
            if self._too_fast(room + slack, towards, flown):
                self._broken("fence", f"{towards} m/s towards, {room} m, flown {flown}")

    def _too_fast(self, room: float, towards: float, flown: float) -> bool:
        a = self.terms.acceleration
        if towards <= 0.002 or towards * 0.5 + towards * towards / (2.0 * a) <= room:
            return False
        self.slowed += 1
        if self.last is not None and self.now_s - self.last[0] > 0.25:
            self.late_mps = max(self.late_mps, towards)
        return towards > flown - 0.05 * a + 0.02
