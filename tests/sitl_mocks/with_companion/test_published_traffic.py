"""Heard Remote ID traffic on its way to a ground station's map, through the vehicle's real bytes."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.config import Config, IdentityConfig, TrafficConfig
from companion.events import AdsbVehicle, Firmware, Say, TrafficReport
from companion.remote_id.messages import Location
from companion.traffic.published import MOST, is_published
from sitl_mocks.vehicle.traffic import CrewedFlight
from tests.companion.core.conftest import intruder
from tests.sitl_mocks.with_companion.pair import TICK_S, Pair

ARDUPILOT, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", Firmware)
FIELDS = (
    mavlink.ADSB_FLAGS_VALID_COORDS | mavlink.ADSB_FLAGS_VALID_ALTITUDE | mavlink.ADSB_FLAGS_VALID_HEADING
    | mavlink.ADSB_FLAGS_VALID_VELOCITY | mavlink.ADSB_FLAGS_VALID_CALLSIGN
)  # fmt: skip


class Shown(Pair):
    """A vehicle with a companion on link 0 and a ground station on link 1."""

    def __init__(self, firmware: Firmware, publish: str, aircraft: int = 1, **options: Any) -> None:
        config = Config(identity=IdentityConfig(uas_id="OWN"), traffic=TrafficConfig(publish=publish))
        super().__init__(firmware, config, **options)
        self.map: list[tuple[float, Any]] = []
        """ADSB_VEHICLE that the ground station received, and when."""
        self.aircraft = aircraft
        self._station, self._reader = MavlinkWriter(255, 190), MavlinkReader()
        self.heard = self._intruder

    def _intruder(self, now_s: float) -> Any:
        tick = round(now_s / TICK_S)
        number = tick % self.aircraft
        north_m = 300.0 + 20.0 * number - 2.0 * now_s
        return intruder(self, north_m, 2.0, uas_id=f"1596B00DMU{number:05d}")

    def run(self, seconds: float) -> Shown:
        for _ in range(round(seconds / TICK_S)):
            beat = self._station.encoder.heartbeat_encode(6, 8, 0, 0, 4)
            self.vehicle.receive(self._station.pack(beat), self.now_s, 1)
            super().run(TICK_S)
            for message in self._reader.feed(self.vehicle.drain(1)):
                if message.get_type() == "ADSB_VEHICLE":
                    self.map.append((self.now_s, message))
        return self

    @property
    def published(self) -> list[TrafficReport]:
        return self.commands(TrafficReport)


@BOTH
@pytest.mark.parametrize("publish", ["if-ignored", "routed"])
def test_a_ground_station_draws_the_aircraft(firmware, publish):
    pair = Shown(firmware, publish).run(20.0)
    assert len(pair.map) >= 8
    at_s, shown = pair.map[-1]
    assert shown.flags & FIELDS == FIELDS
    assert not shown.flags & mavlink.ADSB_FLAGS_SIMULATED
    assert (shown.ICAO_address >> 20, shown.callsign) == (0xB, "RID00000")
    assert shown.emitter_type == mavlink.ADSB_EMITTER_TYPE_UAV
    assert shown.altitude_type == mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC
    assert shown.altitude / 1e3 == pytest.approx(450.0, abs=0.6)  # 497 m above the ellipsoid, 47 m of geoid
    assert shown.heading == 18000
    assert shown.hor_velocity == 200
    north_m = (shown.lat / 1e7 - pair.options.home_lat_deg) * 111_194.9
    assert north_m == pytest.approx(300.0 - 2.0 * at_s, abs=5.0)
    assert shown.tslc <= 1


@BOTH
def test_nothing_is_published_by_default(firmware):
    pair = Shown(firmware, "off").run(10.0)
    assert pair.onboard.core.traffic.tracks
    assert not pair.published
    assert not pair.map


@pytest.mark.parametrize(
    ("firmware", "parameter", "acts"),
    [(ARDUPILOT, {"ADSB_TYPE": 1.0}, True), (PX4, {"NAV_TRAFF_AVOID": 2.0}, True),
     (PX4, {"NAV_TRAFF_AVOID": 0.0}, False), (ARDUPILOT, {"ADSB_TYPE": 0.0}, False)],
)  # fmt: skip
def test_an_autopilot_that_would_act_gets_nothing_unless_a_router_keeps_it(firmware, parameter, acts):
    pair = Shown(firmware, "if-ignored", parameters=parameter).run(15.0)
    assert bool(pair.published) is not acts
    assert bool(pair.vehicle.traffic.taken) is (not acts and firmware is PX4)
    said = [say.text for say in pair.commands(Say) if "not published" in say.text]
    assert len(said) == int(acts)
    assert Shown(firmware, "routed", parameters=parameter).run(15.0).published


@BOTH
def test_what_we_publish_never_comes_back_as_traffic(firmware):
    """PX4, and ArduPilot with a receiver, report what they are told as their own ADS-B."""
    options = {"parameters": {"ADSB_TYPE": 1.0}} if firmware is ARDUPILOT else {}
    crewed = CrewedFlight(
        icao=0x4B1234, start_ned_m=(3000.0, 0.0, -200.0), velocity_ned_mps=(-30.0, 0.0, 0.0)
    )
    pair = Shown(firmware, "routed", traffic=(crewed,), **options).run(20.0)
    echoes = [event for event in pair.events(AdsbVehicle) if is_published(event)]
    assert echoes
    assert {n.track_id for n in pair.onboard.core.adsb.neighbours(pair.now_s, -50.0)} == {"4B1234"}
    assert {report.icao >> 20 for report in pair.published} == {0xB}  # ADS-B is not echoed.


@BOTH
def test_a_crowd_is_bounded_in_rate_and_number(firmware):
    pair = Shown(firmware, "routed", aircraft=40).run(25.0)
    assert len(pair.onboard.core.traffic.tracks) == 40
    reports = [(at_s, report) for at_s, report in pair.timed(TrafficReport) if at_s > 10.0]
    assert len({report.icao for _, report in reports}) <= MOST + 3  # All fly alike, but are heard in turn.
    for begin_s in range(10, 24):
        second = [report.icao for at_s, report in reports if begin_s <= at_s < begin_s + 1.0]
        assert len(second) <= MOST
        assert len(set(second)) == len(second)
    assert all(b - a >= 0.1 - 1e-6 for (a, _), (b, _) in pairwise(reports))
    places = [report.lat_deg for _, report in reports]
    north_m = [(lat - pair.options.home_lat_deg) * 111_194.9 for lat in places]
    assert max(north_m) <= 300.0 + 20.0 * (MOST + 2)


def test_names_of_strangers_cannot_leave_the_callsign():
    pair = Shown(ARDUPILOT, "routed")
    pair.heard = lambda now_s: intruder(pair, 200.0, 2.0, uas_id="\x00ü-*/")
    pair.run(10.0)
    names = {message.callsign for _, message in pair.map}
    assert all(name.startswith("RID") and name.isascii() and name.isalnum() for name in names)


def test_an_aircraft_that_reports_no_height_has_none_on_the_map():
    pair = Shown(ARDUPILOT, "routed")

    def without_height(now_s):
        heard = intruder(pair, 200.0, 2.0)
        blank = {"alt_geodetic_m": None, "alt_barometric_m": None, "height_m": None}
        known = {key: None for key in blank if key in Location.__struct_fields__}
        identity, location = heard.messages
        return msgspec.structs.replace(heard, messages=(identity, msgspec.structs.replace(location, **known)))

    pair.heard = without_height
    pair.run(10.0)
    assert pair.map
    assert not any(message.flags & mavlink.ADSB_FLAGS_VALID_ALTITUDE for _, message in pair.map)
    assert all(math.isclose(message.altitude, 0.0) for _, message in pair.map)
