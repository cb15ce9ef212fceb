"""What a policy sees, in numbers worked out by hand; and that it is told what it sends now."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest

from companion.atmc import chooser
from companion.atmc.actions import SET_ACTIONS, TRANSPORTS
from companion.atmc.choice import Choice
from companion.atmc.observation import (
    IDENTITY_BITS,
    NEIGHBOUR_COLUMNS,
    OWN_COLUMNS,
    conflict_weight,
    identity_of,
    neighbour_rows,
    own_row,
)
from companion.atmc.senses import NEAR_M, SCAN_SHARE, Senses, SuccessMeter
from companion.config import AtmcConfig, IdentityConfig, TrafficConfig
from companion.core import Companion
from companion.events import GlobalPosition, RadioState, RemoteIdHeard, TransportsChosen, VehicleTime
from companion.ownship import Ownship
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.remote_id.region import Region
from companion.traffic.senders.reception import Reception
from companion.traffic.tracks import Traffic
from tests.companion.atmc.policies import policy_file
from tests.support.place import HOME

CONFLICT = NEIGHBOUR_COLUMNS.index("conflict")
UTC_S = 1_767_225_600.0

# distance_m, closing_mps, 2^-(t / 10 s)^2 of the time t until 10 m are left
WEIGHTS = (
    (210.0, 20.0, 0.5),  # 200 m at 20 m/s: 10 s
    (210.0, -20.0, 0.0625),  # it departs, but may turn: 200 m at 10 m/s, 20 s
    (210.0, 0.0, 0.0625),
    (210.0, 9.0, 0.0625),
    (110.0, -20.0, 0.5),  # 100 m at 10 m/s: 10 s
    (310.0, 20.0, 2.0**-2.25),  # 15 s
    (410.0, 20.0, 0.0625),  # 20 s
    (10.0, 20.0, 1.0),  # in conflict now
    (10.0, -20.0, 1.0),
    (2.0, 20.0, 1.0),
)


@pytest.fixture(params=["numpy", "torch"])
def library(request):
    """A module, and what makes its arrays: the aircraft's, and the trainer's."""
    xp = pytest.importorskip(request.param)
    return xp, np.array if xp is np else xp.tensor


# ---------------------------------------------------------------- columns


def test_the_weight_of_a_conflict(library):
    xp, array = library
    distance_m, closing_mps, wanted = map(list, zip(*WEIGHTS, strict=True))
    found = conflict_weight(xp, array(distance_m), array(closing_mps))
    assert found.tolist() == pytest.approx(wanted, rel=1e-6)


def test_a_neighbour_s_row(library):
    xp, array = library
    distance_m = array([100.0, 10_000.0, 0.1])
    rates = array([[10.0, 0.0, 2.0], [0.0, 5.0, 0.0], [0.0, 0.0, 0.0]])
    rows = neighbour_rows(xp, distance_m, array([0.5, 0.25, 1.0]), rates)
    assert rows.tolist() == [
        pytest.approx([0.5, 0.5, 1.0, 0.0, 1.0, 1.0, 0.0, 0.2]),
        pytest.approx([1.0, 0.25, 0.0, 1.0, 0.0, 0.0, 0.5, 0.0]),
        pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    ]


def test_the_own_row_tells_only_a_success_that_is_measured(library):
    xp, array = library
    rates, success = array([0.0, 2.0, 10.0]), array([0.5, 0.6, 0.7])
    measured, identity = array([1.0, 0.0, 1.0]), array([1.0, -1.0, -1.0, 1.0])
    row = own_row(xp, rates, success, measured, identity)
    assert row.tolist() == pytest.approx(
        [0.0, 1.0, 1.0, 0.0, 0.2, 1.0, 0.5, 0.0, 0.7, 1.0, 0.0, 1.0, 1.0, -1.0, -1.0, 1.0]
    )


def test_identities_differ_in_every_bit_independently():
    found = np.array([identity_of(f"DMUCA{number:03}") for number in range(400)])
    assert set(found.ravel()) == {-1.0, 1.0}
    assert len({tuple(row) for row in found}) == 2**IDENTITY_BITS
    assert np.abs(found.mean(0)).max() < 0.2
    for first, second in itertools.combinations(range(IDENTITY_BITS), 2):
        assert abs((found[:, first] * found[:, second]).mean()) < 0.2


# ---------------------------------------------------------------- from tracks


class Scene:
    """An own aircraft that flies north, and others on its line."""

    def __init__(self, north_mps=0.0):
        self.own, self.now_s = Ownship(), 0.0
        self.north_mps = north_mps
        self.traffic, self.senses = Traffic(TrafficConfig(), "OWN"), Senses("OWN")
        self.own.observe(VehicleTime(time_boot_s=0.0, utc_s=UTC_S), 0.0)
        self.place()

    def place(self):
        """The own aircraft is at the origin now."""
        position = GlobalPosition(
            time_boot_s=self.now_s,
            lat_deg=HOME.lat_deg,
            lon_deg=HOME.lon_deg,
            alt_msl_m=400.0,
            height_above_home_m=50.0,
            velocity_ned_mps=(self.north_mps, 0.0, 0.0),
        )
        self.own.observe(position, self.now_s)

    def hear(self, name, north_m, north_mps=0.0, counter=0, transport="wifi"):
        lat, lon, _ = self.own.frame.to_geodetic(north_m, 0.0, 0.0)
        place = Location(
            lat_deg=lat,
            lon_deg=lon,
            alt_geodetic_m=447.0,
            speed_mps=abs(north_mps),
            direction_deg=0.0 if north_mps >= 0.0 else 180.0,
            vertical_speed_mps=0.0,
            timestamp_s=round(self.now_s, 1),
        )
        basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.AEROPLANE, uas_id=name)
        heard = RemoteIdHeard(
            transport=transport, address=name, messages=(basic, place), counter=counter & 0xFF
        )
        self.traffic.hear(heard, self.now_s, self.own.utc_offset_s, self.own.frame, 47.0)

    def look(self):
        return self.senses.look(self.now_s, self.own, self.traffic, {"wifi": 10})


@pytest.mark.parametrize(
    ("own_mps", "north_m", "north_mps", "weight"),
    [
        (0.0, 210.0, -20.0, 0.5),  # it approaches
        (0.0, 210.0, 20.0, 0.0625),  # it departs
        (0.0, -210.0, 20.0, 0.5),
        (0.0, 210.0, 0.0, 0.0625),
        (20.0, 210.0, 0.0, 0.5),  # we approach
        (20.0, -210.0, 0.0, 0.0625),  # we depart
        (20.0, 210.0, 20.0, 0.0625),  # in formation
        (10.0, 210.0, -10.0, 0.5),  # half and half
        (20.0, 410.0, -20.0, 0.5),  # 400 m at 40 m/s
    ],
)
def test_closing_counts_by_the_velocities_of_both(own_mps, north_m, north_mps, weight):
    scene = Scene(own_mps)
    scene.hear("A", north_m, north_mps)
    (row,) = scene.look().rows
    assert row[CONFLICT] == pytest.approx(weight, rel=1e-3)


def listen(scene, senders, seconds=40):
    """Every second, each sender's messages on BLE 4, ten a second, of which one in `step` arrives."""
    for tenth in range(10 * seconds + 1):
        scene.now_s = 0.1 * tenth
        if tenth % 10 == 0:
            scene.place()
        for name, (north_m, step) in senders.items():
            if tenth % step == 0:
                scene.hear(name, north_m, counter=tenth, transport="ble4")
    own = dict(zip(OWN_COLUMNS, scene.look().own, strict=True))
    assert own["ble4_measured"] == 1.0
    return own["ble4_success"]


def test_success_is_that_of_all_senders_that_are_near():
    far = {f"F{k}": (800.0 + 10.0 * k, 20) for k in range(4)}
    near = {f"N{k}": (0.8 * NEAR_M - 10.0 * k, 5 if k == 0 else 10) for k in range(4)}
    wanted = (0.2 + 3 * 0.1) / 4.0 / SCAN_SHARE[0]
    assert listen(Scene(), {**far, **near}) == pytest.approx(wanted, abs=0.01)


def test_where_few_are_near_success_is_that_of_the_nearest_three():
    far = {f"F{k}": (1500.0 + 10.0 * k, 20) for k in range(4)}
    nearest = {f"N{k}": (700.0 - 10.0 * k, 5 if k == 0 else 10) for k in range(3)}
    wanted = (0.2 + 2 * 0.1) / 3.0 / SCAN_SHARE[0]
    assert listen(Scene(), {**far, **nearest}) == pytest.approx(wanted, abs=0.01)


def streams(until_s, step):
    """Eight senders on Wi-Fi for a minute, ten messages a second, of which one in `step` arrived."""
    found = []
    for _ in range(8):
        reception = Reception()
        for number in range(0, 600, step):
            reception.count_frame(number & 0xFF, until_s - 60.0 + 0.1 * number)
        found.append([("wifi", reception)])
    return found


def test_the_best_share_is_slowly_forgotten():
    """All of it at first; to 1 / e after an hour; then as low as the scan's."""
    wifi = TRANSPORTS.index("wifi")
    meter = SuccessMeter()
    assert meter.measure(60.0, streams(60.0, 1))[0][wifi] == pytest.approx(1.0)
    assert meter.measure(160.0, streams(160.0, 5))[0][wifi] == pytest.approx(0.2 * math.exp(100 / 3600))
    assert meter.measure(3660.0, streams(3660.0, 5))[0][wifi] == pytest.approx(0.2 * math.e)
    assert meter.measure(9000.0, streams(9000.0, 5))[0][wifi] == pytest.approx(0.2 / SCAN_SHARE[wifi])


# ---------------------------------------------------------------- in flight


@pytest.fixture
def fly(make_bench):
    """Builds an aircraft that watches, with a policy."""

    def build(policy):
        made = make_bench(use="watch")
        config = msgspec.structs.replace(
            made.core.config,
            identity=IdentityConfig(uas_id="OWN"),
            region=Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5")), location_period_s=1.0),
            atmc=AtmcConfig(period_s=1.0),
        )
        made = type(made)(Companion(config, policy))
        made.extra = [RadioState(can_send=("ble4", "ble5", "wifi"))]
        return made

    return build


def cross(made, seconds):
    """One neighbour after the other, now near, now far."""
    rng = np.random.default_rng(3)
    for k in range(20 * seconds):
        if k % 20 == 0:
            north_m = float(rng.uniform(20.0, 2000.0))
            transport = TRANSPORTS[int(rng.integers(3))]
            place = Location(lat_deg=made.lat_deg + north_m / 111_194.9, lon_deg=made.lon_deg, speed_mps=0.0)
            address = f"c2:{k // 20 % 8:02}"
            made.extra.append(
                RemoteIdHeard(transport=transport, address=address, messages=(place,), counter=k // 20 & 0xFF)
            )
        made.step()


@pytest.fixture
def unguarded(monkeypatch):
    """A policy may choose everything, as among many aircraft (`companion.atmc.audible`)."""
    monkeypatch.setattr(chooser, "CROWD", 0)


@pytest.mark.usefixtures("unguarded")
def test_the_policy_is_told_what_is_on_the_air_now(fly, monkeypatch):
    made = fly(policy_file())
    mind = made.core.chooser._mind
    wanted = [SET_ACTIONS.index(action) for action in ((0, 0, 10), (10, 5, 0), (3, 0, 7), (3, 0, 7))]
    told = []

    def choose(own, rows, allowed, current, agent=0):
        index = wanted[len(told) % len(wanted)]
        told.append(current)
        assert allowed[index]
        return Choice(index, SET_ACTIONS[index])

    monkeypatch.setattr(mind, "choose", choose)
    made.step(240)
    assert len(told) > 8
    # What is configured is none of its actions.
    assert told == [None, *itertools.islice(itertools.cycle(wanted), len(told) - 1)]


@pytest.mark.usefixtures("unguarded")
def test_a_switch_has_its_price_in_flight(fly):
    """What changes with every neighbour when switching costs nothing stays when it costs much."""
    sets = []
    for price in (0.0, 10.0):
        made = fly(policy_file(seed=2, switch_price=price))
        cross(made, 30)
        chosen = [c for _, c in made.log if isinstance(c, TransportsChosen)]
        assert {c.by for c in chosen} == {"policy"}
        sets.append([c.rates for c in chosen])
    assert len(sets[0]) > 3
    assert len(sets[1]) == 1
