"""What the ArduRemoteID radio feeds to a module, and when."""

from __future__ import annotations

from collections import Counter

import pytest

from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    OperatorId,
    SelfId,
    Status,
    UaType,
)
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN
from tests.companion.radio.arduremoteid.bench import OURS, UTC_S, Bench, messages

SESSION = BasicId(
    id_type=IdType.SPECIFIC_SESSION,
    ua_type=UaType.HELICOPTER_OR_MULTIROTOR,
    uas_id="\x01\x20\x01\x00\x3f\xfe\x00\x0a\x05\x1d\xeb4\x33\xa8\xf1\x2a\xf8",
)
"""A DRIP entity tag, an IPv6 address of 2001:30::/28."""


def test_each_message_is_fed_once_for_all_transports() -> None:
    bench = Bench()
    bench.radio.configure({BLE4: 1, BLE5: 1, WIFI_BEACON: 1, WIFI_NAN: 1})
    before = Counter(bench.module.received)
    bench.fly(10.0, BLE4, BLE5, WIFI_BEACON, WIFI_NAN)
    fed = bench.module.received - before
    assert {
        name: fed[f"OPEN_DRONE_ID_{name}"] for name in ("BASIC_ID", "LOCATION", "SYSTEM")
    } == dict.fromkeys(("BASIC_ID", "LOCATION", "SYSTEM"), 10)
    # Empty ones of the others, every 5 s from 2 s on.
    assert fed["OPEN_DRONE_ID_SELF_ID"] == fed["OPEN_DRONE_ID_OPERATOR_ID"] == 2
    sent = sum(n for name, n in fed.items() if name.startswith("OPEN_DRONE_ID"))
    assert bench.health().frames_sent == sent
    assert 9 <= fed["HEARTBEAT"] <= 11


def test_what_changed_goes_at_once_and_what_did_not_does_not() -> None:
    bench = Bench()
    first = Location(lat_deg=1.0, lon_deg=2.0, timestamp_s=1.0)
    now = bench.wire.now_s
    for message, ahead_s in ((first, 0.0), (first, 0.05), (Location(timestamp_s=2.0), 0.06), (first, 0.07)):
        bench.radio.broadcast(BLE4, (message,), now + ahead_s)
    assert bench.module.received["OPEN_DRONE_ID_LOCATION"] == 3
    bench.radio.broadcast(BLE4, (first,), now + 0.16)
    assert bench.module.received["OPEN_DRONE_ID_LOCATION"] == 4


def test_a_given_self_id_is_kept_and_never_replaced_by_an_empty_one() -> None:
    bench = Bench()
    bench.fly(2.0, BLE5, more=(SelfId(description_type=0, text="survey"),))
    bench.fly(30.0, BLE5)
    assert SelfId(description_type=0, text="survey") in bench.air()[BLE5].messages
    assert not any(isinstance(m, OperatorId) for m in bench.air()[BLE5].messages)
    assert bench.health().confirmed == {BLE4, BLE5}


def test_authentication_is_not_fed_and_said_to_be_missing() -> None:
    bench = Bench()
    page = Authentication(auth_type=1, page=0, data=b"abc", last_page=0, length=3, timestamp_utc_s=UTC_S)
    bench.fly(3.0, BLE5, more=(page,))
    assert bench.module.received["OPEN_DRONE_ID_AUTHENTICATION"] == 0
    assert any("Authentication is not sent" in text for text in bench.health().missing)


def test_the_full_hour_goes_on_the_air() -> None:
    bench = Bench()
    bench.wire.now_s = 10.0
    for _ in range(30):
        bench.wait(0.1)
        bench.radio.broadcast(BLE5, (Location(lat_deg=1.0, lon_deg=2.0, timestamp_s=0.0),), bench.wire.now_s)
    (location,) = (m for m in bench.air()[BLE5].messages if isinstance(m, Location))
    assert location.timestamp_s == 3600.0


def test_bad_messages_and_transports_are_refused_and_nothing_goes_out() -> None:
    bench = Bench(params={"LOCK_LEVEL": 1.0})
    before = Counter(bench.module.received)
    with pytest.raises(ValueError, match="'wifi'; allowed: ble4, ble5"):
        bench.radio.broadcast(WIFI_BEACON, messages(1.0), bench.wire.now_s)
    with pytest.raises(ValueError, match="speed_mps"):
        bench.radio.broadcast(BLE4, (OURS, Location(speed_mps=1e9)), bench.wire.now_s)
    assert bench.module.received == before
    assert bench.health().frames_sent == 0


def test_what_it_is_left_with_has_no_position() -> None:
    bench = Bench()
    bench.fly(5.0, BLE5)
    bench.radio.close()
    assert bench.wire.closed
    bench.wire.now_s += 5.0
    (location,) = (m for m in bench.air()[BLE5].messages if isinstance(m, Location))
    assert location == Location(status=Status.REMOTE_ID_SYSTEM_FAILURE)


def test_one_that_never_sent_leaves_the_module_alone() -> None:
    bench = Bench()
    bench.wait(5.0)
    bench.radio.close()
    assert not any(name.startswith("OPEN_DRONE_ID") for name in bench.module.received)


@pytest.mark.parametrize("first", [OURS, SESSION])
def test_an_identity_that_the_firmware_would_cut_is_not_fed(first: BasicId) -> None:
    bench = Bench(params={"UAS_TYPE": 0.0, "UAS_ID_TYPE": 0.0}, uas_id="")
    bench.radio.configure({"ble4": 1})
    bench.radio.broadcast(
        "ble4", tuple(dict.fromkeys((first, SESSION, Location(lat_deg=47.3, lon_deg=8.5)))), bench.wire.now_s
    )
    bench.wait(1.0)
    health = bench.health()
    assert (health.ok, health.can_send, health.confirmed) == (False, frozenset(), frozenset())
    assert "the module cuts identities at a zero byte" in health.text
    assert bench.module.flash_writes == []
    assert not {kind for kind in bench.module.received if "DRONE_ID" in kind}
    assert health.frames_sent == 0
