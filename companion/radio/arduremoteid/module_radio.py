"""A module with ArduRemoteID firmware as a radio. We feed it over MAVLink, and it sends by itself.

The module has one set of data for all its transports. It repeats the last data for as long as it has power,
and cannot be switched in flight. Transports are therefore prepared before arming and stay as they are. A rate
is never set to 0 (the last payload would stay on the air for ever), and only rates are ever set.

We feed Basic ID, Location, System, Self ID and Operator ID. The module reports good to arm only if all of
them are fresh (Location and System 3 s, the others 22 s). Without a Self ID or Operator ID from the caller,
empty ones are fed; they count as fresh and are not broadcast. Location and System go on the air only if their
timestamp is not 0. A Location of the full hour is therefore dated 3600.0, the end of the previous hour.
Authentication is not fed, because the firmware never broadcasts it. The firmware cuts identities at the first
zero byte, and stores them so. Nothing is fed with an identity that holds one, as every DRIP entity tag does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import msgspec

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.arduremoteid.module_messages import ARM_STATUS_WORDS, PARAMETERS, SILENT_AFTER_S, Module
from companion.radio.arduremoteid.section import ZERO_BYTE, ArduRemoteIdRadio
from companion.radio.radio import ByteLink, Health, RadioContext
from companion.remote_id.mavlink import COMPONENT_ID, encode_odid
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    Location,
    Message,
    OperatorId,
    SelfId,
    Status,
    System,
)
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

RATES: Final = {BLE4: "BT4_RATE", BLE5: "BT5_RATE", WIFI_BEACON: "WIFI_BCN_RATE", WIFI_NAN: "WIFI_NAN_RATE"}
MAX_RATE: Final = 5
"""Highest rate (per second) in the firmware's own parameter table."""
_BLUETOOTH: Final = (RATES[BLE4], RATES[BLE5])
OPEN_WAIT_S: Final = 8.0
"""A module that boots when its port is opened needs some seconds."""
_POLL_S: Final = 0.05
_SET_WAIT_S: Final = 1.0
_SET_TIMES: Final = 2
_REPEAT_S: Final = 0.08
"""A message that is meant for several transports is fed only once within this time."""
_FEED_PERIOD_S: Final = 5.0
_FEED_FIRST_S: Final = 2.0
"""Time after the first broadcast until an empty Self ID or Operator ID is fed. The caller may provide one
before."""
_SETTLE_S: Final = 4.0
"""The module's refusal is ignored for this long after the first broadcast."""
_FORCE_ARM_OK: Final = 1
_DONT_SAVE_BASIC_ID: Final = 2
_EMPTY: Final[dict[type[Message], Message]] = {
    SelfId: SelfId(description_type=0, text=""),
    OperatorId: OperatorId(operator_id_type=0, operator_id=""),
}


class _Feed(NamedTuple):
    """One message to feed to the module."""

    key: object
    """Message type, with the ID type for a Basic ID. One message is kept for each key."""
    message: Message
    payload: tuple[int, bytes]


class ArduRemoteIdTransport:
    """A `Radio` that uses such a module.

    Args:
        link: The module's own link. It is closed with this object, and also if opening fails.
        system_id: System ID of the vehicle.
        clock: Monotonic clock (s). Read only while opening and in `configure`.
        name: Name of the link, for error texts.

    Raises:
        ConfigError: no module answers.
    """

    def __init__(self, link: ByteLink, system_id: int, clock: Callable[[], float], name: str) -> None:
        self._link = link
        self._name = name
        self._clock = clock
        self._module = Module(link, system_id)
        self._target = (system_id, COMPONENT_ID)
        self._configured = False
        self._wanted: frozenset[str] = frozenset()
        self._raised: dict[str, float] = {}
        """Previous values of the Bluetooth rates that changed since the module started."""
        self._restarts = 0
        self._first_s: float | None = None
        self._fed: dict[object, tuple[float, Message]] = {}
        self._undated = False
        self._unfit = False
        """Whether the identity of the last broadcast holds a zero byte."""
        self._sent = 0
        try:
            self._open()
        except ConfigError:
            self._module.close()
            raise
        self._restarts = self._module.restarts

    # ------------------------------------------------------------ capabilities

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that are on. Until configured, also those that an unlocked module can switch on."""
        if self._configured or self._locked:
            return self._on | self._wanted
        return frozenset(t for t, name in RATES.items() if name in self._module.params)

    @property
    def hears(self) -> frozenset[str]:
        """Nothing: the module only sends."""
        return frozenset()

    @property
    def own_addresses(self) -> frozenset[str]:
        """Unknown: the module chooses new addresses at each start and does not report them."""
        return frozenset()

    @property
    def wifi_channel(self) -> int | None:
        """Value of WIFI_CHANNEL."""
        channel = self._module.params.get("WIFI_CHANNEL")
        return int(channel) if channel and self.capabilities & {WIFI_BEACON, WIFI_NAN} else None

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Switch on the wanted transports that are off, and raise rates that are too low.

        No other rate is set, because each set wears the module's flash. A Bluetooth transport that is
        switched on here comes on the air when the module is power-cycled. `health` reports this, and later
        that the transport is on.

        Raises:
            ConfigError: a transport or rate that the module does not support, a locked module, or a value
                that it does not accept.
        """
        for transport, rate in rates.items():
            self._check_rate(transport, rate)
        params = self._module.params
        low = {RATES[t]: rate for t, rate in rates.items() if params[RATES[t]] < rate}
        if low and self._first_s is not None:
            raise ConfigError(
                f"{self._name}: {_values(low)}: a rate cannot be changed once the module is sending"
            )
        if low and self._locked:
            are = _values({name: params[name] for name in low})
            raise ConfigError(
                f"{self._name}: the module is locked (LOCK_LEVEL {params.get('LOCK_LEVEL', 1.0):g}) "
                f"with {are}, wanted {_values(low)}: choose a transport and rate that it has "
                f"({self._named(self._on) or 'none'}), "
                "or let the holder of the module's key set it (a signed command)"
            )
        words = tuple(self._outcome(RATES[t], rate, probe=probe) for t, rate in sorted(rates.items()))
        if not probe:
            for name, rate in low.items():
                before = params[name]
                self._set(name, float(rate))
                if name in _BLUETOOTH:
                    self._raised.setdefault(name, before)
            self._configured = True
            self._wanted = frozenset(rates)
        return words

    # ------------------------------------------------------------ in flight

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Feed these messages. Raises ValueError for a transport outside `capabilities`, or bad messages."""
        if transport not in self.capabilities:
            raise ValueError(
                f"transport is {transport!r}; allowed: {', '.join(sorted(self.capabilities)) or 'none'}"
            )
        given = [_Feed(_key(m), m, self._encoded(m)) for m in messages if not isinstance(m, Authentication)]
        self._exchange(now_s)
        self._unfit = any(isinstance(m, BasicId) and "\0" in m.uas_id for m in messages)
        if self._unfit:
            return
        if self._first_s is None:
            self._first_s = now_s
        fresh = [feed for feed in given if self._is_new(feed, now_s)]
        fresh += self._due_feed({feed.key for feed in given}, now_s)
        for feed in fresh:
            self._fed[feed.key] = (now_s, feed.message)
            if isinstance(feed.message, System):
                self._undated = feed.message.timestamp_utc_s is None
        if fresh:
            self._module.send([feed.payload for feed in fresh])
            self._sent += len(fresh)

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Return nothing, but keep the exchange with the module going."""
        self._exchange(now_s)
        return []

    def health(self, now_s: float) -> Health:
        """Return the state that the module reports.

        With FORCE_ARM_OK in OPTIONS its ARM_STATUS proves nothing, so `confirmed` is None.
        """
        alive = self._module.alive(now_s)
        waiting = self._waiting
        can_send = self._on - waiting if alive and not self._unfit else frozenset()
        wrong = self._wrong(now_s)
        ready = self._good(now_s)
        parts = wrong or ["module sends" if ready else "module answers but has not confirmed anything yet"]
        if extra := self._on - self._wanted if self._configured else frozenset():
            parts.append(f"also on the air, and cannot be switched off here: {self._named(extra)}")
        if self._module.said:
            parts.append(f'module said: "{self._module.said}"')
        confirmed: frozenset[str] | None = can_send if ready and self._first_s is not None else frozenset()
        if self._option(_FORCE_ARM_OK):
            confirmed = None
        return Health(
            ok=not wrong,
            text=f"ArduRemoteID: {'; '.join(parts)}",
            frames_sent=self._sent,
            frames_heard=0,
            bad_frames=self._module.corrupt,
            can_send=can_send,
            confirmed=confirmed,
            missing=self._missing(),
        )

    def close(self) -> None:
        """Release the link.

        The module keeps sending. We leave it with a Location that has no position and reports a system
        failure.
        """
        if self._first_s is not None:
            self._module.send([self._encoded(Location(status=Status.REMOTE_ID_SYSTEM_FAILURE))])
        self._module.close()

    # ------------------------------------------------------------ opening

    def _open(self) -> None:
        module = self._module
        if not self._wait_for(lambda: module.heard_s is not None, OPEN_WAIT_S):
            raise ConfigError(
                f"{self._name}: no ArduRemoteID module within {OPEN_WAIT_S:g} s: {self._why_silent()}"
            )
        module.ask(*PARAMETERS)
        self._wait_for(lambda: not module.asking, OPEN_WAIT_S)
        if not any(name in module.params for name in RATES.values()):
            raise ConfigError(
                f"{self._name}: the module sends heartbeats but does not report its rates (BT4_RATE, "
                "...); check that it is ArduRemoteID, and the wire to its receive pin"
            )

    def _why_silent(self) -> str:
        module = self._module
        if b"Waiting for heartbeat" in module.raw:
            return "it reports that it waits for a heartbeat; check the wire from here to its receive pin"
        if module.others:
            heard = ", ".join(map(str, sorted(module.others)))
            return f"MAVLink comes from components {heard}, not from {COMPONENT_ID}; is this the module?"
        if module.raw:
            return "the data is not MAVLink; check the baud rate (the module's is BAUDRATE, usually 57600)"
        return "no data at all; check power, wiring and the link's name"

    def _wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end_s = self._clock() + timeout_s
        while True:
            self._module.exchange(self._clock())
            if condition():
                return True
            if self._clock() >= end_s:
                return False
            self._link.wait(_POLL_S)

    # ------------------------------------------------------------ configuring

    def _check_rate(self, transport: str, rate: int) -> None:
        name = RATES.get(transport)
        if name is None or name not in self._module.params:
            able = ", ".join(sorted(t for t, n in RATES.items() if n in self._module.params))
            raise ConfigError(f"{self._name}: the module cannot send on {transport!r}; allowed: {able}")
        if not 1 <= rate <= MAX_RATE:
            raise ConfigError(
                f"{self._name}: {transport}: {rate} messages a second; allowed: 1 to {MAX_RATE}"
            )

    def _outcome(self, name: str, rate: int, *, probe: bool) -> str:
        """Describe what happens to the rate of one transport."""
        before = self._module.params[name]
        if before >= rate:
            return f"{name} stays at {before:g}"
        text = (
            f"would set {name} to {rate} (it is {before:g})"
            if probe
            else f"set {name} to {rate} (was {before:g})"
        )
        if name in _BLUETOOTH and before == 0.0:
            text += "; it starts when the module is power-cycled"
        return text

    def _set(self, name: str, rate: float) -> None:
        params = self._module.params
        for _ in range(_SET_TIMES):
            self._module.set(name, rate)
            if self._wait_for(lambda: params[name] == rate, _SET_WAIT_S):
                return
            # The answer may have been lost. Read the value before writing the flash again.
            self._module.ask(name)
            if self._wait_for(lambda: params[name] == rate, _SET_WAIT_S):
                return
        said = f'; it reports "{self._module.said}"' if self._module.said else ""
        raise ConfigError(f"{self._name}: the module keeps {name} at {params[name]:g}, wanted {rate:g}{said}")

    # ------------------------------------------------------------ feeding

    def _exchange(self, now_s: float) -> None:
        self._module.exchange(now_s)
        if self._module.restarts != self._restarts:
            # The module has lost all fed data. Its Bluetooth has started with the current rates.
            self._restarts = self._module.restarts
            self._raised.clear()
            self._fed = {key: (-math.inf, m) for key, (_, m) in self._fed.items() if key in _EMPTY}

    def _encoded(self, message: Message) -> tuple[int, bytes]:
        if isinstance(message, Location) and message.timestamp_s == 0.0:
            message = msgspec.structs.replace(message, timestamp_s=3600.0)
        return encode_odid(message, *self._target)

    def _is_new(self, feed: _Feed, now_s: float) -> bool:
        before = self._fed.get(feed.key)
        return before is None or before[1] != feed.message or now_s - before[0] >= _REPEAT_S

    def _due_feed(self, given: set[object], now_s: float) -> list[_Feed]:
        """Return the Self ID and Operator ID that the module needs now: the last given, or empty ones."""
        assert self._first_s is not None
        due = []
        for kind, empty in _EMPTY.items():
            at_s, message = self._fed.get(kind, (self._first_s + _FEED_FIRST_S - _FEED_PERIOD_S, empty))
            if kind not in given and now_s - at_s >= _FEED_PERIOD_S:
                due.append(_Feed(kind, message, self._encoded(message)))
        return due

    # ------------------------------------------------------------ judging

    @property
    def _on(self) -> frozenset[str]:
        return frozenset(t for t, name in RATES.items() if self._module.params.get(name, 0.0) > 0.0)

    @property
    def _locked(self) -> bool:
        # Without this parameter the lock state is unknown, so nothing is written.
        return self._module.params.get("LOCK_LEVEL", 1.0) > 0.0

    @property
    def _waiting(self) -> frozenset[str]:
        """Transports that were off and come on the air only when the module restarts."""
        return frozenset(t for t, name in RATES.items() if self._raised.get(name) == 0.0)

    def _option(self, bit: int) -> bool:
        return bool(int(self._module.params.get("OPTIONS", 0.0)) & bit)

    def _good(self, now_s: float) -> bool:
        arm = self._module.arm
        return self._module.alive(now_s) and arm is not None and arm[1] and now_s - arm[0] <= SILENT_AFTER_S

    def _wrong(self, now_s: float) -> list[str]:
        """Describe the faults that keep the module from sending as required."""
        module = self._module
        if not module.alive(now_s):
            return [f"module silent for {now_s - (module.heard_s or 0.0):.0f} s"]
        wrong = []
        if self._unfit:
            wrong.append(ZERO_BYTE)
        if waiting := self._waiting:
            wrong.append(f"power-cycle the module: {self._named(waiting)} was switched on and starts with it")
        if lost := self._wanted - self._on:
            what = (
                "the module is locked, so it cannot be switched on again"
                if self._locked
                else "restart the companion, on the ground, to switch it on again"
            )
            wrong.append(f"no longer on the air: {self._named(lost)}; {what}")
        if self._first_s is None or now_s - self._first_s < _SETTLE_S:
            return wrong
        if not self._good(now_s):
            wrong.append(self._refusal(now_s))
        if self._undated:
            wrong.append("the module does not send System messages while the time is unknown")
        return wrong

    def _refusal(self, now_s: float) -> str:
        arm = self._module.arm
        if arm is None or now_s - arm[0] > SILENT_AFTER_S:
            return "module sends no ARM_STATUS"
        words = [ARM_STATUS_WORDS[token] for token in arm[2].split() if token in ARM_STATUS_WORDS]
        return f"module refuses: {arm[2]}" + (f" ({', '.join(dict.fromkeys(words))})" if words else "")

    def _named(self, transports: frozenset[str]) -> str:
        params = self._module.params
        return ", ".join(f"{t} ({RATES[t]} {params.get(RATES[t], 0.0):g})" for t in sorted(transports))

    def _missing(self) -> tuple[str, ...]:
        params = self._module.params
        notes = ["Authentication is not sent: the module's firmware never broadcasts it"]
        off = sorted(RATES[t] for t in RATES.keys() - self._on)
        if off and self._locked:
            notes.append(f"the module is locked (LOCK_LEVEL): {', '.join(off)} cannot be switched on")
        if params.get("UAS_TYPE", 0.0) > 0.0 and params.get("UAS_ID_TYPE", 0.0) > 0.0:
            notes.append(
                "the module holds a Basic ID of its own and sends it first; MAVLink cannot read it: check "
                "with a receiver that it is this aircraft's"
            )
        elif not self._option(_DONT_SAVE_BASIC_ID):
            notes.append("the module held no Basic ID; it stores the first one that it receives permanently")
        if self._option(_DONT_SAVE_BASIC_ID):
            notes.append(
                "OPTIONS 2 is set: the module sends the Basic ID that it is given, and does not store it"
            )
        if self._option(_FORCE_ARM_OK):
            notes.append(
                "OPTIONS 1 is set: the module always reports that it is good to arm, so that proves nothing"
            )
        for name, before in self._raised.items():
            if before > 0.0:
                notes.append(f"{name} was {before:g}; the new rate takes effect when the module restarts")
        return tuple(notes)


def _key(message: Message) -> object:
    return (BasicId, message.id_type) if isinstance(message, BasicId) else type(message)


def _values(rates: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {rate:g}" for name, rate in sorted(rates.items()))


def open_radio(section: ArduRemoteIdRadio, context: RadioContext) -> ArduRemoteIdTransport:
    """Open the link to the module that a configuration names.

    Raises:
        ConfigError: the link cannot be opened, or the module does not answer.
    """
    link = context.open_link(section.link)
    return ArduRemoteIdTransport(link, section.system_id, context.now_s, section.link)
