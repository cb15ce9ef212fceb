"""Observations from tracks, and the success of each transport from simulated lossy streams."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.atmc.actions import TRANSPORTS
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS, conflict_weight, identity_of
from companion.atmc.senses import FEWEST_EXPECTED, SCAN_SHARE, Senses, SuccessMeter
from companion.config import TrafficConfig
from companion.events import GlobalPosition, RemoteIdHeard, VehicleTime
from companion.ownship import Ownship
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.traffic.senders.reception import HEARD_S, Reception
from companion.traffic.tracks import Traffic
from sitl_mocks.channel.equations.reception import meeting_chances
from sitl_mocks.channel.parameters import WIFI_CHANNELS, load
from tests.support.place import HOME


def test_the_scan_shares_are_those_of_the_receiver_that_policies_are_trained_for():
    standard = load(Path(__file__).parents[3] / "config/channel/standard.toml")
    wifi = standard.wifi
    cycle_ms = len(WIFI_CHANNELS) * (wifi.scan_ms + wifi.switch_ms)
    expected = [
        sum(meeting_chances("ble4", standard)[0]),
        sum(meeting_chances("ble5", standard)[0]),
        (wifi.scan_ms - wifi.beacon_ms) / cycle_ms,
    ]
    assert pytest.approx(expected, abs=5e-4) == SCAN_SHARE


class Sender:
    """Sends at a rate; each message arrives by chance."""

    def __init__(self, transport, rate, seed):
        self.reception = Reception()
        self.parts = [(transport, self.reception)]
        self.rate, self.sent = rate, 0
        self.rng = np.random.default_rng(seed)

    def run(self, until_s, share):
        while self.sent / self.rate < until_s:
            if self.rng.random() < share:
                self.reception.count_frame(self.sent & 0xFF, self.sent / self.rate)
            self.sent += 1


def measured(transport, rate, count, share, seconds=120.0, meter=None, seed=0):
    """Mean success over the second half of a while."""
    meter = meter or SuccessMeter()
    senders = [Sender(transport, rate, 1000 * seed + k) for k in range(count)]
    found = []
    for k in range(round(seconds / 2.0)):
        for sender in senders:
            sender.run(2.0 * k, share)
        success, known = meter.measure(2.0 * k, [sender.parts for sender in senders])
        if known[TRANSPORTS.index(transport)] and 2.0 * k > 0.5 * seconds:
            found.append(success[TRANSPORTS.index(transport)])
    return np.mean(found) if found else None


@pytest.mark.parametrize("survives", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_the_success_of_a_scanning_receiver(transport, survives):
    share = survives * SCAN_SHARE[TRANSPORTS.index(transport)]
    assert measured(transport, 10, 8, share) == pytest.approx(survives, abs=0.1)


def test_a_receiver_that_listens_all_the_time_is_measured_by_its_own_best():
    meter = SuccessMeter()
    assert measured("wifi", 10, 8, 0.95, meter=meter) > 0.95
    assert measured("wifi", 10, 8, 0.5, meter=meter) == pytest.approx(0.55, abs=0.08)


def test_chance_does_not_raise_the_best():
    """The best of ten minutes of a scanning receiver stays near the scan's share."""
    assert measured("ble4", 10, 8, SCAN_SHARE[0], seconds=600.0) > 0.85


def test_too_few_messages_are_no_measurement():
    assert measured("wifi", 2, 1, 0.2) is None
    assert measured("wifi", 10, 1, 0.2) is not None
    meter = SuccessMeter()
    assert meter.measure(1.0, []) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert FEWEST_EXPECTED > 20.0


UTC_S = 1_767_225_600.0


@pytest.fixture
def own():
    made = Ownship()
    made.observe(VehicleTime(time_boot_s=0.0, utc_s=UTC_S), 0.0)
    move(made, 0.0)
    return made


def move(own, now_s):
    own.observe(
        GlobalPosition(
            time_boot_s=now_s,
            lat_deg=HOME.lat_deg,
            lon_deg=HOME.lon_deg,
            alt_msl_m=400.0,
            height_above_home_m=50.0,
            velocity_ned_mps=(4.0, 0.0, 0.0),
        ),
        now_s,
    )


def hear(
    traffic, own, now_s, name, north_m, counter=0, transport="wifi", speed_mps=6.0, alt_m=447.0, named=True
):
    lat, lon, _ = own.frame.to_geodetic(north_m, 0.0, 0.0)
    place = Location(
        lat_deg=lat,
        lon_deg=lon,
        alt_geodetic_m=alt_m,
        speed_mps=speed_mps,
        direction_deg=180.0,
        vertical_speed_mps=0.0,
        timestamp_s=round(now_s, 1),
    )
    basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.AEROPLANE, uas_id=name)
    heard = RemoteIdHeard(
        transport=transport, address=name, messages=(basic, place) if named else (place,), counter=counter
    )
    traffic.hear(heard, now_s, own.utc_offset_s, own.frame, 47.0 if alt_m is not None else None)


def test_an_observation(own):
    traffic, senses = Traffic(TrafficConfig(), "OWN"), Senses("OWN")
    empty = senses.look(0.0, own, traffic, {})
    assert empty.rows.shape == (0, len(NEIGHBOUR_COLUMNS))
    assert empty.own.shape == (len(OWN_COLUMNS),)
    for k in range(51):
        hear(traffic, own, 0.1 * k, "A", 200.0 - 0.6 * k, k)
        if k % 5 == 0:
            hear(traffic, own, 0.1 * k, "A", 200.0 - 0.6 * k, k // 5, transport="ble4")
            hear(traffic, own, 0.1 * k, "B", 900.0, k // 5, speed_mps=0.0, alt_m=500.0)
    move(own, 5.0)
    seen = senses.look(5.5, own, traffic, {"wifi": 10, "ble5": 2, "nan": 1})
    own_row = dict(zip(OWN_COLUMNS, seen.own, strict=True))
    assert [own_row[f"{t}_rate"] for t in TRANSPORTS] == [0.0, 0.2, 1.0]
    assert [own_row[t] for t in TRANSPORTS] == [0.0, 1.0, 1.0]
    assert own_row["wifi_measured"] == 1.0
    assert own_row["wifi_success"] == 1.0
    assert own_row["ble4_measured"] == own_row["ble4_success"] == 0.0
    assert tuple(seen.own[12:]) == identity_of("OWN")
    a, b = (dict(zip(NEIGHBOUR_COLUMNS, row, strict=True)) for row in seen.rows)
    # Predicted to now: 170 m at 5 s; it comes with 6 m/s, and we went on with 4 m/s.
    assert 10.0 ** (4.0 * a["log_distance"]) == pytest.approx(170.0 - 3.0 - 2.0, abs=0.5)
    assert a["conflict"] == pytest.approx(conflict_weight(np, 165.0, 10.0), rel=0.02)
    assert [a[t] for t in TRANSPORTS] == [1.0, 0.0, 1.0]
    assert a["wifi_rate"] == 1.0
    assert a["ble4_rate"] == pytest.approx(0.2)
    assert 10.0 ** (4.0 * b["log_distance"]) == pytest.approx(np.hypot(898.0, 53.0), abs=0.5)
    assert b["wifi_rate"] == pytest.approx(0.2)


def test_only_who_was_heard_lately_counts(own):
    traffic, senses = Traffic(TrafficConfig(), "OWN"), Senses("OWN")
    hear(traffic, own, 1.0, "A", 200.0)
    assert len(senses.look(1.0 + HEARD_S, own, traffic, {}).rows) == 1
    assert len(senses.look(1.1 + HEARD_S, own, traffic, {}).rows) == 0


def test_an_aircraft_of_several_tracks_is_one_neighbour(own):
    traffic, senses = Traffic(TrafficConfig(), "OWN"), Senses("OWN")
    for k in range(40):
        now_s = 0.1 * k
        hear(traffic, own, now_s, "A", 200.0, k)
        # Nameless on BLE 4 at first: a track of its own until the name comes.
        hear(traffic, own, now_s, "A", 200.0, k, transport="ble4", named=k >= 20)
        if k in (10, 39):
            tracks = len(traffic.tracks)
            seen = senses.look(now_s, own, traffic, {})
            assert (tracks, len(seen.rows)) == (2 if k == 10 else 1, 1)
            assert list(seen.rows[0, 2:5]) == [1.0, 0.0, 1.0]
    assert senses._meter.measure(4.0, [])[1] == (0.0, 0.0, 0.0)


def test_without_a_known_height_distance_is_horizontal(own):
    traffic, senses = Traffic(TrafficConfig(), "OWN"), Senses("OWN")
    hear(traffic, own, 1.0, "A", 200.0, alt_m=None, speed_mps=0.0)
    (row,) = senses.look(1.0, own, traffic, {}).rows
    assert 10.0 ** (4.0 * row[0]) == pytest.approx(200.0 - 4.0, abs=0.1)
