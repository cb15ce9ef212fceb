"""A stop leaves no vehicle in our mode, even if the vehicle has not reported that mode yet."""

from __future__ import annotations

import msgspec
import pytest

from companion.authority.table import State
from companion.autopilot.dialect import CMD_DO_SET_MODE, DIALECTS
from companion.config import RecordConfig
from companion.events import Firmware, FlightMode, GateRefused
from companion.runtime import clock
from companion.runtime.flight import Flight
from companion.runtime.links.byte_link import LinkTrouble
from tests.companion.runtime.flying import Joined, fly, heard_of


class Obeys(Joined):
    """A link on which the first request for our mode stops the flight and arrives late or never."""

    def __init__(self, *, arrives, faulty=False):
        super().__init__(Firmware.PX4)
        self.trouble = LinkTrouble()
        self._arrives, self._late, self._faulty = arrives, [], faulty
        self.asked = []

    def receive(self, now_s):
        if self._faulty and self.asked and self.flight.onboard.core.state is State.FAULT:
            self.flight.stop()
        if self._late and now_s >= self._late[0][0]:
            self.vehicle.receive(self._late.pop()[1], now_s)
        return super().receive(now_s)

    def send(self, data):
        before = len(self.left)
        self.left += self._reader.feed(data)
        sent = [m for m in self.left[before:] if m.get_type() == "COMMAND_LONG"]
        modes = [m.param2 for m in sent if m.command == CMD_DO_SET_MODE]
        self.asked += modes
        if modes and len(self.asked) == 1:
            if self._faulty:
                fault = GateRefused(rule=10, text="a fault", ends="fault")
                self.flight.onboard.core._control.note_gate_refusal(fault)
            else:
                self.flight.stop()
            if self._arrives:
                self._late = [(clock.now_s() + 0.3, data)]
            return
        self.vehicle.receive(data, clock.now_s())


@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize("arrives", [True, False])
def test_a_stop_while_our_mode_is_requested(
    make_config, tmp_path, monkeypatch, said, until, kept_signals, watchdog, arrives, faulty
):
    """The vehicle would hover in OFFBOARD or GUIDED for ever, or enter its failsafe. A fault just before the
    stop gives up the request, but the vehicle may still obey it."""
    link = Obeys(arrives=arrives, faulty=faulty)
    monkeypatch.setattr("companion.runtime.flight.KeptLink", lambda *_: link)
    config = msgspec.structs.replace(make_config(use="fly"), record=RecordConfig(folder=str(tmp_path)))
    link.flight = flight = Flight(config, said.append, dry_run=False)
    fly(flight, lambda: until(lambda: flight._stop))
    link.receive(clock.now_s() + 0.3)
    commands = DIALECTS[Firmware.PX4].commands
    assert link.asked[0] == commands[FlightMode.EXTERNAL].param2
    assert link.vehicle.custom_mode == commands[FlightMode.HOLD].custom_mode
    assert heard_of(said, "asking the vehicle to hold")() is arrives
    assert (len(link.asked) > 1) is arrives, "a vehicle that stays in its own mode is left alone"
