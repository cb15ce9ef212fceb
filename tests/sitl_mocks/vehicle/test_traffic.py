from __future__ import annotations

import math

import pytest

from companion.errors import ConfigError
from companion.events import AdsbVehicle, Firmware
from sitl_mocks.vehicle.traffic import CrewedFlight
from tests.sitl_mocks.vehicle.test_fence import Line
from tests.support.place import HOME

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])
ADSB = 246


def flight(icao=0x4B1234, **over):
    values = {"start_ned_m": (3000.0, -500.0, -200.0), "velocity_ned_mps": (-60.0, 10.0, 2.0)}
    return CrewedFlight(icao=icao, **(values | over))


def heard(messages):
    return [m for m in messages if m.get_type() == "ADSB_VEHICLE"]


def test_ardupilot_tells_only_who_asks_and_one_per_interval(bench):
    b = bench(AP, traffic=tuple(flight(icao) for icao in range(1, 6)))
    assert heard(b.run(3.0)) == []
    assert b.interval(ADSB, 25.0) == [0]
    b.run(1.0)
    assert sorted(m.ICAO_address for m in heard(b.run(4.0))) == sorted([1, 2, 3, 4, 5] * 4)
    # Two a second: the list takes longer than a second.
    b.interval(ADSB, 2.0)
    b.run(1.0)
    assert len(heard(b.run(5.0))) == 10


def test_px4_passes_each_report_on_unasked(bench):
    b = bench(PX4, traffic=(flight(1), flight(2)))
    b.run(1.0)
    messages = heard(b.run(10.0))
    assert [m.ICAO_address for m in messages] == [1, 2] * 10
    b.interval(ADSB, 25.0)
    assert len(heard(b.run(10.0))) == 20


@pytest.mark.parametrize(("firmware", "flags"), [(AP, 0xBF), (PX4, 0x3F)])
def test_flags_of_the_firmwares(bench, firmware, flags):
    b = bench(firmware, traffic=(flight(callsign="HBABC"),))
    b.interval(ADSB, 25.0)
    messages = heard(b.run(2.0))
    assert {m.flags for m in messages} == {flags}
    assert {m.callsign for m in messages} == {"HBABC"}


@pytest.mark.parametrize(("firmware", "last_s"), [(AP, 9.0), (PX4, 4.0)])
def test_ardupilot_repeats_the_last_report_for_five_seconds(bench, firmware, last_s):
    b = bench(firmware, traffic=(flight(heard_from_s=2.0, heard_until_s=4.5),))
    b.interval(ADSB, 25.0)
    b.run(15.0)
    told = [(at_s, m) for at_s, m in b.seen if m.get_type() == "ADSB_VEHICLE"]
    assert told[0][0] == pytest.approx(2.0, abs=0.05)
    assert told[-1][0] == pytest.approx(last_s, abs=1.0)
    after = [m for at_s, m in told if at_s >= 4.05]
    assert len({(m.lat, m.lon, m.tslc) for m in after}) <= 1


@BOTH
@pytest.mark.parametrize("geometric", [False, True])
def test_the_companion_sees_the_true_flight(firmware, geometric):
    line = Line(firmware, traffic=(flight(geometric=geometric, callsign="HBABC"),))
    line.run(12.0)
    events = line.of(AdsbVehicle)
    assert len(events) == pytest.approx(11, abs=2)
    places = []
    for event in events:
        assert event.velocity_ned_mps == pytest.approx((-60.0, 10.0, 2.0), abs=0.02)
        assert (event.icao, event.callsign, event.alt_geometric) == (0x4B1234, "HBABC", geometric)
        altitude_m = event.alt_m - (47.0 if geometric else 0.0)
        places.append(HOME.to_ned(event.lat_deg, event.lon_deg, altitude_m))
    for place in places:
        age_s = (3000.0 - place[0]) / 60.0
        assert age_s == pytest.approx(round(age_s), abs=1e-3)
        assert place == pytest.approx(
            (3000.0 - 60.0 * age_s, -500.0 + 10.0 * age_s, -200.0 + 2.0 * age_s), abs=0.1
        )
    assert places[-1][0] < 2500.0


@BOTH
def test_no_traffic_no_messages(firmware):
    line = Line(firmware)
    line.run(10.0)
    assert line.of(AdsbVehicle) == []
    assert "No ap_message" not in str(line.events)


@pytest.mark.parametrize(
    "over",
    [
        {"icao": 2**24},
        {"callsign": "NINECHARS"},
        {"callsign": "é"},
        {"start_ned_m": (math.nan, 0.0, 0.0)},
        {"velocity_ned_mps": (700.0, 0.0, 0.0)},
        {"velocity_ned_mps": (0.0, 0.0, -301.0)},
    ],
)
def test_flights_that_adsb_cannot_carry(over):
    with pytest.raises(ConfigError):
        flight(**over)
