"""One companion, whole but for its sockets: MAVLink bytes and heard frames in, bytes and broadcasts out.

The flight loop and the lock-step simulation run this same object; the record of its steps is what a replay
feeds back to the heart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

from companion.authority.table import HOLDING
from companion.autopilot.link import AutopilotLink
from companion.autopilot.served.component_information import ComponentInformation
from companion.autopilot.served.own_parameters import OwnParameters
from companion.autopilot.signing import Signing
from companion.autopilot.tlog import TlogWriter
from companion.broadcast.own_messages import basic_id_of
from companion.config import Config
from companion.core import Companion
from companion.event_record import Step
from companion.events import (
    AnyCommand,
    AnyEvent,
    ArmStatus,
    AuthorityChanged,
    Broadcast,
    DownloadFence,
    DownloadMission,
    Event,
    FlightMode,
    GateAuthority,
    InputBehind,
    RadioState,
    RemoteIdHeard,
    Say,
    SetMode,
    SetSpeed,
    Settings,
    Severity,
    Threat,
    VelocitySetpoint,
)
from companion.gate.gate import STALL_S, Gate

_SAY_AGAIN_S = 5.0
"""The pilot is told of the same rule of the gate once in so long."""
_HOLDING = frozenset(state.value for state in HOLDING)


class Onboard:
    """The heart with its MAVLink link."""

    def __init__(
        self,
        config: Config,
        record: Callable[[Step], None] | None = None,
        *,
        policy: bytes | None = None,
        commanding: bool = True,
        tlog: TlogWriter | None = None,
        utc_guess_s: float = 0.0,
        signing: Signing | None = None,
        settings: Settings | None = None,
    ) -> None:
        """Build it.

        Args:
            record: takes every step of the heart.
            policy: the policy file that chooses the transports, as `Companion` takes it.
            commanding: False leaves the vehicle alone; the heart works all the same. Nothing is broadcast
                then (a dry run, a replay), so the vehicle is not told that Remote ID is ready either.
            tlog: takes the MAVLink of both directions.
            utc_guess_s: UTC minus monotonic time for the tlog until the vehicle tells it.
            signing: of the MAVLink link, as `AutopilotLink` takes it.
            settings: what ground stations have set before, checked; None: nothing.
        """
        self.commanding = commanding
        self.tlog = tlog
        self._utc_guess_s = utc_guess_s
        self.heart = Companion(config, policy)
        self.gate = Gate(config)
        self._own_parameters = OwnParameters(config, settings or Settings())
        self.link = AutopilotLink(
            config.vehicle,
            signing=signing,
            remote_id_component=config.remote_id.component,
            identity=basic_id_of(config.identity),
            yaw=config.flight.yaw,
            settings=self._own_parameters,
            information=ComponentInformation(config),
        )
        self._remote_id_component = config.remote_id.component and commanding
        self._record = record
        # By way of the record: a replay begins with the same settings.
        self._events: list[Event] = [] if self.settings == Settings() else [self.settings]
        self._told_gate(self._events, 0.0)
        self._emptied_s: float | None = None
        """When the link's input was last read until it was empty."""
        self._behind_since_s: float | None = None
        """Since when it was not, as of this step."""
        self._refusals_said: dict[int, float] = {}
        """Rule of the gate -> when the pilot was last told of it."""
        self._lost: str | None = None
        """As of `Gate.lost`, when the heart was last told."""
        self._asks = False
        """A step has begun whose commands have asked for no answer yet: each step asks once."""

    @property
    def settings(self) -> Settings:
        """What ground stations have set."""
        return self._own_parameters.settings

    def receive(self, data: bytes, now_s: float, *, emptied: bool = True) -> None:
        """Bytes from the autopilot's link, or none.

        Args:
            now_s: before they were read.
            emptied: nothing was left to be read behind them.
        """
        if self.tlog is not None and data:
            self.tlog.received(self._utc_s(now_s), data)
        self._note_pause(now_s)
        events = self.link.receive(data, now_s)
        self._told_gate(events, now_s)
        if self.link.answered_s is not None:
            self.gate.answered(self.link.answered_s, now_s)
        self._events += events
        if emptied:
            self._emptied(now_s)

    def _note_pause(self, now_s: float) -> None:
        """What comes after a pause in reading may be as old as the pause is long; what comes first, older."""
        if self._emptied_s is None or now_s - self._emptied_s > STALL_S:
            self._fall_behind(now_s)

    def _fall_behind(self, now_s: float) -> None:
        if self._behind_since_s is None:
            self._behind_since_s = now_s if self._emptied_s is None else self._emptied_s

    def _emptied(self, now_s: float) -> None:
        self._note_pause(now_s)
        self._emptied_s = now_s
        self.gate.emptied(now_s)

    def _told_gate(self, events: list[Event], now_s: float) -> None:
        for event in events:
            self.gate.hear(event, now_s)

    def hear(self, event: RemoteIdHeard | RadioState) -> None:
        """A frame from the radio, or its state."""
        self._events.append(event)

    def tick(self, now_s: float, *, read_s: float | None = None) -> list[Broadcast]:
        """One step of the heart on all that arrived. Returns what the radio must send; bytes for the
        autopilot wait in `drain`.

        Args:
            read_s: when reading the link's input began that found its end; None: just now.
        """
        events = self._step_events(now_s, read_s)
        self.gate.decided(now_s)
        commands = self.heart.step(now_s, events)
        for command in commands:
            if isinstance(command, DownloadMission | DownloadFence) or (
                self.commanding
                and isinstance(command, VelocitySetpoint | SetMode | SetSpeed | Say | ArmStatus | Threat)
            ):
                self.link.send(command, now_s)
            elif isinstance(command, AuthorityChanged) and command.state not in _HOLDING:
                self.link.cancel_mode()
        if self._record is not None:
            self._record(
                Step(
                    now_s=now_s,
                    events=cast("tuple[AnyEvent, ...]", tuple(events)),
                    commands=cast("tuple[AnyCommand, ...]", tuple(commands)),
                )
            )
        return [c for c in commands if isinstance(c, Broadcast)]

    def _step_events(self, now_s: float, read_s: float | None) -> list[Event]:
        """All that happened since the last step; what gate and shell have to say of it comes last."""
        read_s = now_s if read_s is None else read_s
        if now_s - read_s > STALL_S:
            self._fall_behind(now_s)
            self.gate.behind()
        else:
            self._emptied(read_s)
        if not self.gate.current(now_s):
            self._fall_behind(now_s)
        self._asks = True
        since_s, self._behind_since_s = self._behind_since_s, None
        self.link.begin_step(now_s, behind=since_s is not None)
        advanced = self.link.advance(now_s)
        self._told_gate(advanced, now_s)
        told: list[Event] = [] if since_s is None else [InputBehind(since_s=since_s)]
        if self.gate.lost != self._lost:
            self._lost = self.gate.lost
            told.append(GateAuthority(lost=self._lost))
        for refused in self.gate.broken():
            told.append(refused)
            said_s = self._refusals_said.get(refused.rule, -math.inf)
            if refused.ends != "nothing" and self.commanding and now_s - said_s >= _SAY_AGAIN_S:
                self._refusals_said[refused.rule] = now_s
                self.link.send(Say(severity=Severity.WARNING, text=f"DMUCA: {refused.text}"), now_s)
        events, self._events = self._events + advanced + told, []
        return events

    def drain(self, now_s: float) -> bytes:
        """Bytes to send to the autopilot now: what the gate lets leave."""
        if self.link.holds and self._asks:
            self._asks = False
            self.link.ask_for_answer(now_s)
        commanding = self.gate.answers(now_s, waiting=self.link.holds)
        data = self.gate.release(self.link.drain(commanding=commanding), now_s)
        if self.tlog is not None and data:
            self.tlog.sent(self._utc_s(now_s), data)
        return data

    def _utc_s(self, now_s: float) -> float:
        known = self.heart.own.utc_offset_s
        return now_s + (self._utc_guess_s if known is None else known)

    def let_go(self, now_s: float) -> None:
        """Ask the vehicle to hold; the heart is not stepped any more after this, so nothing is broadcast."""
        self.link.send(SetMode(mode=FlightMode.HOLD), now_s)
        self._asks = True
        if self._remote_id_component:
            self.link.send(ArmStatus(ready=False, text="companion is stopping"), now_s)

    def idle(self, now_s: float, *, read_s: float | None = None) -> None:
        """Keep the link alive, and the own state current, without stepping the heart; `read_s` as of
        `tick`."""
        for event in self._step_events(now_s, read_s):
            self.heart.own.take(event, now_s)
