"""Readers of the logs that autopilots write on board."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from functools import cache, partial

from companion.flight_logs import About, ardupilot, px4
from tests.fuzz.seeds import Target, taking
from tests.support.dataflash_writer import DataFlashWriter
from tests.support.ulog_writer import UlogWriter


def _read_log(read_steps: Callable[..., Iterable[object]], data: bytes) -> None:
    for _ in read_steps(io.BytesIO(data), "a log", About()):
        pass


@cache
def _dataflash_seeds() -> list[bytes]:
    """Small logs, one with units and one without."""
    found = []
    for with_units in (True, False):
        log = DataFlashWriter(with_units=with_units)
        log.define("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "FGG000")
        log.define("MSG", "QZ", "TimeUS,Message")
        log.define("GUIP", "QBfff", "TimeUS,Type,vX,vY,vZ", "F-BBB")
        log.write("MSG", 0, "ArduCopter V4.6.1")
        for us in (1_000, 100_000):
            log.write("POS", us, 47.0, 8.5, 450.0, 20.0, 20.0)
            log.write("GUIP", us, 4, 100.0, 0.0, -50.0)
        found.append(log.content)
    return found


@cache
def _ulog_seeds() -> list[bytes]:
    """Small logs, one of them with appended data."""
    found = []
    for appended in (False, True):
        log = UlogWriter(0)
        log.info("", "ver_hw", "PX4_SITL")
        log.parameter("int32_t", "MAV_SYS_ID", 9)
        log.define("wind", "uint64_t timestamp;float windspeed_north;float windspeed_east;")
        log.define(
            "vehicle_status",
            "uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;uint8_t[6] _padding0;",
        )
        for topic in ("wind", "vehicle_status"):
            log.subscribe(topic)
        for us in (1_000, 100_000):
            log.data("vehicle_status", us, 14, 2)
            log.data("wind", us, 3.0, -4.0)
            log.sync()
        if appended:
            log.append_here()
        log.text(200_000, 4, "low battery")
        found.append(log.content)
    return found


def make_targets() -> list[Target]:
    """One target for each kind of log."""
    return [
        Target("dataflash log", _dataflash_seeds(), taking(partial(_read_log, ardupilot.read_steps))),
        Target("ulog", _ulog_seeds(), taking(partial(_read_log, px4.read_steps))),
    ]
