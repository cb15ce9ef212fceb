"""Small files of every kind that a command of the docs reads, under the names that the docs give them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Final

from companion import __version__
from companion.commands import bench_test
from companion.events import Firmware
from companion.remote_id.captures.radiotap import build_radiotap
from sitl_mocks.examinations import soak
from sitl_mocks.examinations.swarm import schedule as swarm_schedule
from tests.fuzz.radio_targets import pcap
from tests.fuzz.seeds import built
from tests.support import encounter_models, onboard_logs

_ROOT: Final = Path(__file__).parents[2]
_DATA: Final = _ROOT / "tests" / "data"
HEAD_ON: Final = """\
# Two aircraft, head on; a comment
00:00:00.00>CRE WEST,B744,0.0,-0.5,90.0,FL100,250
00:00:00.00>cre EAST B744 0.0 0.5 270 10000 250 # and a comment behind

00:00:00.00>ASAS ON
00:00:00.00>WEST TRAIL ON
00:00:05.00>RESO MVP
"""
"""A scenario of BlueSky."""
INTENTIONS: Final = """\
00:00:00,D1,MP20,00:00:10,"(16.36, 48.18)","(16.36, 48.20)",2,,,,,,
00:00:00,D2,MP30,00:01:00,"(16.345, 48.19)","(16.375, 48.19)",1,,,,,,
00:00:00,D3,MP20,00:00:00,"(16.0, 48.5)","(16.0, 48.6)",3,,,,,,
00:00:00,L1,MP20,00:00:00,"(16.1, 48.5)","(16.2, 48.5)",4,60,1,2,3,4,5
00:00:00,D4,JET,00:00:00,"(16.1, 48.5)","(16.2, 48.5)",1,,,,,,
00:00:00,D5,MP20,soon,"(16.1, 48.5)","(16.2, 48.5)",1,,,,,,
00:00:00,D6,MP20,00:00:00,nowhere,"(16.2, 48.5)",1,,,,,,
a,b

"""
"""Flight intentions of Metropolis 2."""


def write(folder: Path) -> None:
    """Write all of them into a folder."""
    law = (_ROOT / "docs" / "examples" / "plugin-law" / "dmuca_sidestep.py").read_text()
    (folder / "mine.py").write_text(law.replace("Sidestep", "Law"))
    for name in ("orca_cases.json.gz", "vectors.json.gz"):
        shutil.copy(_DATA / name, folder / name.removeprefix("orca_"))
    onboard_logs.copter(folder / "00000042.BIN")
    for name in ("flight.ulg", "drone1.ulg", "drone2.ulg"):
        onboard_logs.px4(folder / name)
    frames = [build_radiotap() + frame for transport in ("wifi", "nan") for frame in built(transport)]
    (folder / "capture.pcapng").write_bytes(pcap(127, frames))
    for name in ("super8.scn", "wall.scn"):
        (folder / name).write_text(HEAD_ON)
    # INTENTIONS with D1 12 s later: then the two meet.
    meeting = INTENTIONS.replace("MP20,00:00:10", "MP20,00:00:22")
    (folder / "Flight_intention_very_low_40_8_W1.csv").write_text(meeting)
    for name in encounter_models.NAMES:
        shutil.copy(encounter_models.TINY, folder / f"{name}.txt")
    _write_missions(folder)
    _write_schedules(folder)
    _write_evidence(folder / "first-flights.json")


def _write_missions(folder: Path) -> None:
    """Write a mission as QGroundControl and as Mission Planner save it."""
    place = (47.397, 8.545, 30.0)
    item = {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, *place]}
    plan = {"fileType": "Plan", "version": 1, "mission": {"version": 2, "items": [item]}}
    (folder / "survey.plan").write_text(json.dumps(plan))
    rows = ("QGC WPL 110", "0 1 0 16 0 0 0 0 47.397 8.545 400 1", "1 0 3 16 0 0 0 0 47.398 8.545 30 1")
    (folder / "survey.waypoints").write_text("\n".join((rows[0], *(r.replace(" ", "\t") for r in rows[1:]))))


def _write_schedules(folder: Path) -> None:
    """Write the schedules of faults of a short soak and of one aircraft of a swarm."""
    short = soak.schedule_of(Firmware.PX4, "guard", 1, hours=0.02)
    (folder / "soak-1-px4-guard.json").write_text(json.dumps(soak.to_file(short, None)))
    one = swarm_schedule.to_file(swarm_schedule.draw(7, 2, 1, 10.0, "udp"))
    (folder / "DMUCA002.faults.json").write_text(json.dumps({"schedule": one}))


def _write_evidence(path: Path) -> None:
    """Write the evidence of an aircraft that has passed every stage of its first flights."""
    attempts = tuple(
        bench_test.Attempt(
            stage=stage, passed=True, utc="", software=__version__, aircraft="1596B0000DMUCA01",
            code_sha256=bench_test.code_sha256(), config="", config_sha256="", run=None, stated=(), checks=(),
        )
        for stage in bench_test.STAGES
    )  # fmt: skip
    bench_test.write_evidence(path, bench_test.Evidence(attempts=attempts))
