"""How `ground-tools fly` ends, with fake vehicles: none is left unattended in the air."""

from __future__ import annotations

import os
import signal
import sys
from types import SimpleNamespace

import pytest

from companion.events import Firmware, FlightMode
from ground_tools import cli
from ground_tools.fly import command
from ground_tools.fly.modes import MODES


class Flying:
    """A fake vehicle in flight, with the commands that it received."""

    def __init__(self, happens) -> None:
        self.name, self.system_id, self.firmware = "vehicle 1", 1, Firmware.ARDUPILOT
        self.modes = MODES[self.firmware]
        self.ours, self.armed_by_us = frozenset(), False
        self.armed, self.on_ground, self.height_m, self.mode = True, False, 20.0, "AUTO"
        self.told: list[object] = []
        self._happens = happens

    def command(self, *_: object) -> None:
        self._happens()

    def age_s(self, _: str) -> float:
        return 0.0

    def last(self, *_: object) -> dict[str, int]:
        return {}

    def said(self, _: float) -> str:
        return ""

    def hear_again(self) -> None:
        pass

    def set_mode(self, mode: FlightMode) -> None:
        self.told.append(mode)

    def close(self) -> None:
        self.told.append("closed")


@pytest.fixture
def flying(monkeypatch):
    def with_one(happens) -> Flying:
        vehicle = Flying(happens)
        monkeypatch.setattr(command, "load_mavsdk", lambda: None)
        monkeypatch.setattr(command, "Vehicle", SimpleNamespace(connect=lambda *_: vehicle))
        return vehicle

    return with_one


@pytest.mark.usefixtures("hangup_ends")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_the_vehicle_holding(flying, number, capsys):
    vehicle = flying(lambda: os.kill(os.getpid(), number))
    assert cli.main(["fly", "udpout://127.0.0.1:1", "--start"]) == 130
    assert vehicle.told == [FlightMode.HOLD, "closed"]


@pytest.mark.usefixtures("hangup_ends")
def test_the_vehicle_holds_even_if_the_terminal_is_gone(flying, monkeypatch):
    def gone(*_: object) -> None:
        raise OSError(5, "Input/output error")

    def hang_up() -> None:
        for stream in ("stdout", "stderr"):
            monkeypatch.setattr(sys, stream, SimpleNamespace(write=gone, flush=gone))
        os.kill(os.getpid(), signal.SIGHUP)

    vehicle = flying(hang_up)
    with pytest.raises(OSError, match="Input/output error"):
        cli.main(["fly", "udpout://127.0.0.1:1", "--start"])
    assert vehicle.told == [FlightMode.HOLD, "closed"]


def test_a_hang_up_that_is_ignored_ends_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with command.end_signals() as ended:
            os.kill(os.getpid(), signal.SIGHUP)
            assert ended == []
    finally:
        signal.signal(signal.SIGHUP, before)
