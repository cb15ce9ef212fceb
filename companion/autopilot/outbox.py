"""Send queue of the link: whole frames, numbered, signed if there is a key, and limited in size.

Before the vehicle is known (a `udpout` link must speak first), frames carry the configured system id, or 1,
as other companion software does. They never carry 255, which ArduPilot takes for its ground station and
monitors for failsafes. Once the vehicle is known, they carry its system id.
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
"""A command that could not leave within this time is dropped."""
MAX_QUEUED_BYTES = 65536
"""Limit of the undrained queue. If the caller never drains it, the queue is discarded, so that memory stays
bounded."""
_DEFAULT_SYSTEM_ID = 1


class Outbox:
    """The send queue. Frames leave in the order in which they were queued, then commands to the vehicle, then
    the newest setpoint. Commands and setpoint may be held back (`drain`)."""

    def __init__(self, config: VehicleConfig, counts: LinkCounts, signing: Signing | None) -> None:
        """Create an empty queue. `signing` signs what leaves; None: frames are not signed."""
        self._counts = counts
        self._signing = signing
        self._writer = MavlinkWriter(config.system_id or _DEFAULT_SYSTEM_ID, config.component_id)
        self._out = bytearray()
        self._commands: list[tuple[float, Outgoing]] = []
        """Commands, each with the time when it was queued."""
        self._setpoint: Outgoing | None = None
        self._text_id = 0

    @property
    def next_sequence(self) -> int:
        """Sequence number of the next frame that is queued."""
        return int(self._writer.encoder.seq)

    def speak_as(self, system_id: int) -> None:
        """The vehicle is known: use its system id from now on."""
        self._writer.encoder.srcSystem = system_id

    def queue(self, outgoing: Outgoing) -> None:
        """Queue one message of ours."""
        self.queue_frame(self._writer.pack_payload(*outgoing))

    def queue_frame(self, frame: bytes) -> None:
        """Queue a frame that is complete except for its signature."""
        if len(self._out) > MAX_QUEUED_BYTES:
            self._out.clear()
            self._counts.overflows += 1
        self._out += self._signed(frame)

    def say(self, severity: Severity, text: str) -> None:
        """Queue a text for ground stations."""
        self._text_id = self._text_id % 0xFFFF + 1
        for chunk in encoders.statustext(int(severity), text, self._text_id):
            self.queue(chunk)

    def replace_setpoint(self, setpoint: Outgoing) -> None:
        """Set the newest setpoint. An earlier one that has not left yet is dropped."""
        if self._setpoint is not None:
            self._counts.setpoints_dropped += 1
        self._setpoint = setpoint

    def command(self, outgoing: Outgoing, now_s: float) -> None:
        """Queue a command to the vehicle that must not be carried out late."""
        self._commands.append((now_s, outgoing))

    def drop_old(self, now_s: float) -> None:
        """Begin a step: drop a setpoint that has not left yet, and commands older than `COMMAND_FRESH_S`."""
        if self._setpoint is not None:
            self._setpoint = None
            self._counts.setpoints_dropped += 1
        self._commands = [c for c in self._commands if now_s - c[0] <= COMMAND_FRESH_S]

    @property
    def holds(self) -> bool:
        """Whether a command or a setpoint has not left yet."""
        return self._setpoint is not None or bool(self._commands)

    def drain(self, *, commanding: bool = True) -> bytes:
        """Return the bytes to send now. Commands and setpoint are numbered and signed only as they leave.

        Args:
            commanding: False: commands and setpoint stay in the queue.
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
