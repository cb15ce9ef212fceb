"""Reports of a flight: its status line, its live status, and the summary at its end."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field

from companion import __version__
from companion.adjustable_parameters import SWITCHED_OFF
from companion.authority.table import HOLDING
from companion.autopilot.signing import Signing
from companion.config import Config
from companion.event_record import Step
from companion.events import Decision
from companion.radio.radio import Health
from companion.runtime.lateness import Lateness
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.radios import Radios
from companion.runtime.record.run_record import RunRecord
from companion.runtime.refusals import Refusals
from companion.runtime.status.console import Voice
from companion.runtime.status.live_state import core_status
from companion.runtime.status.sent_rates import SentRates, in_words
from companion.runtime.status.status_socket import Status
from companion.runtime.status.troubles import Troubles
from companion.system import CompanionSystem

_DECIDED_S = 2.0
"""How long the law's last decision is shown in the live status."""


@dataclass(frozen=True)
class LoopCounts:
    """How the flight loop has kept its time."""

    ticks: int
    late_ticks: int
    """Number of deadlines that were missed."""
    stalls: int
    """Number of times that the process or its computer stood still."""


@dataclass
class FlightReport:
    """Reads the parts of one flight; changes none of them."""

    config: Config
    dry_run: bool
    began_s: float
    onboard: CompanionSystem
    link: KeptLink
    radio: Radios
    signing: Signing | None
    record: RunRecord
    voice: Voice
    troubles: Troubles
    refused: Refusals
    lateness: Lateness
    lines: Sequence[str]
    """Latest console lines, the newest at the end."""
    decision: Decision | None = None
    """The law's latest decision."""
    decided_s: float = 0.0
    sent: SentRates = field(default_factory=SentRates)

    def take(self, step: Step) -> None:
        """Take in one step of the core."""
        for command in step.commands:
            if isinstance(command, Decision):
                self.decision, self.decided_s = command, step.now_s
        self.sent.take(step.commands, self.onboard.core.broadcaster.rates, step.now_s)

    def line(self, now_s: float, late_ticks: int) -> str:
        """Status line: state of authority, what is heard, what is wrong."""
        core, health = self.onboard.core, self.radio.health(now_s)
        mode = core.own.mode.value if core.own.mode is not None else "unknown"
        arming = ", armed" if core.own.armed else ", disarmed"
        if core.own.heartbeat is None:
            arming = ""
        unfit = core.own.unfit(now_s, self.config.vehicle.stale_after_s)
        idle = core.idle_because(now_s)
        doing = core.state.value if idle is None else f"{core.state.value}: {idle}"
        return (
            f"{doing}; vehicle mode {mode}{arming}; "
            f"{unfit or 'own state valid'}; {len(core.traffic.tracks)} tracks; radio: {health.text}; "
            f"{self._on_air(now_s)}frames sent {health.frames_sent}, heard {health.frames_heard}; "
            f"late ticks {late_ticks}{self._wrong(now_s)}"
        )

    def _on_air(self, now_s: float) -> str:
        """Part of the status line: what is broadcast how often."""
        words = in_words(self._rates(), self.sent.per_s(now_s))
        return f"on the air: {words}; " if words else ""

    def _rates(self) -> dict[str, int]:
        return {} if self.dry_run else dict(self.onboard.core.broadcaster.rates)

    def _wrong(self, now_s: float) -> str:
        """Part of the status line: what is wrong outside the core and the radios."""
        text = "" if self.link.up else "; link down"
        disbelief = self.onboard.link.disbelief(now_s)
        text += "" if disbelief is None else f"; {disbelief}"
        broadcaster = self.onboard.core.broadcaster
        if self.config.has_radio or self.config.region.transport_sets:
            text += "".join(f"; {words}" for words in (broadcaster.trouble, broadcaster.lacking) if words)
        if self.refused.count:
            text += f"; {self.refused.count} broadcasts refused"
        text += "" if self.onboard.settings.enable else f"; {SWITCHED_OFF}"
        return text + "".join(f"; {trouble}" for trouble in self.troubles.texts)

    def summary(self, health: Health, loop: LoopCounts) -> dict[str, object]:
        """Content of `summary.json`."""
        trouble, signing = self.link.trouble, self.signing
        return {
            "ticks": loop.ticks,
            "late_ticks": loop.late_ticks,
            "stalls": loop.stalls,
            "tick_lateness_ms": {
                "median": self.lateness.percentile_s(50.0) * 1e3,
                "p99": self.lateness.percentile_s(99.0) * 1e3,
                "worst": self.lateness.worst_s * 1e3,
            },
            "state": self.onboard.core.state.value,
            "frames_sent": health.frames_sent,
            "frames_heard": health.frames_heard,
            "bad_frames": health.bad_frames,
            "broadcasts_refused": self.refused.count,
            "broadcast_errors": sorted(self.refused.texts),
            "link_losses": trouble.losses,
            "link_errors": trouble.errors,
            "link_sends_dropped": trouble.dropped,
            "link_discarded": trouble.discarded,
            "gate_refused": dict(self.onboard.gate.counts),
            "signing": None if signing is None else dataclasses.asdict(signing.counts),
            "lines_dropped": self.voice.dropped,
            "records_dropped": self.record.dropped,
            "recorder_error": self.record.error,
            "runs_deleted": self.record.deleted,
        }

    def live(self, now_s: float, loop: LoopCounts) -> Status:
        """Live state, as `companion status` shows it."""
        core, health, trouble = self.onboard.core, self.radio.health(now_s), self.link.trouble
        flies = core.state in HOLDING and now_s - self.decided_s <= _DECIDED_S
        vehicle = self.onboard.link.vehicle
        return Status(
            aircraft=self.config.identity.name,
            software=__version__,
            dry_run=self.dry_run,
            up_s=now_s - self.began_s,
            vehicle=None if vehicle is None else str(vehicle),
            link=self.config.vehicle.link,
            link_up=self.link.up,
            link_losses=trouble.losses,
            link_dropped=trouble.dropped,
            link_errors=trouble.errors,
            radio=health.text,
            radio_ok=health.ok,
            rates=self._rates(),
            sent_per_s={} if self.dry_run else self.sent.per_s(now_s),
            frames_sent=health.frames_sent,
            frames_heard=health.frames_heard,
            bad_frames=health.bad_frames,
            broadcasts_refused=self.refused.count,
            ticks=loop.ticks,
            late_ticks=loop.late_ticks,
            worst_tick_ms=self.lateness.worst_s * 1e3,
            folder=None if self.record.folder is None else str(self.record.folder),
            recorder_error=self.record.error,
            records_dropped=self.record.dropped,
            troubles=self.troubles.texts,
            said=tuple(self.lines),
            **core_status(core, now_s, self.decision if flies else None),
        )
