"""The flight loop of `companion run`: one thread, a fixed rate, sockets in and out, and a watchdog.

The loop does nothing late: it skips and counts a missed deadline, and the core (`companion.core`), which
sees the gap, commands nothing until its data is fit again. Troubles outside the flight itself do not end the
flight, but are reported. A lost link is reopened; without a working disk or terminal the flight continues.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType

from companion.autopilot.dialect import impossible_rearm
from companion.autopilot.tlog import TlogWriter
from companion.avoidance.path import check_path
from companion.config import Config
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import (
    AuthorityChanged,
    Broadcast,
    FlightMode,
    RemoteIdHeard,
    Say,
    Settings,
    Severity,
)
from companion.gate.gate import STALL_S
from companion.runtime import clock
from companion.runtime.drip_key import open_signer
from companion.runtime.lateness import Lateness, scheduling
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.links.no_vehicle import no_vehicle
from companion.runtime.plugins import judge_plugins
from companion.runtime.policy import read_policy
from companion.runtime.prepare import opened, prepare
from companion.runtime.record.run_record import RunRecord
from companion.runtime.refusals import Refusals
from companion.runtime.signing_key import KeptSigning
from companion.runtime.status.console import Voice
from companion.runtime.status.flight_report import FlightReport, LoopCounts
from companion.runtime.status.service_manager import Notifier
from companion.runtime.status.status_socket import Status, StatusServer
from companion.runtime.status.troubles import Trouble, Troubles
from companion.runtime.stored_parameters import KeptSettings, usable_settings
from companion.runtime.waited_frames import WaitedFrames
from companion.runtime.warm import warm_up
from companion.runtime.watchdog import Watchdog
from companion.system import CompanionSystem

_STATUS_S = 5.0
_READ_S = 0.5
"""Longest time for which the autopilot's input is read in one go. Reading what the kernel buffered during a
stall takes less. The bound keeps an endless flood of input from blocking the loop."""
_LOOK_S = 0.1
"""The input is read at least this often, even if nothing arrives, so that a longer gap shows a stall."""
_LET_GO_S = 2.0
_ARMED_S = 3.0
"""Time in which an armed vehicle must be heard if a radio cannot be used. Heartbeats come once a second."""
_COLLECT_S = 1.0
"""Period of the garbage collection, which runs right after a tick."""
_LINES_KEPT = 8
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end the flight in an orderly way. SIGHUP is sent by a terminal that closes."""


class Flight:
    """Everything that one `companion run` holds. `run` blocks until the flight is stopped."""

    def __init__(self, config: Config, say: Callable[[str], None], *, dry_run: bool) -> None:
        self.config = config
        self._stop = False
        self._late = 0
        self._ticks = 0
        self._stalls = 0
        self._read_s: float | None = None
        """Start time of the last read that emptied the autopilot's input; None if it was not emptied."""
        self._waited = WaitedFrames()
        self._refused = Refusals()
        self._lateness = Lateness()
        began_s = clock.now_s()
        self._lines: deque[str] = deque(maxlen=_LINES_KEPT)
        self._server: StatusServer | None = None
        check_path(config, "configuration")
        self._voice = Voice(say)
        self._troubles = Troubles(self._say)
        self._watchdog = Watchdog()
        self._notifier = Notifier(os.environ)
        self._say(f"avoidance kernels: ready after {warm_up():.1f} s")
        self._say(f"scheduling: {scheduling()}")
        if dry_run:
            self._say(
                "dry run: nothing is broadcast and nothing is commanded; the autopilot is only asked for "
                "telemetry, its mission and its fence"
            )
        for line in judge_plugins(config):
            self._say(line)
        self._open(config, dry_run=dry_run)
        self._policy = self._read_policy(config)
        unread = partial(self._troubles.note, Trouble.SETTINGS_UNREAD)
        settings = usable_settings(config, self._say, unread)
        self._kept_settings = KeptSettings(config, settings)
        self._run = RunRecord(self._say)
        self.onboard = self._system(config, settings, dry_run=dry_run)
        self._status_s = clock.now_s()
        try:
            self._server = StatusServer(f"companion-{config.identity.file_name}", os.environ)
        except ConfigError as error:
            self._say(f"status: {error}; the flight continues without it")
        self._report = FlightReport(
            config=config,
            dry_run=dry_run,
            began_s=began_s,
            onboard=self.onboard,
            link=self.link,
            radio=self.radio,
            signing=self._signing.signing,
            record=self._run,
            voice=self._voice,
            troubles=self._troubles,
            refused=self._refused,
            lateness=self._lateness,
            lines=self._lines,
        )
        # Objects made at start-up, above all the compiler's, live as long as the process. Freezing them keeps
        # later collections short.
        gc.collect()
        gc.freeze()

    def _open(self, config: Config, *, dry_run: bool) -> None:
        """Open the link and the radios. What is open is closed again if a later step fails."""
        with contextlib.ExitStack() as undo:
            undo.callback(self._voice.close)
            self._signing = KeptSigning(config)
            self._signer = open_signer(config)
            self.link = KeptLink(config.vehicle.link, self._say)
            undo.callback(self.link.close)
            self.radio, self._radio_trouble = opened(config, self._say, sending=not dry_run)
            undo.callback(self.radio.close)
            undo.pop_all()

    def _system(self, config: Config, settings: Settings, *, dry_run: bool) -> CompanionSystem:
        """Make the core with link and gate."""
        system = CompanionSystem(
            config,
            self._record,
            policy=self._policy,
            commanding=not dry_run,
            tlog=TlogWriter(self._run.tape),
            utc_guess_s=time.time() - clock.now_s(),
            signing=self._signing.signing,
            settings=settings,
            signer=self._signer,
        )
        chooser = system.core.chooser
        if chooser is not None and chooser.trouble is not None:
            self._say(f"atmc: {chooser.trouble}: a fixed legal set of transports is used instead")
        return system

    def _say(self, line: str) -> None:
        self._voice.say(line)
        self._lines.append(line)

    @property
    def folder(self) -> Path | None:
        """Run folder; None before it is made."""
        return self._run.folder

    def stop(self, _signal: int = 0, _frame: FrameType | None = None) -> None:
        """Ask `run` to end. Also serves as a signal handler."""
        self._stop = True

    def run(self) -> None:
        """Find the vehicle, then fly until stopped.

        Raises:
            ConfigError: no vehicle was found within `vehicle.wait_s`, or the vehicle found cannot be flown.
        """
        for number in _SIGNALS:
            # Under nohup SIGHUP is ignored: the flight continues when the terminal closes.
            if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self.stop)
        try:
            if self._radio_trouble is not None:
                self._go_on_without_radio(self._radio_trouble)
            self._find_vehicle()
            if self._stop:
                return
            self._say(f"vehicle {self.onboard.link.vehicle}")
            dry_run = self._report.dry_run
            self._run.open(self.config, self._policy, str(self.onboard.link.vehicle), dry_run=dry_run)
            try:
                self._loop()
            except BaseException:
                # A bug of ours, or whatever a plug-in raises: the vehicle must not fly its last setpoint on.
                with contextlib.suppress(Exception):
                    self._let_go()
                raise
            self._let_go()
        finally:
            self._watchdog.stop()
            self._close()

    def _read_policy(self, config: Config) -> bytes | None:
        """Read the policy file. Without it the aircraft still flies, with a fixed legal set of transports."""
        try:
            return read_policy(config)
        except ConfigError as error:
            self._say(str(error))
            return None

    # ------------------------------------------------------------ phases

    def _go_on_without_radio(self, trouble: str) -> None:
        """Go on with the radios that work if the vehicle is armed.

        After a restart in the air, fewer radios are better than no companion. Before the flight a radio that
        cannot be used is an error.

        Raises:
            ConfigError: no heartbeat of an armed vehicle arrived within `_ARMED_S`.
        """
        until_s = clock.now_s() + _ARMED_S
        own = self.onboard.core.own
        while not own.armed and (now := clock.now_s()) < until_s and not self._stop:
            self._wait(now + 1.0 / self.config.flight.setpoint_rate_hz)
            self._tick()
        if not own.armed:
            raise ConfigError(trouble)
        self._troubles.note(Trouble.RADIO_MISSING, f"{trouble}; the vehicle is armed")
        try:
            for line in prepare(self.config, self.radio, armed=True).lines:
                self._say(line)
        except ConfigError as error:
            self._say(str(error))

    def _find_vehicle(self) -> None:
        wait_s = self.config.vehicle.wait_s
        self._say(f"waiting for a vehicle on {self.config.vehicle.link} ...")
        give_up = clock.now_s() + wait_s
        while self.onboard.link.vehicle is None and not self._stop:
            now = clock.now_s()
            if now > give_up:
                _, why, do = no_vehicle(self.config.vehicle, self.link, self.onboard.link, now)
                raise ConfigError(f"{why}: {do}")
            self._wait(now + 1.0 / self.config.flight.setpoint_rate_hz)
            self._tick()
        vehicle = self.onboard.link.vehicle
        if vehicle is not None and vehicle.refusal is not None and self.config.flight.use != "watch":
            raise ConfigError(f"{self.config.vehicle.link}: {vehicle.refusal}")
        rearm = None if vehicle is None else impossible_rearm(vehicle.firmware, self.config.flight)
        if rearm is not None:
            self._say(rearm)

    def _wait(self, deadline_s: float) -> None:
        """Receive the autopilot's bytes until the deadline."""
        while (left := deadline_s - clock.now_s()) > 0:
            self.link.wait(min(left, _LOOK_S))
            if self._take_in():
                # Answer a TIMESYNC at once: an answer that waited for the next tick would report a wrong
                # time. A setpoint may also be waiting for an answer of the vehicle in this input.
                self._send()

    def _take_in(self) -> bool:
        """Read the autopilot's input until it is empty, for `_READ_S` at most. Returns whether any came."""
        end_s, anything = clock.now_s() + _READ_S, False
        while True:
            now_s = clock.now_s()
            if self._read_s is not None and now_s - self._read_s > STALL_S:
                self._note_stall(now_s - self._read_s)
            received = self.link.receive(now_s)
            emptied = received.emptied and self.link.up
            self.onboard.receive(received.data, now_s, emptied=emptied)
            anything = anything or bool(received.data)
            if emptied:
                self._read_s = now_s
                return anything
            if not self.link.up or now_s > end_s:
                self._read_s = None
                return anything

    def _note_stall(self, lasted_s: float) -> None:
        """Handle a stall of this process or its computer: discard what was queued before and has not left."""
        self._read_s = None
        self.link.discard()
        self._stalls += 1
        self._say(f"the program was stopped for {lasted_s:.1f} s; the data waiting to be sent was discarded")

    def _send(self) -> None:
        now_s = clock.now_s()
        data = self.onboard.drain(now_s)
        took_s = clock.now_s() - now_s
        if took_s > STALL_S:
            # The gate checked these bytes before the stall. They are old now, so they must not leave.
            self._note_stall(took_s)
            return
        self.link.send(data)

    def _loop(self) -> None:
        period = 1.0 / self.config.flight.setpoint_rate_hz
        deadline = clock.now_s() + period
        self._watchdog.start()
        self._notifier.ready()
        self._notifier.status(self._report.line(clock.now_s(), self._late))
        # Automatic garbage collection may run just before a setpoint is due; one right after a tick has time.
        gc.disable()
        collected_s = deadline
        while not self._stop:
            self._watchdog.report()
            self._wait(deadline)
            now = clock.now_s()
            missed = int((now - deadline) / period)
            self._lateness.add(now - deadline)
            self._late += missed
            deadline += (missed + 1) * period
            now = self._tick()
            self._notifier.ping(now)
            if now - collected_s >= _COLLECT_S:
                collected_s = now
                gc.collect()

    def _tick(self) -> float:
        """Run one step of the whole loop. Returns its time in seconds of `clock.now_s`."""
        self._ticks += 1
        self._take_in()
        now_s = clock.now_s()
        read_s = -math.inf if self._read_s is None else self._read_s
        discards = self._waited.discards(now_s)
        for event in self.radio.events(now_s):
            if not (discards and isinstance(event, RemoteIdHeard)):
                self.onboard.hear(event)
        broadcasts = self.onboard.tick(now_s, read_s=read_s)
        self._kept_settings.keep(self.onboard.settings)
        self._send()
        for broadcast in broadcasts:
            self._broadcast(broadcast, now_s)
        self._serve_status(now_s)
        if now_s - self._status_s > _STATUS_S:
            self._status_s = now_s
            line = self._report.line(now_s, self._late)
            self._voice.say(line)
            self._notifier.status(line)
        return now_s

    def _serve_status(self, now_s: float) -> None:
        if self._server is None:
            return
        try:
            self._server.serve(lambda: self.live(now_s))
        except Exception as error:
            # This is a bug, but only in the live status. Unlike one in the core it must not end the flight.
            self._server.close()
            self._server = None
            self._say(f"status: no longer served: {type(error).__name__}: {error}")

    def _broadcast(self, broadcast: Broadcast, now_s: float) -> None:
        try:
            self.radio.broadcast(broadcast.transport, broadcast.messages, now_s)
        except ValueError as error:
            # Values that Remote ID cannot encode must not end the flight; the next broadcast may be valid.
            if self._refused.add(str(error)):
                self._say(f"a Remote ID broadcast was not sent: {error}")

    def _let_go(self) -> None:
        """Tell the pilot. Ask a vehicle that is in our mode, or still enters it, to hold."""
        self._watchdog.stop()  # Nothing is reported to it from here on, and the wait has a limit of its own.
        self._notifier.stopping()
        onboard, asked = self.onboard, self.onboard.link.asked_mode
        onboard.say_stopping(clock.now_s())
        self._send()
        if not onboard.core.in_control or not onboard.commanding:
            self._wait(clock.now_s() + _LOOK_S)  # Closing TCP may discard what the far end has not read.
            if asked is FlightMode.EXTERNAL:
                onboard.link.cancel_mode()
            if asked is None or not self._enters(asked) or asked is not FlightMode.EXTERNAL:
                return
        self._say("stopping: asking the vehicle to hold")
        onboard.let_go(clock.now_s())
        self._enters(FlightMode.HOLD)

    def _enters(self, mode: FlightMode) -> bool:
        """Keep the link alive until the vehicle reports a mode. Returns False if it does not in time."""
        end = clock.now_s() + _LET_GO_S
        while (now := clock.now_s()) < end and self.onboard.core.own.mode is not mode:
            self._wait(now + 0.05)
            self.onboard.idle(clock.now_s(), read_s=-math.inf if self._read_s is None else self._read_s)
            self._send()
        return self.onboard.core.own.mode is mode

    def _close(self) -> None:
        gc.enable()
        gc.unfreeze()
        if self._server is not None:
            self._server.close()
        health = self.radio.health(clock.now_s())
        self.radio.close()
        self.link.close()
        self._kept_settings.keep(self.onboard.settings)
        self._kept_settings.close()
        self._signing.close()
        self._run.close(lambda: self._report.summary(health, self._counts()))
        self._voice.close()
        self._notifier.close()

    # ------------------------------------------------------------ status, record and troubles

    def live(self, now_s: float) -> Status:
        """Live state, as `companion status` shows it."""
        return self._report.live(now_s, self._counts())

    def _counts(self) -> LoopCounts:
        return LoopCounts(self._ticks, self._late, self._stalls)

    def _record(self, step: Step) -> None:
        for command in step.commands:
            if isinstance(command, AuthorityChanged):
                self._say(f"{command.previous} -> {command.state}: {command.reason}")
            elif isinstance(command, Say) and command.severity <= Severity.ERROR:
                self._say(command.text)
        self._report.take(step)
        self._run.step(step)
        self._look_after(step.now_s)

    def _look_after(self, now_s: float) -> None:
        """Report troubles that do not end the flight. In a dry run the pilot receives no reports."""
        troubles = self._troubles
        kept = {
            Trouble.SIGNING_UNREAD: ("last signing time not known", self._signing.unread),
            Trouble.SIGNING_CLOCK: ("signing", self._signing.wrong_clock),
            Trouble.NOT_RECORDED: ("not recording", self._run.error),
            Trouble.SLOW_DISK: ("recording", None if self._run.error else self._run.slow(now_s)),
            Trouble.SETTINGS_NOT_KEPT: ("settings not saved", self._kept_settings.error),
            Trouble.SIGNING_NOT_KEPT: ("signing time not saved", self._signing.error),
        }
        for kind, (what, why) in kept.items():
            troubles.note(kind, None if why is None else f"{what}: {why}")
        if self.onboard.commanding and self.onboard.link.vehicle is not None:
            for said in troubles.pop_messages():
                self.onboard.link.send(said, now_s)
