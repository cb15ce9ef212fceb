"""Who gives way to whom: the table, and what Traffic makes of what others say of themselves."""

from __future__ import annotations

import pytest

from companion.config import TrafficConfig
from companion.remote_id.messages import BasicId, IdType, Status, UaType
from companion.traffic.right_of_way import CREWED, FREE, HELPLESS, LIMITED, rank_of, share_of
from companion.traffic.tracks import Traffic
from tests.companion.traffic.flights import Listener, location, straight

RANK_OF_TYPE = {
    UaType.NONE: FREE,
    UaType.AEROPLANE: FREE,
    UaType.HELICOPTER_OR_MULTIROTOR: FREE,
    UaType.GYROPLANE: FREE,
    UaType.HYBRID_LIFT: FREE,
    UaType.ORNITHOPTER: FREE,
    UaType.GLIDER: LIMITED,
    UaType.KITE: HELPLESS,
    UaType.FREE_BALLOON: HELPLESS,
    UaType.CAPTIVE_BALLOON: HELPLESS,
    UaType.AIRSHIP: LIMITED,
    UaType.FREE_FALL_PARACHUTE: HELPLESS,
    UaType.ROCKET: HELPLESS,
    UaType.TETHERED_POWERED_AIRCRAFT: HELPLESS,
    UaType.GROUND_OBSTACLE: HELPLESS,
    UaType.OTHER: FREE,
}
"""All types of ASTM F3411, by the order of ICAO Annex 2, 3.2.2."""


def test_every_type_has_a_rank():
    assert {ua_type: rank_of(ua_type, None) for ua_type in UaType} == RANK_OF_TYPE
    assert rank_of(None, None) == FREE


@pytest.mark.parametrize("ua_type", [None, *UaType])
@pytest.mark.parametrize("status", Status)
def test_distress_goes_before_power(ua_type, status):
    rank = rank_of(ua_type, status)
    assert rank == (HELPLESS if status is Status.EMERGENCY else rank_of(ua_type, None))


@pytest.mark.parametrize(
    ("own", "shares"),
    [
        # To crewed, helpless, limited, free.
        (FREE, (1.0, 1.0, 1.0, 0.5)),
        (LIMITED, (1.0, 1.0, 0.5, 0.5)),
        (HELPLESS, (1.0, 0.5, 0.5, 0.5)),
    ],
)
def test_shares(own, shares):
    """All of the work towards who goes first, half of it towards equals and who gives way to us."""
    assert tuple(share_of(own, other) for other in (CREWED, HELPLESS, LIMITED, FREE)) == shares


def hear(listener, at_s, ua_type=None, **change):
    named = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=ua_type or UaType.NONE, uas_id="X")
    listener.hear(at_s, *([] if ua_type is None else [named]), location(straight(), at_s, **change))
    (neighbour,) = listener.traffic.neighbours(at_s)
    return neighbour


@pytest.mark.parametrize(
    ("own", "other", "share"),
    [
        (UaType.HELICOPTER_OR_MULTIROTOR, UaType.HELICOPTER_OR_MULTIROTOR, 0.5),
        (UaType.HELICOPTER_OR_MULTIROTOR, UaType.GLIDER, 1.0),
        (UaType.HELICOPTER_OR_MULTIROTOR, UaType.FREE_BALLOON, 1.0),
        (UaType.HELICOPTER_OR_MULTIROTOR, None, 0.5),
        (UaType.GLIDER, UaType.GLIDER, 0.5),
        (UaType.GLIDER, UaType.AEROPLANE, 0.5),
        (UaType.GLIDER, UaType.KITE, 1.0),
        (None, UaType.AIRSHIP, 1.0),
    ],
)
def test_the_share_of_a_heard_aircraft(own, other, share):
    listener = Listener()
    listener.traffic = Traffic(TrafficConfig(), "OWN", own)
    assert hear(listener, 10.0, other).share == share


def test_a_type_that_is_told_later_counts_from_then():
    listener = Listener()
    assert hear(listener, 10.0).share == 0.5
    assert hear(listener, 11.0, UaType.GLIDER).share == 1.0


def test_an_emergency_goes_first_while_it_lasts():
    listener = Listener()
    multirotor = UaType.HELICOPTER_OR_MULTIROTOR
    assert hear(listener, 10.0, multirotor).share == 0.5
    assert hear(listener, 11.0, multirotor, status=Status.EMERGENCY).share == 1.0
    assert hear(listener, 12.0, multirotor).share == 0.5
