"""Real processes: `companion run` is stopped and resumed, and the pilot selects a mode meanwhile."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar

import pytest

from companion.events import Firmware
from sitl_mocks.examinations.takeover import real_cases
from sitl_mocks.examinations.takeover.real_cases import (
    CompanionEndedError,
    NoFlightError,
    RealCase,
    RealVerdict,
    fly_cases,
    real_case,
)
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

RTL, LOITER, LAND = VehicleMode.RTL, VehicleMode.HOLD, VehicleMode.LAND
CASES = {
    # Behind 128 datagrams; behind as many, and found after a buffer that is full; just before it goes on.
    (Firmware.ARDUPILOT, "udp"): (
        (3.0, 2.7, RTL, 25.0),
        (2.7, 1.25, LOITER, 310.0),
        (1.4, 1.38, LAND, 100.0),
    ),
    # Behind 128 KiB; behind hardly anything; after it went on.
    (Firmware.ARDUPILOT, "tcp"): (
        (3.2, 3.1, RTL, 2000.0),
        (1.2, 0.2, LOITER, 20.0),
        (1.1, 1.15, LAND, 100.0),
    ),
    # Behind 8 KiB; behind as many, and found after a buffer that is full; just before it goes on.
    (Firmware.ARDUPILOT, "pty"): (
        (1.3, 1.1, RTL, 400.0),
        (2.6, 2.4, LOITER, 400.0),
        (1.4, 1.38, LAND, 100.0),
    ),
    # The failsafe's mode comes first; too short for one; a pilot before it.
    (Firmware.PX4, "udp"): ((2.0, 1.8, LAND, 60.0), (0.8, 0.7, LOITER, 200.0), (1.6, 0.3, RTL, 100.0)),
}
"""Stall and pilot after its beginning (s), his mode, frames of others a second."""


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory):
    """The verdicts of all cases, which are flown in parallel."""
    folders = {place: tmp_path_factory.mktemp("takeover") for place in CASES}

    def flown(place):
        cases = [
            RealCase(number, stall_s, selects_s, mode, traffic_hz, 1.0)
            for number, (stall_s, selects_s, mode, traffic_hz) in enumerate(CASES[place])
        ]
        return fly_cases(*place, cases, folders[place])

    with ThreadPoolExecutor(len(CASES)) as pool:
        return dict(zip(CASES, pool.map(flown, CASES), strict=True))


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("place", CASES, ids=lambda place: f"{place[0].value}-{place[1]}")
def test_what_the_pilot_selects_stays_selected(verdicts, place, number):
    verdict = verdicts[place][number]
    assert verdict.trouble is None
    assert verdict.breaches == ()


def test_a_case_is_its_number():
    assert real_case(1, 14) == real_case(1, 14)
    assert len({real_case(1, number) for number in range(50)}) == 50


class Flight:
    """In place of `RealFlight`: what happens in each case, in turn."""

    happens: ClassVar[list[Exception | None]] = []
    begun = 0

    def __init__(self, firmware, link, folder):
        Flight.begun += 1
        assert folder.is_dir()

    def fly(self, case):
        error = Flight.happens.pop(0)
        if error is not None:
            raise error
        return RealVerdict(Firmware.PX4, "udp", case, ())

    def give_back(self):
        """Nothing was taken."""

    def close(self):
        """Nothing to end."""


STALLED, ENDED = NoFlightError("stalled"), CompanionEndedError("ended")


@pytest.mark.parametrize(
    ("happens", "begun", "troubles"),
    [
        ([None, None], 1, [None, None]),
        ([STALLED, STALLED, None, None], 3, [None, None]),
        ([STALLED, STALLED, STALLED, None], 4, ["stalled", None]),
        ([ENDED, None], 2, ["ended", None]),
    ],
    ids=["both fly", "begun again", "given up", "a companion that ended is told"],
)
def test_a_case_without_a_result_is_begun_again_unless_the_companion_ended(
    monkeypatch, tmp_path, happens, begun, troubles
):
    monkeypatch.setattr(real_cases, "RealFlight", Flight)
    monkeypatch.setattr(Flight, "happens", list(happens))
    monkeypatch.setattr(Flight, "begun", 0)
    verdicts = fly_cases(Firmware.PX4, "udp", [real_case(1, number) for number in range(2)], tmp_path)
    assert [verdict.trouble for verdict in verdicts] == troubles
    assert Flight.begun == begun
    assert Flight.happens == []
