"""What waits to leave on the link: whole frames, numbered, signed where there is a key, and bounded.

Before the vehicle is known (a `udpout` link must speak first) they carry the configured system id, or 1, as
other companion software does; never 255, which ArduPilot takes for its ground station and watches for
failsafes. From then on the vehicle's own.
"""

from __future__ import annotations

from companion.autopilot import encoders
from companion.autopilot.counts import LinkCounts
from companion.autopilot.encoders import Outgoing
from companion.autopilot.signing import Signing
from companion.autopilot.wire import MavlinkWriter
from companion.config import VehicleConfig
from companion.events import Severity

COMMAND_FRESH_S = 0.25
"""A command that could not leave for so long does not leave any more."""
MAX_QUEUED_BYTES = 65536
"""What waits to be drained; a caller that never drains loses it rather than the memory."""
_DEFAULT_SYSTEM_ID = 1


class Outbox:
    """Frames in the order in which they were queued, behind them commands to the vehicle, then the newest
    setpoint. The last two may be held back (`drain`)."""

    def __init__(self, config: VehicleConfig, counts: LinkCounts, signing: Signing | None) -> None:
        """Empty. `signing` signs what leaves; None: nobody does."""
        self._counts = counts
        self._signing = signing
        self._writer = MavlinkWriter(config.system_id or _DEFAULT_SYSTEM_ID, config.component_id)
        self._out = bytearray()
        self._commands: list[tuple[float, Outgoing]] = []
        """With when they were queued."""
        self._setpoint: Outgoing | None = None
        self._text_id = 0

    def speak_as(self, system_id: int) -> None:
        """The vehicle is known: be a part of it."""
        self._writer.encoder.srcSystem = system_id

    def queue(self, outgoing: Outgoing) -> None:
        """One message of ours."""
        self.queue_frame(self._writer.pack_payload(*outgoing))

    def queue_frame(self, frame: bytes) -> None:
        """A frame that is whole but for its signature."""
        if len(self._out) > MAX_QUEUED_BYTES:
            self._out.clear()
            self._counts.overflows += 1
        self._out += self._signed(frame)

    def say(self, severity: Severity, text: str) -> None:
        """A text for ground stations."""
        self._text_id = self._text_id % 0xFFFF + 1
        for chunk in encoders.statustext(int(severity), text, self._text_id):
            self.queue(chunk)

    def replace_setpoint(self, setpoint: Outgoing) -> None:
        """The newest one; one before it that has not left yet is dropped."""
        if self._setpoint is not None:
            self._counts.setpoints_dropped += 1
        self._setpoint = setpoint

    def command(self, outgoing: Outgoing, now_s: float) -> None:
        """A command to the vehicle that must not be carried out late."""
        self._commands.append((now_s, outgoing))

    def drop_old(self, now_s: float) -> None:
        """A new step begins: the setpoint that has not left by now is too old; so is a command after a
        while."""
        if self._setpoint is not None:
            self._setpoint = None
            self._counts.setpoints_dropped += 1
        self._commands = [c for c in self._commands if now_s - c[0] <= COMMAND_FRESH_S]

    @property
    def holds(self) -> bool:
        """A command or a setpoint has not left."""
        return self._setpoint is not None or bool(self._commands)

    def drain(self, *, commanding: bool = True) -> bytes:
        """What leaves now. Commands and setpoint are numbered and signed only as they leave.

        Args:
            commanding: False: commands and setpoint stay.
        """
        if commanding:
            for _, outgoing in self._commands:
                self.queue(outgoing)
            self._commands.clear()
            if self._setpoint is not None:
                self.queue(self._setpoint)
                self._setpoint = None
                self._counts.setpoints += 1
        out = bytes(self._out)
        self._out.clear()
        return out

    def _signed(self, frame: bytes) -> bytes:
        return frame if self._signing is None else self._signing.sign(frame)
