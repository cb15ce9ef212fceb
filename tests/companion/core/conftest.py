"""Fixtures and traffic of the core's tests."""

from __future__ import annotations

import math

import pytest

from companion.authority.table import State
from companion.events import FlightMode, RemoteIdHeard
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from tests.support.place import HOME

UTC_AT_ZERO_S = 1_767_225_600.0
UTC_IN_HOUR_S = UTC_AT_ZERO_S % 3600.0
"""UTC and seconds of the UTC hour at the bench's time 0."""


def intruder(bench, north_m, speed_mps, *, uas_id="OTHER", east_m=0.0, timestamp_s=None):
    """A head-on aircraft as heard: `north_m` ahead of the bench's origin, flying south."""
    stamp = (UTC_IN_HOUR_S + bench.now_s) % 3600.0 if timestamp_s is None else timestamp_s
    return RemoteIdHeard(
        transport="wifi",
        address=uas_id,
        messages=(
            BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=uas_id),
            Location(
                status=Status.AIRBORNE,
                lat_deg=HOME.lat_deg + north_m / 111_194.9,
                lon_deg=HOME.lon_deg + east_m / 75_300.0,
                alt_geodetic_m=497.0,
                direction_deg=180.0,
                speed_mps=speed_mps,
                vertical_speed_mps=0.0,
                horizontal_accuracy_m=3.0,
                timestamp_s=round(math.floor(stamp * 10) / 10, 1),
            ),
        ),
    )


@pytest.fixture
def flying(make_bench):
    """A bench whose core holds the vehicle and whose vehicle is in the external mode."""
    bench = make_bench()
    bench.until(lambda: bench.core.state is State.GUARDING and bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    return bench
