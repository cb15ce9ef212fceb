"""A session sends: one event a frame, refusals, silence, flow control."""

from __future__ import annotations

from collections import Counter

import pytest

from companion.radio.frames_io import FrameSender
from companion.radio.hci.advertising import FrameQueue, HciCounts
from companion.radio.hci.session import HciSession
from companion.remote_id.codec import decode_payload
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    SelfId,
    System,
    UaType,
)
from companion.remote_id.transports import BLE4, BLE5
from tests.companion.radio.hci.controller import (
    CODED,
    DATA,
    ENABLE,
    EXTENDED,
    LEGACY_DATA,
    RESET,
    SCAN_PARAMETERS,
    VERSION,
    Controller,
    complete,
    extended_report,
    terminated,
)
from tests.companion.radio.hci.host import ADDRESS, LOCATION, SELF_ID, SERIAL, Host

SESSION_ID = BasicId(id_type=IdType.UTM_ASSIGNED_UUID, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="B2")


# ---------------------------------------------------------------- sending


def test_one_advertising_event_for_every_frame_and_locations_first() -> None:
    host = Host(Controller())
    frames = host.broadcast(BLE4, SELF_ID, LOCATION, SERIAL)
    pack = host.broadcast(BLE5, SELF_ID, LOCATION, SERIAL)
    host.run()
    loaded = host.controller.loaded(0)
    assert loaded == [frames[1], frames[0], frames[2]]
    assert host.controller.loaded(1) == pack
    enables = [data for opcode, data in host.controller.log if opcode == ENABLE]
    assert sorted(data[2] for data in enables) == [0, 0, 0, 1]
    assert all(data[0] == 1 and data[5] == 1 for data in enables)
    assert host.counts.sent == 4
    assert host.session.trouble is None


def test_a_newer_frame_replaces_the_one_that_waits_and_locations_overtake() -> None:
    host = Host(Controller(confirms=False))
    host.broadcast(BLE4, SELF_ID)
    host.run()
    host.broadcast(BLE4, SERIAL, LOCATION)
    newer = host.broadcast(BLE4, Location(lat_deg=47.6, lon_deg=8.5))
    host.run()
    host.controller.confirms = True
    host.session.receive(terminated(0), host.now_s)
    host.run()
    assert host.controller.loaded(0)[1] == newer[0]
    assert len(host.controller.loaded(0)) == 3
    assert host.counts.replaced == 1
    assert host.counts.sent == 3


def test_messages_that_stand_side_by_side_do_not_replace_each_other() -> None:
    counts = HciCounts()
    queue = FrameQueue(BLE4, counts)
    pages = [Authentication(auth_type=1, page=page, data=b"x" * 23) for page in (1, 2)]
    queue.put(FrameSender(ADDRESS).frames(BLE4, [SERIAL, SESSION_ID, *pages, System(), SELF_ID]))
    assert len(queue) == 6
    assert counts.replaced == 0


@pytest.mark.parametrize("per_frame", [1, 2, 3, 4])
def test_a_signed_pack_takes_no_message_out_of_the_pack_before(per_frame: int) -> None:
    """On controllers with small packs, several frames wait when the signer's follow them at once."""
    queue, sender = FrameQueue(BLE5, HciCounts()), FrameSender(ADDRESS)

    def put(messages: tuple[Message, ...]) -> None:
        for start in range(0, len(messages), per_frame):
            queue.put(sender.frames(BLE5, messages[start : start + per_frame]))

    signed = tuple(Authentication(auth_type=5, page=page, data=b"x" * 23) for page in range(1, 7))
    put((SERIAL, LOCATION, System(), SELF_ID))
    put((SERIAL, LOCATION, *signed))
    sent: list[Message] = []
    while (frame := queue.pop_frame()) is not None:
        sent += decode_payload(frame[6:])
    assert {type(message) for message in sent} == {BasicId, Location, System, SelfId, Authentication}
    assert [m.page for m in sent if isinstance(m, Authentication)] == [1, 2, 3, 4, 5, 6]


def test_a_newer_pack_replaces_the_one_of_the_same_kinds_that_waits() -> None:
    counts = HciCounts()
    queue, sender = FrameQueue(BLE5, counts), FrameSender(ADDRESS)
    queue.put(sender.frames(BLE5, [SERIAL, LOCATION]))
    newer = sender.frames(BLE5, [SERIAL, Location(lat_deg=47.6, lon_deg=8.5)])
    queue.put(newer)
    assert counts.replaced == 1
    assert queue.pop_frame() == newer[0]
    assert queue.pop_frame() is None


def test_the_queue_is_bounded_and_keeps_the_location() -> None:
    counts = HciCounts()
    queue = FrameQueue(BLE4, counts)
    location = FrameSender(ADDRESS).frames(BLE4, [LOCATION])
    queue.put(location)
    for auth_type in range(16):
        for page in range(1, 5):
            queue.put(
                FrameSender(ADDRESS).frames(
                    BLE4, [Authentication(auth_type=auth_type, page=page, data=b"x" * 23)]
                )
            )
    assert len(queue) == 32
    assert counts.lost == 65 - 32
    assert queue.pop_frame() == location[0]


def test_on_a_controller_slower_than_the_rate_everything_still_goes_out() -> None:
    host = Host(Controller(features=0))
    offered = (SERIAL, LOCATION, SELF_ID, System())
    host.controller.log.clear()
    for step in range(100):  # ten Locations a second, where eight frames fit
        host.broadcast(BLE4, *(offered if step % 10 == 0 else (LOCATION,)))
        host.run()
        host.wait(0.1)
    kinds = Counter(data[7] >> 4 for opcode, data in host.controller.log if opcode == LEGACY_DATA)
    assert all(kinds[kind] >= 9 for kind in (0, 3, 4)), kinds
    assert kinds[1] >= 40


def test_a_location_waits_for_one_other_frame_at_most() -> None:
    queue = FrameQueue(BLE4, HciCounts())
    sender = FrameSender(ADDRESS)
    serial, self_id = sender.frames(BLE4, [SERIAL, SELF_ID])
    location = sender.frames(BLE4, [LOCATION])
    queue.put([serial, self_id])
    taken = []
    for _ in range(5):
        queue.put(location)
        taken.append(queue.pop_frame())
    assert taken == [location[0], serial, location[0], self_id, location[0]]
    queue.put(location)
    assert queue.pop_frame() == location[0]


@pytest.mark.parametrize("status", [0x43, 0x3C, 0x00])
def test_the_end_of_the_event_confirms_it(status: int) -> None:
    host = Host(Controller(terminated_status=status))
    host.broadcast(BLE5, LOCATION)
    host.run()
    assert host.counts.sent == 1


def test_advertising_that_ends_with_an_error_was_not_sent() -> None:
    host = Host(Controller(terminated_status=0x0D))
    host.broadcast(BLE5, LOCATION)
    host.run()
    assert host.counts.sent == 0
    assert host.session.can_send == {BLE4}
    assert host.session.trouble == "BLE 5 Long Range: advertising ended: error code 0x0d"


def test_an_end_that_comes_before_the_answer_counts_once() -> None:
    host = Host(Controller(early=True))
    for _ in range(3):
        host.broadcast(BLE4, LOCATION)
        host.run()
    assert host.counts.sent == 3
    assert len(host.controller.loaded(0)) == 3


def test_ends_that_belong_to_nothing_are_ignored() -> None:
    host = Host(Controller())
    host.session.receive(terminated(0) + terminated(1) + terminated(9), host.now_s)
    host.run()
    assert host.counts.sent == 0


def test_an_event_that_is_never_reported_is_ended_counted_and_overcome() -> None:
    host = Host(Controller(confirms=False))
    host.broadcast(BLE4, LOCATION)
    host.run()
    host.wait(0.6)
    assert host.controller.log[-1] == (ENABLE, bytes.fromhex("000100000000"))
    assert host.counts.unconfirmed == 1
    assert host.counts.sent == 0
    assert host.session.can_send == {BLE5}
    assert "not confirmed" in str(host.session.trouble)
    host.controller.confirms = True
    host.broadcast(BLE4, LOCATION)
    host.run()
    assert host.session.can_send == {BLE4, BLE5}
    assert host.counts.sent == 1


def test_a_trouble_is_forgiven_after_a_while_so_that_the_set_is_tried_again() -> None:
    host = Host(Controller(status={DATA: 0x0C}))
    host.broadcast(BLE4, LOCATION)
    host.run()
    assert host.session.can_send == {BLE5}
    host.wait(5.5)
    assert host.session.can_send == {BLE4, BLE5}
    assert host.session.failure is None


class OneSetBroken(Controller):
    """Its Coded set cannot be switched on; BLE 4 can while `ble4` says so."""

    ble4 = True

    def _answer(self, opcode: int, data: bytes) -> bytes:
        if opcode == ENABLE and data[0] == 1 and (data[2] == 1 or not self.ble4):
            return complete(opcode, 0x07)
        return super()._answer(opcode, data)


def test_a_controller_that_answers_too_slowly_counts_as_unable_until_it_has_sent() -> None:
    host = Host(Controller(), listen=False)
    host.broadcast(BLE4, LOCATION)
    for _ in range(2):  # the answers to Data and Enable
        (command,) = host.session.packets()
        host.now_s += 0.49
        host.session.tick(host.now_s)
        assert host.session.can_send == {BLE4, BLE5}
        answer = host.controller.feed(command)
        host.session.receive(answer, host.now_s)
    assert host.counts.sent == 1
    host.broadcast(BLE4, LOCATION)
    (command,) = host.session.packets()
    assert host.session.next_s <= host.now_s + 1.0
    host.now_s += 1.0
    host.session.tick(host.now_s)
    assert host.session.can_send == {BLE5}
    assert host.session.trouble == "BLE 4: a frame takes longer than 1 s"
    host.session.receive(host.controller.feed(command), host.now_s)
    host.run()
    assert (host.counts.sent, host.session.can_send) == (2, {BLE4, BLE5})


def test_a_set_that_does_not_work_costs_no_other() -> None:
    host = Host(OneSetBroken())
    for _ in range(20):
        host.broadcast(BLE5, LOCATION)
        host.broadcast(BLE4, LOCATION)
        host.run()
        host.wait(0.3)
    assert host.session.failure is None
    assert host.counts.sent == 20
    assert host.session.can_send == {BLE4}
    assert host.session.trouble == "BLE 5 Long Range: Memory Capacity Exceeded"


@pytest.mark.parametrize("still_used", [True, False])
def test_a_reset_is_tried_once_no_set_works(still_used: bool) -> None:
    controller = OneSetBroken()
    host = Host(controller)
    for _ in range(4):
        host.broadcast(BLE5, LOCATION)
        host.broadcast(BLE4, LOCATION)
        host.run()
        host.wait(0.3)
    assert host.session.failure is None
    controller.ble4 = False
    for _ in range(4 if still_used else 20):
        host.broadcast(BLE5, LOCATION)
        if still_used:
            host.broadcast(BLE4, LOCATION)
        host.run()
        host.wait(0.3)
    assert "times in a row" in str(host.session.failure)


@pytest.mark.parametrize("opcode", [DATA, ENABLE])
def test_refused_commands_are_counted_said_and_end_the_session(opcode: int) -> None:
    host = Host(Controller(status={opcode: 0x0C}))
    host.broadcast(BLE5, LOCATION)
    host.run()
    assert host.counts.refused == 1
    assert host.session.can_send == {BLE4}
    assert str(host.session.trouble).startswith("BLE 5 Long Range: Command Disallowed")
    for _ in range(2):
        host.broadcast(BLE5, LOCATION)
        host.run()
    assert "3 times in a row" in str(host.session.failure)
    assert host.session.can_send == set()


def test_a_controller_that_was_reset_behind_our_back_is_noticed() -> None:
    host = Host(Controller())
    host.controller.status = {DATA: 0x42, ENABLE: 0x42}
    for _ in range(3):
        host.broadcast(BLE4, LOCATION)
        host.run()
    assert "the controller forgot its set" in str(host.session.failure)


def test_frames_are_lost_not_kept_once_the_session_has_failed() -> None:
    host = Host(Controller())
    host.session.receive(bytes.fromhex("04100142"), host.now_s)
    assert host.session.failure == "the controller reports a hardware error (0x42)"
    host.broadcast(BLE4, LOCATION, SELF_ID)
    assert host.counts.lost == 2
    assert host.session.packets() == []


def test_a_set_that_is_missing_loses_its_frames() -> None:
    host = Host(Controller(features=EXTENDED))
    host.broadcast(BLE5, LOCATION)
    host.run()
    assert host.counts.lost == 1


# ---------------------------------------------------------------- flow control


def test_one_command_at_a_time() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    controller = Controller()
    seen = 0
    while packets := session.packets():
        assert len(packets) == 1
        seen += 1
        session.receive(controller.feed(packets[0]), 0.0)
    assert session.ready
    assert seen > 10


def test_no_command_without_leave_to_go_on() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    session.packets()
    session.receive(complete(RESET, credit=0), 0.0)
    assert session.packets() == []
    session.tick(1.0)
    assert session.packets() == []
    session.receive(bytes.fromhex("040e03010000"), 1.0)  # Command Complete of no command: leave for one
    assert len(session.packets()) == 1


def test_leave_that_never_comes_ends_the_session() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    session.receive(complete(RESET, credit=0), 0.0)
    session.tick(2.5)
    assert session.failure == "the controller accepts no more commands"


def test_silence_is_noticed_even_by_a_listener() -> None:
    host = Host(Controller(), send=False)
    host.wait(60.0)
    assert host.session.failure is None
    host.controller.silent = {SCAN_PARAMETERS}
    host.wait(4.5)
    assert "no answer to LE Set Extended Scan Parameters" in str(host.session.failure)


def test_silence_is_noticed_where_nothing_listens() -> None:
    host = Host(Controller(), listen=False)
    host.wait(60.0)
    assert host.session.failure is None
    host.controller.silent = {VERSION}
    host.wait(4.5)
    assert "no answer to Read Local Version Information" in str(host.session.failure)


@pytest.mark.parametrize("features", [EXTENDED | CODED, 0])
@pytest.mark.parametrize("sends", [False, True])
def test_a_controller_that_no_longer_scans_is_noticed(features: int, sends: bool) -> None:
    host = Host(Controller(features=features), send=sends)
    for _ in range(60):
        host.hear(extended_report(b"x"))
        if sends:
            host.broadcast(BLE4, LOCATION)
        host.wait(1.0)
    assert host.session.failure is None
    host.controller.scanning = False
    for _ in range(4):
        if sends:
            host.broadcast(BLE4, LOCATION)
        host.wait(1.0)
    assert host.session.failure == "it no longer scans: it was reset"


def test_a_controller_that_takes_scan_parameters_at_any_time_is_left_in_peace() -> None:
    class Lax(Controller):
        def _status(self, opcode: int, data: bytes) -> int:
            return 0

    host = Host(Lax(), send=False)
    host.wait(60.0)
    assert host.session.failure is None
    assert VERSION in host.controller.opcodes()[-3:]


def test_a_legacy_controller_that_was_reset_does_not_advertise_as_another_device() -> None:
    host = Host(Controller(features=0), listen=False)
    host.broadcast(BLE4, LOCATION)
    host.run()
    host.wait(0.5)
    host.controller.reset()
    for _ in range(3):
        host.broadcast(BLE4, LOCATION)
        host.run()
        host.wait(0.5)
    assert host.counts.sent == 1
    assert "Invalid HCI Command Parameters, 3 times in a row" in str(host.session.failure)


def test_silence_while_sending_is_noticed() -> None:
    host = Host(Controller())
    host.controller.silent = {DATA}
    host.broadcast(BLE4, LOCATION)
    host.run()
    host.wait(1.5)
    assert host.session.failure is None
    host.wait(1.0)
    assert "no answer to LE Set Extended Advertising Data" in str(host.session.failure)
    assert host.session.can_send == set()


def test_stop_is_a_reset() -> None:
    host = Host(Controller())
    host.session.stop(host.now_s)
    host.run()
    assert host.session.stopped
    assert host.controller.opcodes()[-1] == RESET
