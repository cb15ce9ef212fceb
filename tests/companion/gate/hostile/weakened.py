"""Gates that lack one rule each. They are built on the gate's public methods: the gate is told something
untrue, or what it refuses passes all the same. The oracle must find every one of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import msgspec

from companion.autopilot.wire import frame_length, message_id_of
from companion.config import Config
from companion.events import (
    CurrentMode,
    Event,
    FenceDownloaded,
    GlobalPosition,
    Heartbeat,
    LandedState,
    Settings,
    TwoAutopilots,
    VehicleParameters,
)
from companion.gate.gate import Gate

_SETPOINT, _COMMAND = struct.Struct("<I11fHBBB"), struct.Struct("<7fHBBB")


def _limits(config: Config, **limits: object) -> Config:
    return msgspec.structs.replace(config, limits=msgspec.structs.replace(config.limits, **limits))


class Weakened:
    """The gate, with everything passed on as it is."""

    def __init__(self, config: Config) -> None:
        self.gate = Gate(self.configured(config))
        self.counts = self.gate.counts

    def configured(self, config: Config) -> Config:
        return config

    def hear(self, event: Event, now_s: float) -> None:
        self.gate.hear(event, now_s)

    def emptied(self, now_s: float) -> None:
        self.gate.emptied(now_s)

    def behind(self) -> None:
        self.gate.behind()

    def answered(self, asked_s: float, now_s: float) -> None:
        self.gate.answered(asked_s, now_s)

    def decided(self, now_s: float) -> None:
        self.gate.decided(now_s)

    def release(self, data: bytes, now_s: float) -> bytes:
        return self.gate.release(data, now_s)


class PassesGarbage(Weakened):
    def release(self, data: bytes, now_s: float) -> bytes:
        at = 0
        while at < len(data):
            length = frame_length(data, at) if data[at] == 0xFD else -1
            if length <= 0 or at + length > len(data):
                return self.gate.release(data[:at], now_s) + data[at:]
            at += length
        return self.gate.release(data, now_s)


class _Each(Weakened):
    """Frame by frame; `instead` is what the gate is shown."""

    def instead(self, frame: bytes) -> bytes | None:
        """What is asked in its place; None: it leaves unasked."""
        return frame

    def release(self, data: bytes, now_s: float) -> bytes:
        out, at = b"", 0
        while at < len(data):
            length = frame_length(data, at) if data[at] == 0xFD else -1
            if length <= 0 or at + length > len(data):
                return out + self.gate.release(data[at:], now_s)
            frame = data[at : at + length]
            at += length
            shown = self.instead(frame)
            if shown is None or self.gate.release(shown, now_s):
                out += frame
        return out


def _payload(frame: bytes, layout: struct.Struct) -> list[float]:
    return list(layout.unpack(frame[10 : 10 + frame[1]][: layout.size].ljust(layout.size, b"\0")))


def _with(frame: bytes, layout: struct.Struct, fields: list[float]) -> bytes:
    """The gate reads no checksum that a test would have to mend."""
    payload = layout.pack(*fields)
    return frame[:1] + bytes((len(payload), 0)) + frame[3:10] + payload + b"\0\0"


class PassesKinds(_Each):
    def instead(self, frame: bytes) -> bytes | None:
        if message_id_of(frame) == 76:
            return frame if _payload(frame, _COMMAND)[7] in (176, 178, 511, 512) else None
        return frame if message_id_of(frame) in (84, 0, 4, 77) else None


class PassesTargets(_Each):
    system = 1

    def hear(self, event: Event, now_s: float) -> None:
        if isinstance(event, Heartbeat):
            self.system = event.system_id
        if not isinstance(event, TwoAutopilots):
            self.gate.hear(event, now_s)

    def instead(self, frame: bytes) -> bytes | None:
        number = message_id_of(frame)
        if number not in (76, 84) or len(frame) > 10 + 53 + 2:
            return frame
        layout, at = (_COMMAND, 8) if number == 76 else (_SETPOINT, 13)
        fields = _payload(frame, layout)
        fields[at], fields[at + 1] = self.system, 1
        return _with(frame, layout, fields)


class CommandsAnyVehicle(Weakened):
    def hear(self, event: Event, now_s: float) -> None:
        if isinstance(event, Heartbeat):
            event = msgspec.structs.replace(event, armed=True)
        if not isinstance(event, Settings | LandedState):
            self.gate.hear(event, now_s)

    def configured(self, config: Config) -> Config:
        flight = msgspec.structs.replace(config.flight, take_in_flight=True)
        return msgspec.structs.replace(config, flight=flight)


class BelievesOldModes(Weakened):
    beat: Heartbeat | None = None

    def hear(self, event: Event, now_s: float) -> None:
        self.gate.emptied(now_s)
        if isinstance(event, Heartbeat):
            self.beat = event
        self.gate.hear(event, now_s)

    def behind(self) -> None:
        pass

    def release(self, data: bytes, now_s: float) -> bytes:
        self.gate.emptied(now_s)
        if self.beat is not None:
            self.gate.hear(self.beat, now_s)
        return self.gate.release(data, now_s)


class TakesOvertakenModes(Weakened):
    """It takes a mode that newer messages have overtaken for the present one."""

    def hear(self, event: Event, now_s: float) -> None:
        if isinstance(event, Heartbeat | CurrentMode):
            event = msgspec.structs.replace(event, overtaken=False)
        self.gate.hear(event, now_s)


class ReliesOnMixedLinks(Weakened):
    """It does not remember that the link delivered an old message after a newer one."""

    def hear(self, event: Event, now_s: float) -> None:
        self.gate.hear(event, now_s)
        self.gate._bounds._mixed_until_s = -math.inf


class HearsNoSilence(Weakened):
    """It takes every look at an empty input for a message of the vehicle."""

    landed: LandedState | None = None

    def hear(self, event: Event, now_s: float) -> None:
        if isinstance(event, LandedState):
            self.landed = event
        self.gate.hear(event, now_s)

    def emptied(self, now_s: float) -> None:
        if self.landed is not None:
            self.gate.hear(self.landed, now_s)
        self.gate.emptied(now_s)


class OverlooksModes(Weakened):
    """One message in two that shows another mode."""

    seen = 0
    custom = -1

    def hear(self, event: Event, now_s: float) -> None:
        if isinstance(event, Heartbeat | CurrentMode) and event.custom_mode != self.custom:
            self.seen += 1
            self.custom = event.custom_mode
            if self.seen % 2:
                return
        self.gate.hear(event, now_s)


class AsksForAnyMode(_Each):
    def instead(self, frame: bytes) -> bytes | None:
        if message_id_of(frame) == 76 and _payload(frame, _COMMAND)[7] == 176:
            return None
        return frame


class KnowsNoAge(Weakened):
    last: GlobalPosition | None = None
    heard_s = 0.0

    def hear(self, event: Event, now_s: float) -> None:
        if isinstance(event, GlobalPosition):
            self.last, self.heard_s = event, now_s
        self.gate.hear(event, now_s)

    def release(self, data: bytes, now_s: float) -> bytes:
        self.gate.decided(now_s)
        if self.last is not None:
            boot_s = self.last.time_boot_s + now_s - self.heard_s
            self.gate.hear(msgspec.structs.replace(self.last, time_boot_s=boot_s), now_s)
        return self.gate.release(data, now_s)


class PassesForms(_Each):
    def instead(self, frame: bytes) -> bytes | None:
        if message_id_of(frame) != 84 or len(frame) > 10 + 53 + 2:
            return frame
        fields = _payload(frame, _SETPOINT)
        fields[7:13] = [0.0, 0.0, 0.0, 0.0, 0.0, 0x9C7]
        fields[15] = 1
        return _with(frame, _SETPOINT, fields)


class KnowsNoSpeed(Weakened):
    def configured(self, config: Config) -> Config:
        return _limits(config, max_speed_mps=50.0, max_climb_mps=20.0, max_descent_mps=20.0)

    def hear(self, event: Event, now_s: float) -> None:
        if not isinstance(event, VehicleParameters):
            self.gate.hear(event, now_s)


class JumpsBetweenVelocities(Weakened):
    def configured(self, config: Config) -> Config:
        return _limits(config, max_acceleration_mps2=20.0)


class KnowsNoHeight(Weakened):
    def configured(self, config: Config) -> Config:
        return _limits(config, floor_height_m=None, ceiling_height_m=None)


class KnowsNoFence(Weakened):
    def configured(self, config: Config) -> Config:
        return msgspec.structs.replace(config, fence=())

    def hear(self, event: Event, now_s: float) -> None:
        if not isinstance(event, FenceDownloaded):
            self.gate.hear(event, now_s)


class NeedsNoAnswer(Weakened):
    def answered(self, asked_s: float, now_s: float) -> None:
        pass


class CountsRepeatedAnswers(Gate):
    """Takes an answer for a new message of the vehicle each time that it is reported."""

    def answered(self, asked_s: float, now_s: float) -> None:
        self._note_heard(now_s)
        super().answered(asked_s, now_s)


class IgnoresBacklogs(Gate):
    """Takes every read of the input for complete."""

    def behind(self) -> None:
        self.emptied(self._heard_s)


LACKING: dict[str, Callable[[Config], Weakened]] = {
    "whole": PassesGarbage,
    "kind": PassesKinds,
    "target": PassesTargets,
    "use": CommandsAnyVehicle,
    "current": BelievesOldModes,
    "authority": OverlooksModes,
    "mode": AsksForAnyMode,
    "age": KnowsNoAge,
    "form": PassesForms,
    "speed": KnowsNoSpeed,
    "change": JumpsBetweenVelocities,
    "height": KnowsNoHeight,
    "fence": KnowsNoFence,
    "answer": NeedsNoAnswer,
}
