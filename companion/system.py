"""One complete companion without its sockets: MAVLink bytes and radio frames in, bytes and broadcasts out.

The flight loop and the lock-step simulation run this same object. A replay feeds the record of its steps back
to the core.
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
from companion.broadcast.signer import Signer
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
    TrafficReport,
    VelocitySetpoint,
)
from companion.gate.gate import STALL_S, Gate

_SAY_AGAIN_S = 5.0
"""Least time between two messages to the pilot about the same rule of the gate."""
_HOLDING = frozenset(state.value for state in HOLDING)
_REQUESTS = frozenset({DownloadMission, DownloadFence})
"""Commands of the core that only request data from the vehicle."""
_COMMANDS = frozenset({VelocitySetpoint, SetMode, SetSpeed, Say, ArmStatus, Threat, TrafficReport})
"""Commands of the core that are not sent to the vehicle in a dry run or a replay (`commanding=False`)."""


class CompanionSystem:
    """The core (`core`) with its MAVLink link and the gate."""

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
        signer: Signer | None = None,
    ) -> None:
        """Create the core, the gate and the link.

        Args:
            record: receives every step of the core.
            policy: content of the policy file that chooses the transports, as for `Companion`.
            commanding: False to send no commands to the vehicle, while the core runs as usual. Nothing is
                broadcast then (a dry run, a replay), so Remote ID is not reported as ready to the vehicle.
            tlog: receives the MAVLink of both directions.
            utc_guess_s: UTC minus monotonic time for the tlog until the vehicle reports UTC.
            signing: signing of the MAVLink link, as for `AutopilotLink`.
            settings: checked settings that ground stations made earlier; None if there are none.
            signer: signs the broadcasts; None if nothing is signed. Its signatures are not in the record.
        """
        self.commanding = commanding
        self.tlog = tlog
        self._utc_guess_s = utc_guess_s
        self.core = Companion(config, policy)
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
            sensed=config.sensed,
        )
        self.signer = signer
        self._remote_id_component = config.remote_id.component and commanding
        self._record = record
        # Pass the settings as an event, so that they are recorded and a replay starts with them.
        self._events: list[Event] = [] if self.settings == Settings() else [self.settings]
        self._told_gate(self._events, 0.0)
        self._emptied_s: float | None = None
        """Time at which the link's input was last read until it was empty."""
        self._behind_since_s: float | None = None
        """Time since which the input was behind, for the current step; None if it is not."""
        self._refusals_said: dict[int, float] = {}
        """For each rule of the gate: time at which the pilot was last informed of a refusal."""
        self._lost: str | None = None
        """`Gate.lost` as last reported to the core."""
        self._asks = False
        """The commands of this step have not asked the vehicle for an answer yet. Each step asks once."""

    @property
    def settings(self) -> Settings:
        """Settings that ground stations have made."""
        return self._own_parameters.settings

    def receive(self, data: bytes, now_s: float, *, emptied: bool = True) -> None:
        """Take in bytes from the autopilot's link; they may be empty.

        Args:
            now_s: time before the bytes were read.
            emptied: True if no more input was left to read.
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
        """Mark the input as behind after a pause in reading, because it may be as old as the pause is long.

        The first input of all may be even older.
        """
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
        """Take in a received frame or the state of the radios."""
        self._events.append(event)

    def tick(self, now_s: float, *, read_s: float | None = None) -> list[Broadcast]:
        """Run one step of the core on all input that arrived.

        Returns the broadcasts that the radio must send. Fetch bytes for the autopilot with `drain`.

        Args:
            read_s: time at which the reading of the link's input began that emptied it; None for just now.
        """
        events = self._step_events(now_s, read_s)
        self.gate.decided(now_s)
        commands = self.core.step(now_s, events)
        for command in commands:
            kind = type(command)
            if kind in _REQUESTS or (self.commanding and kind in _COMMANDS):
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
        broadcasts = [c for c in commands if type(c) is Broadcast]
        if self.signer is None:
            return broadcasts
        known = self.core.own.utc_offset_s
        return self.signer.add(broadcasts, now_s, None if known is None else now_s + known)

    def _step_events(self, now_s: float, read_s: float | None) -> list[Event]:
        """All events since the last step. Those of this class and of the gate come last."""
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
        told: list[Event] = []
        if since_s is not None:
            why, by_clock = self.gate.behind_because(now_s)
            told.append(InputBehind(since_s=since_s, why=why, by_clock=by_clock))
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
        """Bytes to send to the autopilot now, as far as the gate lets them pass."""
        if self.link.holds and self._asks:
            self._asks = False
            self.link.ask_for_answer(now_s)
        commanding = self.gate.answers(now_s, waiting=self.link.holds)
        data = self.gate.release(self.link.drain(commanding=commanding), now_s)
        if self.tlog is not None and data:
            self.tlog.sent(self._utc_s(now_s), data)
        return data

    def _utc_s(self, now_s: float) -> float:
        known = self.core.own.utc_offset_s
        return now_s + (self._utc_guess_s if known is None else known)

    def say_stopping(self, now_s: float) -> None:
        """Tell the pilot that the program stops, as a warning in flight. He may rely on it even while it
        commands nothing."""
        if self.commanding and self.link.vehicle is not None:
            severity = Severity.WARNING if self.core.own.armed else Severity.INFO
            text = "DMUCA: the companion stops: from now on it avoids and broadcasts nothing"
            self.link.send(Say(severity=severity, text=text), now_s)

    def let_go(self, now_s: float) -> None:
        """Ask the vehicle to hold, before the program stops.

        The core is not stepped after this, so nothing is broadcast any more.
        """
        self.link.send(SetMode(mode=FlightMode.HOLD), now_s)
        self._asks = True
        if self._remote_id_component:
            self.link.send(ArmStatus(ready=False, text="companion is stopping"), now_s)

    def idle(self, now_s: float, *, read_s: float | None = None) -> None:
        """Keep the link alive and the own state current without a step of the core.

        Args:
            read_s: as in `tick`.
        """
        for event in self._step_events(now_s, read_s):
            self.core.own.observe(event, now_s)
