"""What is published of the aircraft that are heard, when, and with which addresses."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest

from companion.avoidance.law import ASIDE, Neighbour
from companion.events import TrafficReport
from companion.traffic.published import BLOCK, BLOCK_BITS, MOST, PERIOD_S, Publication
from tests.support.place import HOME

HERE = 0.0, 0.0, -50.0


def heard(name: str, north_m: float = 100.0, **more: Any) -> Neighbour:
    values = {"position_ned_m": (north_m, 0.0, -60.0), "velocity_ned_mps": (3.0, 0.0, 0.0)}
    return Neighbour(name, **{**values, "age_s": 1.0, "sigma_m": 3.0, **more})


def published(publication: Publication, now_s: float, *others: Neighbour) -> list[TrafficReport]:
    return publication.due(now_s, HERE, HOME, others)


def one(*others: Neighbour) -> TrafficReport:
    (report,) = published(Publication(), 0.0, *others)
    return report


def number(name: str) -> int:
    """The address that an aircraft would have if it were alone."""
    first = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
    return BLOCK + first % (1 << BLOCK_BITS)


def pair_of_one_address() -> tuple[str, str]:
    seen: dict[int, str] = {}
    for count in range(5000):
        name = f"N{count}"
        if number(name) in seen:
            return seen[number(name)], name
        seen[number(name)] = name
    raise AssertionError


def test_an_aircraft_has_its_own_address_while_it_is_shown() -> None:
    """Of two that would share one the second takes the next; it has its own again once the first is gone."""
    first, second = pair_of_one_address()
    publication = Publication()
    both = heard(first, 100.0), heard(second, 200.0)
    addresses = [published(publication, float(t), *both)[0].icao for t in range(4)]
    assert addresses == [number(first), number(first) + 1] * 2
    assert published(publication, 5.0, both[1])[0].icao == number(second) + 1, "it keeps what it has"
    assert published(publication, 6.0, heard("OTHER"))[0].icao == number("OTHER")
    assert published(publication, 7.0, both[1])[0].icao == number(second)


def test_what_is_remembered_is_what_is_shown() -> None:
    publication = Publication()
    for count in range(100):
        assert len(published(publication, float(count), heard(f"N{count}"))) == 1
    assert (len(publication._addresses), len(publication._sent_s)) == (1, 1)


def test_each_is_reported_once_in_a_period_and_no_two_at_once() -> None:
    publication, others = Publication(), [heard(f"N{count}", 100.0 + count) for count in range(MOST + 3)]
    times = [(0.05 * tick, published(publication, 0.05 * tick, *others)) for tick in range(41)]
    sent = [(at_s, report.callsign) for at_s, reports in times for report in reports]
    assert [at_s for at_s, _ in sent] == pytest.approx([PERIOD_S / MOST * k for k in range(2 * MOST + 1)])
    names = [f"RIDN{count}" for count in range(MOST)]
    assert sorted(name for _, name in sent[:MOST]) == names, "the nearest ones"
    assert [name for _, name in sent[MOST : 2 * MOST]] == [name for _, name in sent[:MOST]]


def test_the_nearest_ones_are_those_to_the_side_whatever_their_height() -> None:
    publication, here = Publication(), (5.0, -400.0, -900.0)
    ways = [(20.0 * k, 0.0) if k % 2 else (0.0, -20.0 * k) for k in range(2 * MOST)]
    places = [(here[0] + n, here[1] + e, -60.0 * (20 - k)) for k, (n, e) in enumerate(ways)]
    others = [heard(f"N{k}", position_ned_m=place) for k, place in enumerate(places)]
    told = [publication.due(0.1 * tick, here, HOME, others[::-1]) for tick in range(MOST)]
    assert {report.callsign for (report,) in told} == {f"RIDN{k}" for k in range(MOST)}


@pytest.mark.parametrize(("age_s", "shown"), [(9.9, True), (10.1, False)])
def test_old_reports_are_not_shown(age_s: float, shown: bool) -> None:
    assert bool(published(Publication(), 0.0, heard("X", age_s=age_s))) is shown


def test_suspected_places_are_not_shown() -> None:
    assert published(Publication(), 0.0, heard(f"X{ASIDE}1")) == []


def test_what_is_told() -> None:
    report = one(heard("1596b-DMU 00042", age_s=-0.3))
    assert (report.lat_deg, report.lon_deg, report.alt_msl_m) == pytest.approx(
        HOME.to_geodetic(100.0, 0.0, -60.0)
    )
    assert (report.callsign, report.velocity_ned_mps, report.age_s) == ("RID00042", (3.0, 0.0, 0.0), 0.0)
    assert one(heard("X", vertical_known=False)).alt_msl_m is None


@pytest.mark.parametrize(("speed_mps", "hovers"), [(0.29, True), (0.31, False)])
def test_a_slow_one_hovers_though_it_climbs(speed_mps: float, hovers: bool) -> None:
    assert one(heard("X", velocity_ned_mps=(0.0, speed_mps, -3.0))).hovers is hovers
