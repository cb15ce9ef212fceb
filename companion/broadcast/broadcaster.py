"""Our own Remote ID broadcast: its content, its transports within the law, and whether it is really on the
air.

The module is pure: events in, commands out. The core calls `step` once a step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from companion.broadcast.legal_floor import Decided, keep_floor
from companion.broadcast.monitor import SelfMonitor
from companion.broadcast.own_messages import Operator, kinds_of, lacking, messages_of
from companion.broadcast.schedule import Schedule
from companion.broadcast.vehicle_module import VehicleModule
from companion.config import Config
from companion.events import (
    ArmStatus,
    Broadcast,
    BroadcastChanged,
    Command,
    Landed,
    OperatorData,
    RadioState,
    RemoteIdHeard,
    RemoteIdModule,
    Say,
    Severity,
)
from companion.ownship import Ownship
from companion.remote_id.messages import Message

MAX_RATE = 10
"""Largest number of Locations a second."""
_DETAIL = 100
"""Number of characters of a radio's own text that are sent to the pilot: two STATUSTEXT chunks."""
_WELL_AFTER_S = 5.0
"""Remote ID counts as working again after this long without trouble, so that the pilot and the autopilot are
told of intermittent trouble only once."""
_TELL_PERIOD_S = 5.0
"""Least time between two reports of trouble to the pilot."""
_NOTHING = Decided({}, False, "no radio has reported yet")


def asked_rates(config: Config) -> dict[str, int]:
    """Transports that the configuration asks for, with their Locations a second."""
    return dict.fromkeys(config.remote_id.transports, config.remote_id.rate)


class Broadcaster:
    """Broadcast of one aircraft. Nothing is sent before the vehicle has been heard."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._asked = asked_rates(config)
        self._radio = RadioState()
        self._can_send: frozenset[str] = frozenset()
        self._monitored: frozenset[str] = frozenset()
        self._operator = Operator()
        self._kinds = kinds_of(config.remote_id, self._operator)
        """Kinds of the messages to broadcast."""
        self._schedule = Schedule(config.region, config.identity.uas_id)
        self._monitor = SelfMonitor(config.remote_id.monitor_s)
        self._decided = _NOTHING
        self._floor: tuple[Mapping[str, int], frozenset[str], Decided] | None = None
        """Input of the last decision (requested rates, usable transports), and the decision."""
        self._started = False
        """Whether the broadcast has begun. It begins once a legal set of transports can be sent. In the air,
        after a restart, it begins with what can be sent, as if the rest had been lost in flight."""
        self._silent: frozenset[str] = frozenset()
        self._module = VehicleModule()
        self._told: tuple[object, ...] | None = None
        self._said: str | None = None
        """The trouble last reported to the pilot."""
        self._said_s = self._trouble_s = -math.inf
        self._arm_status: ArmStatus | None = None
        self._unready_s = -math.inf
        """When the vehicle was last not ready to be armed because of Remote ID."""
        self._lacking: str | None = None
        self._lacking_told: set[str] = set()
        self._lacking_s = -math.inf

    def ask(self, rates: Mapping[str, int]) -> None:
        """Set what a policy wants from now on: transports with their Locations a second, up to `MAX_RATE`.
        Transports with less than 1 are not wanted."""
        self._asked = {t: min(rate, MAX_RATE) for t, rate in rates.items() if rate >= 1}

    def observe(
        self, event: RadioState | OperatorData | RemoteIdModule | RemoteIdHeard, now_s: float
    ) -> None:
        """Take an event that concerns our own broadcast."""
        match event:
            case RadioState():
                self._radio = event
                self._can_send, self._monitored = frozenset(event.can_send), frozenset(event.monitored)
            case OperatorData():
                self._operator.hear(event.messages, now_s)
                self._kinds = kinds_of(self._config.remote_id, self._operator)
            case RemoteIdModule() if self._config.remote_id.yield_to_module:
                self._module.observe(event, now_s)
            case RemoteIdHeard():
                if event.address in self._radio.own_addresses:
                    self._monitor.heard(event.transport, now_s)

    @property
    def radio(self) -> RadioState:
        """State of the radios as last reported."""
        return self._radio

    @property
    def rates(self) -> Mapping[str, int]:
        """Transports that are to be on the air, with their Locations a second."""
        return self._decided.rates

    @property
    def gives_way(self) -> bool:
        """Whether the vehicle has a Remote ID module of its own, so that we broadcast nothing."""
        return self._module.report is not None

    @property
    def trouble(self) -> str | None:
        """Why Remote ID does not work as the law or the configuration requires, in words; None when it
        does."""
        module = self._module.report
        if module is not None:
            return None if module.ready else f"Remote ID module not ready: {module.text}"
        if not self._decided.legal:
            return f"Remote ID not legal: {self._decided.reason}"
        if not self._decided.rates and self._config.has_radio:
            return f"Remote ID not sent: {self._decided.reason}"
        if self._silent:
            return f"own Remote ID not heard on {', '.join(sorted(self._silent))}"
        return None

    @property
    def lacking(self) -> str | None:
        """Data that the region requires and that is missing, in words; None when nothing is missing."""
        return self._lacking if self._config.region.transport_sets and not self.gives_way else None

    def step(self, own: Ownship, now_s: float) -> list[Command]:
        """Commands for this step: broadcasts, changes for the log, texts for the pilot and the ArmStatus."""
        radio, can_send = self._radio, self._can_send
        for transport in radio.confirmed:
            self._monitor.heard(transport, now_s)
        commands = self._watch_module(own, now_s)
        if self._floor is None or self._floor[0] is not self._asked or self._floor[1] != can_send:
            self._floor = self._asked, can_send, keep_floor(self._asked, self._config.region, can_send)
        self._decided = self._floor[2]
        on_air = frozenset() if self.gives_way else self._schedule.on_air
        self._silent = self._monitor.silent(on_air, self._monitored, now_s)
        if own.heartbeat is None:
            return commands
        rates: Mapping[str, int] = {}
        config = self._config
        self._lacking = lacking(config, own, self._operator, now_s)
        if self.gives_way:
            self._schedule.stop()
        else:
            may_begin = self._decided.legal or own.landed(now_s) is Landed.IN_AIR
            self._started = self._started or (may_begin and bool(self._decided.rates))
            rates = self._decided.rates if self._started else {}
            due = self._schedule.due(rates, can_send, radio.wifi_channel, self._kinds, now_s)
            messages = self._messages(own, now_s) if due else ()
            commands += [
                Broadcast(transport=transport, messages=tuple(m for m in messages if type(m) in sent))
                for transport, sent in due
            ]
        trouble = self.trouble
        self._log(rates, trouble, commands)
        self._tell_pilot(trouble, commands, now_s)
        self._tell_lacking(own, commands, now_s)
        if self._config.remote_id.component:
            self._report(commands, now_s)
        return commands

    def _messages(self, own: Ownship, now_s: float) -> tuple[Message, ...]:
        failed = bool(self._silent) or not self._decided.legal
        return messages_of(self._config, own, self._operator, now_s, failed=failed)

    def _watch_module(self, own: Ownship, now_s: float) -> list[Command]:
        """Resume our broadcast when the vehicle's module falls silent, also in flight. Others avoid an
        aircraft with two identities, but not one that is not on the air."""
        self._module.note_armed(own.armed)
        if not self._module.fell_silent(now_s):
            return []
        text = "DMUCA: the vehicle's Remote ID module fell silent; broadcasting instead"
        return [Say(severity=Severity.WARNING, text=text)]

    def _log(self, rates: Mapping[str, int], trouble: str | None, commands: list[Command]) -> None:
        """Log a change of the broadcast."""
        module = self._module.report
        if module is not None:
            reason = f"the vehicle's own Remote ID module (component {module.component_id}) broadcasts"
        else:
            reason = self._decided.reason
        legal = self._decided.legal
        told = (rates, legal, reason, trouble)
        if told != self._told:
            self._told = told
            listed = tuple(sorted(rates.items()))
            commands.append(BroadcastChanged(rates=listed, legal=legal, reason=trouble or reason))

    def _tell_pilot(self, trouble: str | None, commands: list[Command], now_s: float) -> None:
        """Report trouble, and later its end, to the pilot. `_TELL_PERIOD_S` and `_WELL_AFTER_S` limit the
        number of texts."""
        if trouble is not None:
            self._trouble_s = now_s
        if trouble == self._said:
            return
        if trouble is None:
            if now_s - self._trouble_s < _WELL_AFTER_S:
                return
            commands.append(Say(severity=Severity.INFO, text="DMUCA Remote ID works again"))
        else:
            if now_s - self._said_s < _TELL_PERIOD_S:
                return
            worst = Severity.CRITICAL if not self._decided.legal else Severity.WARNING
            # The radio's own text changes every second. It is reported together with a trouble, but is no
            # trouble by itself.
            words = "" if self.gives_way else self._radio.text[:_DETAIL]
            detail = f": {words}" if words else ""
            commands.append(Say(severity=worst, text=f"DMUCA {trouble}{detail}"))
        self._said, self._said_s = trouble, now_s

    def _tell_lacking(self, own: Ownship, commands: list[Command], now_s: float) -> None:
        """In flight, report each kind of missing data to the pilot once, with at most one text per
        `_TELL_PERIOD_S`."""
        lacking = self.lacking
        if not own.armed:
            self._lacking_told.clear()
            return
        if lacking is None or lacking in self._lacking_told or now_s - self._lacking_s < _TELL_PERIOD_S:
            return
        self._lacking_told.add(lacking)
        self._lacking_s = now_s
        commands.append(Say(severity=Severity.WARNING, text=f"DMUCA Remote ID: {lacking}"))

    def _report(self, commands: list[Command], now_s: float) -> None:
        """Report OPEN_DRONE_ID_ARM_STATUS, if we are the vehicle's Remote ID component. What is missing is
        reported at once, and its end after `_WELL_AFTER_S`: a radio that only seems to work now and then must
        not let the vehicle be armed."""
        text = self.trouble or self._lacking
        if text is not None:
            self._unready_s = now_s
        elif now_s - self._unready_s < _WELL_AFTER_S:
            return
        status = ArmStatus(ready=text is None, text=text or "")
        if status != self._arm_status:
            self._arm_status = status
            commands.append(status)
