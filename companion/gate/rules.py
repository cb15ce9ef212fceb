"""The single list of the gate's rules, in the order of their numbers. `docs/gate.md` prints this table."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class _Text:
    number: int
    name: str
    says: str
    ends: Literal["nothing", "fault", "authority"] = "fault"
    """What breaking the rule ends, as in `GateRefused.ends`."""


class Rule(enum.Enum):
    """Condition that a frame must meet to be sent."""

    WHOLE = _Text(1, "whole", "Only whole MAVLink 2 frames leave.")
    KIND = _Text(
        2,
        "kind",
        "Of all messages and commands only those leave that the companion needs: no arming, no parameters of "
        "the vehicle, no positions, no attitudes, no files written, no other commands.",
    )
    TARGET = _Text(
        3,
        "target",
        "A setpoint, a mode request and a speed go to the autopilot that is heard, and to nobody else; none "
        "leaves where two autopilots are heard and none was configured, unless the vehicle is already held.",
    )
    USE = _Text(
        4,
        "use",
        'With flight.use "watch" nothing is commanded; with DMUCA_ENABLE 0 nothing but a standstill and a '
        "hold. Nothing is commanded to a vehicle that is disarmed or on the ground.",
    )
    CURRENT = _Text(
        5,
        "current",
        "The input was read until it was empty within the last 0.25 s, and the vehicle said something within "
        "the last 0.5 s. After a longer pause or silence, at the start and after a backlog, here or on the "
        "way, a message that shows the vehicle's mode must have been read since. By the vehicle's own clock, "
        "what is read then is no older than 0.5 s, or half of vehicle.stale_after_s. The last message that "
        "shows the mode is no older than 3 s.",
        ends="nothing",
    )
    AUTHORITY = _Text(
        6,
        "authority",
        "A mode that we did not ask for, seen once while the vehicle is held or being taken, ends authority. "
        "Only what flight.rearm names gives it back. A vehicle that was flying when the companion started is "
        "not taken before it was down (flight.take_in_flight).",
        ends="authority",
    )
    MODE = _Text(
        7,
        "mode",
        "Only the four modes of docs/authority.md are asked for. The vehicle is taken only from a mode that "
        "may be ended. The other three are asked for only while it is in a mode that we asked for or are "
        "taking it from. At most five requests leave in two seconds.",
    )
    AGE = _Text(
        8,
        "age",
        "A setpoint leaves within 0.25 s of its decision, on an own position no older than "
        "vehicle.stale_after_s and half a second.",
        ends="nothing",
    )
    FORM = _Text(
        9,
        "form",
        "A setpoint is a finite velocity in the local NED frame, with one of two masks and no yaw rate.",
    )
    SPEED = _Text(
        10,
        "speed",
        "Speed, climb and descent are within [limits] and within what the vehicle says of itself.",
    )
    CHANGE = _Text(
        11,
        "change",
        "Horizontally a setpoint differs from the last one, or from the velocity that is flown, by no more "
        "than limits.max_acceleration_mps2 allows in the time since the last one, one second at most. A "
        "command to stand still may leave at any time.",
    )
    HEIGHT = _Text(
        12,
        "height",
        "Towards the configured floor or ceiling a setpoint is no faster than can be stopped before it, "
        "unless the vehicle is being slowed down, and goes on being so; beyond it, no further.",
    )
    FENCE = _Text(
        13,
        "fence",
        "Towards each wall of the fence a setpoint is no faster than can be stopped before it, with the same "
        "exception; outside of the fence, it leads no further out.",
    )
    ANSWER = _Text(
        14,
        "answer",
        "A setpoint, a mode request or a speed leaves only right behind an answer of the vehicle (TIMESYNC) "
        "to a question that is no older than 0.25 s, one step's commands for each answer: nothing waits in "
        "a stream that nobody reads. The rule does not apply to a vehicle that has never answered, not even "
        "late. Commands that wait for an answer for more than a second are a fault.",
    )

    @property
    def number(self) -> int:
        """Number of the rule in documents and messages."""
        return self.value.number

    @property
    def ends(self) -> Literal["nothing", "fault", "authority"]:
        """What breaking the rule ends, as in `GateRefused.ends`."""
        return self.value.ends

    def __str__(self) -> str:
        """Text for messages, with the rule's number and name."""
        return f"gate rule {self.value.number} ({self.value.name})"


def table() -> str:
    """The rules as a Markdown table."""
    rows = [f"| {rule.number} | {rule.value.name} | {rule.value.says} |" for rule in Rule]
    return "\n".join(["| rule | name | what must hold |", "|---|---|---|", *rows])


class Broken(Exception):  # noqa: N818 - it is no error of this program
    """Raised when a frame breaks a rule and must not be sent."""

    def __init__(self, rule: Rule, why: str) -> None:
        super().__init__(f"{rule}: {why}")
        self.rule = rule
        self.why = why
