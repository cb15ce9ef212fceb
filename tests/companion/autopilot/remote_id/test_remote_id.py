"""Remote ID on the autopilot's link: whose word counts, what is heard, what we say as the component."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.remote_id import MAX_HEARD
from companion.autopilot.wire import MavlinkWriter
from companion.events import Event, OperatorData, RemoteIdHeard, RemoteIdModule
from companion.remote_id import codec
from companion.remote_id.messages import (
    BasicId,
    IdType,
    Location,
    OperatorId,
    OperatorLocationType,
    SelfId,
    System,
    UaType,
)
from tests.companion.autopilot.conftest import PX4, Scripted
from tests.support.place import HOME, LAT_E7, LON_E7

EPOCH = 1546300800.0
NO_ID = bytes(20)
MAC = bytes.fromhex("c0ffee123456").ljust(20, b"\0")
TAKEOFF, LIVE, FIXED = 0, 1, 2


def system(
    timestamp: int = 1000,
    *,
    kind: int = LIVE,
    lat: int = 473969000,
    target: int = 0,
    id_or_mac: bytes = NO_ID,
) -> Any:
    return mavlink.MAVLink_open_drone_id_system_message(
        target, 0, id_or_mac, kind, 1, lat, 85449000, 1, 0, -1000.0, -1000.0, 1, 2, 390.0, timestamp
    )


def update(timestamp: int, lat: int = 473969500, target: int = 0) -> Any:
    return mavlink.MAVLink_open_drone_id_system_update_message(target, 0, lat, 85449000, 391.0, timestamp)


def self_id(text: bytes = b"survey", target: int = 0) -> Any:
    return mavlink.MAVLink_open_drone_id_self_id_message(target, 0, NO_ID, 0, text)


def operator_id(text: bytes = b"FIN87astrdge12k8", target: int = 0) -> Any:
    return mavlink.MAVLink_open_drone_id_operator_id_message(target, 0, NO_ID, 0, text)


def location(id_or_mac: bytes = MAC, lat: int = LAT_E7 + 1000, target: int = 0) -> Any:
    return mavlink.MAVLink_open_drone_id_location_message(
        target, 0, id_or_mac, 2, 9000, 500, 0, lat, LON_E7, 430.0, 430.0, 0, 30.0, 10, 5, 0, 4, 12.5, 1
    )


def basic_id(id_or_mac: bytes = MAC) -> Any:
    uas_id = b"1787F04BM23010012345"
    return mavlink.MAVLink_open_drone_id_basic_id_message(0, 0, id_or_mac, 1, 2, uas_id)


def pack(count: int, data: bytes, id_or_mac: bytes = MAC) -> Any:
    return mavlink.MAVLink_open_drone_id_message_pack_message(
        0, 0, id_or_mac, 25, count, data.ljust(225, b"\0")
    )


def station(mav_type: int = 6) -> Any:
    return mavlink.MAVLink_heartbeat_message(mav_type, 8, 0, 0, 4, 3)


def arm_status(status: int = 0, text: bytes = b"") -> Any:
    return mavlink.MAVLink_open_drone_id_arm_status_message(status, text)


def gcs(scripted: Scripted, *messages: Any) -> list[Event]:
    return scripted.says(*messages, system=255, component=190)


def systems(events: list[Event]) -> list[System]:
    assert all(isinstance(event, OperatorData) for event in events)
    return [m for e in events if isinstance(e, OperatorData) for m in e.messages if isinstance(m, System)]


# ---------------------------------------------------------------- heard by a receiver


@pytest.mark.parametrize(("sender", "component"), [(1, 1), (1, 237), (2, 1), (77, 240), (255, 190)])
def test_remote_id_with_an_address_is_heard_from_anybody(
    ardupilot: Scripted, sender: int, component: int
) -> None:
    (event, identity) = ardupilot.says(location(), basic_id(), system=sender, component=component)
    assert isinstance(event, RemoteIdHeard)
    assert (event.transport, event.address) == ("mavlink", "c0:ff:ee:12:34:56")
    (heard,) = event.messages
    assert isinstance(heard, Location)
    assert (heard.lat_deg, heard.speed_mps, heard.direction_deg) == ((LAT_E7 + 1000) / 1e7, 5.0, 90.0)
    assert identity == RemoteIdHeard(
        transport="mavlink",
        address="c0:ff:ee:12:34:56",
        messages=(
            BasicId(
                id_type=IdType.SERIAL_NUMBER,
                ua_type=UaType.HELICOPTER_OR_MULTIROTOR,
                uas_id="1787F04BM23010012345",
            ),
        ),
    )
    assert (ardupilot.link.counts.remote_id_heard, ardupilot.link.counts.foreign) == (2, 0)


def test_an_operator_heard_of_another_aircraft_is_not_ours(ardupilot: Scripted) -> None:
    (event,) = gcs(ardupilot, system(id_or_mac=MAC, target=1))
    assert isinstance(event, RemoteIdHeard)


def test_packs_are_heard_as_far_as_they_can_be_read(ardupilot: Scripted) -> None:
    air = codec.encode(Location(lat_deg=1.0, lon_deg=2.0))
    page = b"\x22\x11".ljust(25, b"x")
    (event,) = ardupilot.says(pack(10, air + page * 8), component=237)
    assert isinstance(event, RemoteIdHeard)
    assert len(event.messages) == 9
    assert ardupilot.link.counts.remote_id_faults > 0
    assert ardupilot.says(pack(0, b""), pack(2, b"\xa2" * 50), component=237) == []
    assert ardupilot.link.counts.bad_values == 1
    assert ardupilot.link.counts.remote_id_heard == 1


def test_values_that_cannot_be_are_counted_and_the_rest_is_heard(ardupilot: Scripted) -> None:
    events = ardupilot.says(location(lat=900000001), location(), component=237)
    assert len(events) == 1
    assert ardupilot.link.counts.bad_values == 1
    assert "Location.lat_deg" in str(ardupilot.link.last_bad)


def test_a_flood_is_bounded(ardupilot: Scripted) -> None:
    flood = ardupilot.says(*[location()] * (MAX_HEARD + 50), component=237)
    assert len(flood) == MAX_HEARD
    assert ardupilot.link.counts.remote_id_dropped == 50
    assert len(ardupilot.says(location(), component=237)) == 1


# ---------------------------------------------------------------- the operator, from a ground station


def test_a_ground_station_tells_who_and_where_the_operator_is(ardupilot: Scripted) -> None:
    gcs(ardupilot, station())
    assert gcs(ardupilot, system(1000), self_id(), operator_id()) == [
        OperatorData(
            messages=(
                System(
                    operator_location_type=OperatorLocationType.LIVE_GNSS,
                    classification_type=1,  # type: ignore[arg-type]
                    operator_lat_deg=47.3969,
                    operator_lon_deg=8.5449,
                    operator_alt_geodetic_m=390.0,
                    category_eu=1,
                    class_eu=2,
                    timestamp_utc_s=EPOCH + 1000,
                ),
            )
        ),
        OperatorData(messages=(SelfId(description_type=0, text="survey"),)),
        OperatorData(messages=(OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),)),
    ]
    assert ardupilot.link.counts.operator_data == 3
    assert ardupilot.link.counts.foreign == 1  # its heartbeat


def test_the_secret_of_a_whole_operator_number_is_left_behind(ardupilot: Scripted) -> None:
    for heard in (
        gcs(ardupilot, operator_id(b"FIN87astrdge12k8-xyz")),
        ardupilot.says(operator_id(b"FIN87astrdge12k8-xyz")),
    ):
        assert heard == [
            OperatorData(messages=(OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),))
        ]


def test_an_update_moves_the_last_system_of_its_sender(ardupilot: Scripted) -> None:
    gcs(ardupilot, system(1000))
    (moved,) = systems(gcs(ardupilot, update(1001, lat=LAT_E7)))
    assert (moved.operator_lat_deg, moved.operator_alt_geodetic_m) == (HOME.lat_deg, 391.0)
    assert (moved.category_eu, moved.timestamp_utc_s) == (1, EPOCH + 1001)
    # Another sender's is its own: nothing but place and time are known.
    (other,) = systems(ardupilot.says(update(1002), system=250, component=190))
    assert (other.category_eu, other.area_count) == (0, 1)
    assert other.operator_location_type is OperatorLocationType.LIVE_GNSS


@pytest.mark.parametrize(
    ("sender", "heartbeat", "target", "taken"),
    [
        (255, None, 0, True),
        (240, None, 0, True),
        (239, None, 0, False),
        (239, None, 1, True),
        (20, 6, 0, True),
        (20, 2, 0, False),
        (20, 2, 1, True),
        (255, 2, 0, False),
        (255, 6, 7, False),
        (2, None, 0, False),
    ],
)
def test_who_is_a_ground_station(
    ardupilot: Scripted, sender: int, heartbeat: int | None, target: int, taken: bool
) -> None:
    if heartbeat is not None:
        ardupilot.says(station(heartbeat), system=sender)
        ardupilot.says(station(18), system=sender, component=191)
    foreign = ardupilot.link.counts.foreign
    events = ardupilot.says(
        system(target=target), self_id(target=target), operator_id(target=target), system=sender
    )
    assert [type(e) for e in events] == [OperatorData] * (3 * taken)
    assert ardupilot.link.counts.foreign - foreign == 3 * (not taken)


def test_a_neighbours_own_broadcast_is_not_our_operator(ardupilot: Scripted) -> None:
    """PX4 sends its own LOCATION and SYSTEM to everybody."""
    ardupilot.heartbeat(system=2)
    assert ardupilot.says(location(NO_ID), system(), update(1), system=2) == []
    assert ardupilot.link.counts.foreign == 4


def test_of_what_a_ground_station_sends_only_the_operators_part_is_taken(ardupilot: Scripted) -> None:
    assert gcs(ardupilot, location(NO_ID), basic_id(NO_ID)) == []
    assert ardupilot.link.counts.foreign == 2
    who = SelfId(description_type=0, text="x")
    own = pack(2, codec.encode(Location()) + codec.encode(who), NO_ID)
    assert gcs(ardupilot, own) == [OperatorData(messages=(who,))]


def test_other_components_of_our_vehicle_are_no_operators(ardupilot: Scripted) -> None:
    for component in (191, 220, 236):
        assert ardupilot.says(system(), self_id(target=1), update(9), component=component) == []
    assert ardupilot.link.counts.foreign == 9


def test_no_operator_before_the_vehicle() -> None:
    scripted = Scripted()
    assert gcs(scripted, system(), arm_status()) == []
    assert scripted.link.counts.foreign == 2


# ---------------------------------------------------------------- the operator, relayed by the autopilot


def test_a_relayed_position_counts_only_when_it_moves_on(ardupilot: Scripted) -> None:
    assert ardupilot.says(system(1000)) == []  # may be an hour old
    (first,) = systems(ardupilot.says(system(1001)))
    assert first.timestamp_utc_s == EPOCH + 1001
    assert [e for _ in range(20) for e in ardupilot.says(system(1001), update(1001))] == []
    (second,) = systems(ardupilot.says(system(1002, lat=473969500)))
    assert (second.operator_lat_deg, second.category_eu) == (47.39695, 1)


def test_a_strangers_operator_that_the_autopilot_took_for_ours_is_not_relayed_as_ours(
    ardupilot: Scripted,
) -> None:
    """ArduPilot stores every SYSTEM, with an address or without; its SYSTEM_UPDATE has no place for one."""
    ardupilot.says(system(1000))
    for second in range(1001, 1010):
        events = ardupilot.says(system(second, lat=475000000, id_or_mac=MAC), update(second, lat=475000000))
        assert [type(event) for event in events] == [RemoteIdHeard]
    assert len(systems(ardupilot.says(system(1010)))) == 1


def test_what_the_autopilot_knows_itself_is_not_the_operators(ardupilot: Scripted, px4: Scripted) -> None:
    for vehicle in (ardupilot, px4):
        for timestamp in range(1000, 1010):
            assert vehicle.says(system(timestamp, kind=TAKEOFF), location(NO_ID), basic_id(NO_ID)) == []
        # ArduPilot before it has been told anything, PX4 without GNSS time.
        assert vehicle.says(system(0), update(0), system(0), update(2748666496)) == []
        assert vehicle.link.counts.unneeded == 34
        assert vehicle.link.counts.bad_values == 0


def test_a_fixed_operator_is_relayed(ardupilot: Scripted) -> None:
    ardupilot.says(system(1, kind=FIXED))
    (fixed,) = systems(ardupilot.says(system(2, kind=FIXED)))
    assert fixed.operator_location_type is OperatorLocationType.FIXED


def test_relayed_identities_are_taken(ardupilot: Scripted) -> None:
    events = ardupilot.says(self_id(), operator_id())
    assert [type(e) for e in events] == [OperatorData, OperatorData]


def test_a_relay_is_not_needed_while_the_ground_station_is_heard_itself(ardupilot: Scripted) -> None:
    for second in range(1000, 1010):
        assert len(systems(gcs(ardupilot, system(second)))) == 1
        assert ardupilot.says(system(second - 1), update(second - 1)) == []
        ardupilot.after(1.0)
    # It has gone: what the autopilot goes on with is old, however long.
    for _ in range(60):
        assert ardupilot.says(update(1009), system(1009)) == []
        ardupilot.after(1.0)
    # It is back, by a way that only the autopilot hears.
    assert len(systems(ardupilot.says(system(1070)))) == 1


# ---------------------------------------------------------------- a transmitter of the vehicle's own


def test_a_module_tells_whether_it_is_ready(ardupilot: Scripted) -> None:
    assert ardupilot.transmitter() == ardupilot.transmitter(component=237) == []
    assert ardupilot.says(arm_status(1, b"missing basic_id message"), component=236) == [
        RemoteIdModule(component_id=236, ready=False, text="missing basic_id message")
    ]
    assert ardupilot.says(arm_status(), component=237) == [RemoteIdModule(component_id=237, ready=True)]
    assert ardupilot.link.counts.module_reports == 2


def test_only_a_component_that_calls_itself_a_transmitter_is_a_module(ardupilot: Scripted) -> None:
    ardupilot.transmitter(system=2)  # a neighbour's
    ardupilot.says(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), component=236)  # a computer
    assert ardupilot.says(arm_status(), component=236) == []
    ardupilot.transmitter()
    assert ardupilot.says(arm_status(), component=236) == [RemoteIdModule(component_id=236, ready=True)]


def test_arm_status_of_ourselves_the_autopilot_and_others_is_no_module(ardupilot: Scripted) -> None:
    for system, component in ((1, 191), (2, 236)):
        ardupilot.transmitter(system, component)
    assert ardupilot.says(arm_status()) == []
    assert ardupilot.says(arm_status(), component=191) == []
    assert ardupilot.says(arm_status(), system=2, component=236) == []
    assert (ardupilot.link.counts.unneeded, ardupilot.link.counts.foreign) == (1, 4)


# ---------------------------------------------------------------- robustness

IDS = [12900, 12901, 12902, 12903, 12904, 12905, 12915, 12918, 12919]


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(IDS),
            st.binary(min_size=1, max_size=255),
            st.sampled_from([1, 2, 255]),
            st.sampled_from([1, 191, 236]),
        ),
        max_size=8,
    )
)
def test_random_payloads_never_raise_and_every_event_can_go_on_the_air(
    pieces: list[tuple[int, bytes, int, int]],
) -> None:
    scripted = Scripted(autopilot=PX4)
    scripted.heartbeat()
    for message_id, payload, sender, component in pieces:
        frame = MavlinkWriter(sender, component).pack_payload(message_id, payload)
        for event in scripted.link.receive(frame, 1.0):
            assert isinstance(event, RemoteIdHeard | OperatorData | RemoteIdModule)
            for message in () if isinstance(event, RemoteIdModule) else event.messages:
                assert len(codec.encode(message)) == 25
