"""The schedule follows the wanted rates and the transports that work."""

from __future__ import annotations

from companion.broadcast.schedule import Schedule
from companion.remote_id.messages import BasicId, Location
from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4, WIFI_BEACON

KINDS = frozenset({BasicId, Location})


def sends(schedule, rates, can_send, first_s, last_s):
    """How often each transport sends Location, in steps of 50 ms."""
    count = dict.fromkeys((BLE4, WIFI_BEACON), 0)
    for tick in range(round((last_s - first_s) / 0.05)):
        for transport, kinds in schedule.due(rates, can_send, 6, KINDS, first_s + 0.05 * tick):
            count[transport] += Location in kinds
    return count


def test_a_transport_that_no_longer_works_is_not_sent_on_though_the_rates_stay():
    schedule, rates = Schedule(Region(), "A"), {BLE4: 5, WIFI_BEACON: 5}
    before = sends(schedule, rates, frozenset(rates), 0.0, 2.0)
    assert min(before.values()) >= 9
    after = sends(schedule, rates, frozenset({BLE4}), 2.0, 4.0)
    assert after[WIFI_BEACON] == 0
    assert after[BLE4] >= 9


def test_a_new_rate_holds_from_then_on():
    schedule, can_send = Schedule(Region(), "A"), frozenset({BLE4})
    assert sends(schedule, {BLE4: 2}, can_send, 0.0, 4.0)[BLE4] in (8, 9)
    assert 38 <= sends(schedule, {BLE4: 10}, can_send, 4.0, 8.0)[BLE4] <= 42
