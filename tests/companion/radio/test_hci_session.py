"""A session with a scripted controller: probing, one event a frame, refusals, silence, hostile bytes."""

import random
import re
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.radio.frames_io import FrameSender
from companion.radio.hci.advertising import FrameQueue, HciCounts
from companion.radio.hci.reports import HeardFrame
from companion.radio.hci.session import HciSession
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
from tests.companion.radio.hci_controller import (
    CODED,
    DATA,
    ENABLE,
    EXTENDED,
    FEATURES,
    LEGACY_DATA,
    LEGACY_ENABLE,
    LEGACY_SCAN,
    PARAMETERS,
    RESET,
    SCAN,
    SCAN_PARAMETERS,
    SETS,
    VERSION,
    Controller,
    complete,
    extended_report,
    terminated,
)

ADDRESS = "c2:01:02:03:04:05"
LOCATION = Location(lat_deg=47.5, lon_deg=8.5)
SELF_ID = SelfId(description_type=0, text="survey")
SERIAL = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="A1")
SESSION_ID = BasicId(id_type=IdType.UTM_ASSIGNED_UUID, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="B2")


class Host:
    """A session wired to a controller; nothing moves but by `run` and `wait`."""

    def __init__(self, controller: Controller, *, send: bool = True, listen: bool = True) -> None:
        self.controller = controller
        self.counts = HciCounts()
        self.now_s = 100.0
        self.sender = FrameSender(ADDRESS)
        self.session = HciSession(ADDRESS, send=send, listen=listen, counts=self.counts, now_s=self.now_s)
        self.run()

    def run(self) -> None:
        """Until both have nothing more to say."""
        for _ in range(1000):
            packets = self.session.packets()
            if not packets:
                return
            answer = self.controller.feed(b"".join(packets))
            if answer:
                self.session.receive(answer, self.now_s)
        raise AssertionError("never quiet")

    def wait(self, duration_s: float) -> None:
        """Time passes, in steps as a thread takes them."""
        end_s = self.now_s + duration_s
        while self.now_s < end_s:
            self.now_s = min(end_s, max(self.now_s + 0.001, min(self.session.next_s, self.now_s + 0.25)))
            self.session.tick(self.now_s)
            self.run()

    def broadcast(self, transport: str, *messages: Message) -> list[bytes]:
        frames = self.sender.frames(transport, messages)
        self.session.offer(transport, frames, self.now_s)
        return frames

    def hear(self, *packets: bytes) -> list[HeardFrame]:
        self.session.receive(b"".join(packets), self.now_s)
        heard = list(self.session.heard)
        self.session.heard.clear()
        return heard


# ---------------------------------------------------------------- set-up


def test_set_up_of_a_whole_controller() -> None:
    host = Host(Controller())
    assert host.session.ready
    assert host.session.failure is None
    assert host.session.abilities.missing == []
    assert host.session.can_send == {BLE4, BLE5}
    assert host.session.abilities.hears == {BLE4, BLE5}
    assert host.controller.opcodes()[0] == RESET
    assert host.controller.opcodes().count(RESET) == 1
    parameters = {data[0]: data for opcode, data in host.controller.log if opcode == PARAMETERS}
    assert {handle: (data[1], data[20], data[22]) for handle, data in parameters.items()} == {
        0: (0x10, 1, 1),
        1: (0x00, 3, 3),
    }
    assert host.controller.opcodes()[-1] == SCAN


@pytest.mark.parametrize(
    ("controller", "can_send", "hears", "missing"),
    [
        (Controller(features=EXTENDED), {BLE4}, {BLE4}, "no LE Coded PHY"),
        (Controller(features=0), {BLE4}, {BLE4}, "no LE Extended Advertising"),
        (Controller(features=CODED), {BLE4}, {BLE4}, "no LE Extended Advertising"),
        (Controller(sets=1), {BLE5}, {BLE4, BLE5}, "advertising sets here: 1"),
        (Controller(max_data=31), {BLE4}, {BLE4, BLE5}, "31 bytes of advertising data, 0 messages"),
        (Controller(max_data=191), {BLE4, BLE5}, {BLE4, BLE5}, "191 bytes of advertising data, 7 messages"),
    ],
)
def test_what_a_lesser_controller_lacks_is_said(
    controller: Controller, can_send: set[str], hears: set[str], missing: str
) -> None:
    session = Host(controller).session
    assert session.ready
    assert session.can_send == can_send
    assert session.abilities.hears == hears
    assert len(session.abilities.missing) == 1
    assert missing in session.abilities.missing[0]


def test_a_set_that_the_controller_refuses_is_missing_with_its_reason() -> None:
    class NoCoded(Controller):
        def _answer(self, opcode: int, data: bytes) -> bytes:
            self.status[PARAMETERS] = 0x11 if opcode == PARAMETERS and data[0] == 1 else 0
            return super()._answer(opcode, data)

    session = Host(NoCoded()).session
    assert session.can_send == {BLE4}
    (text,) = session.abilities.missing
    assert "LE Set Extended Advertising Parameters: Unsupported Feature" in text
    assert text.startswith("BLE 5 Long Range is missing")


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Controller(status={FEATURES: 0x01}), "no Bluetooth Low Energy"),
        (Controller(status={RESET: 0x1F}), "Reset: Unspecified Error"),
        (Controller(status={SCAN_PARAMETERS: 0x12}), "LE Set Extended Scan Parameters: Invalid"),
        (Controller(status={SCAN: 0x0C}), "Command Disallowed: legacy and extended commands were mixed"),
        (Controller(status={PARAMETERS: 0x07}), "nothing can be sent: .*Memory Capacity Exceeded"),
        (Controller(sets=0), "nothing can be sent"),
        (Controller(short={SETS}), "an answer of 0 bytes during set-up"),
        (Controller(features=0, commands=bytes(64)), "cannot advertise"),
    ],
)
def test_a_controller_that_cannot_serve_ends_the_session_in_words(controller: Controller, words: str) -> None:
    session = Host(controller).session
    assert not session.ready
    assert session.failure is not None
    assert re.search(words, session.failure)


@pytest.mark.parametrize("opcode", [RESET, VERSION, FEATURES, PARAMETERS, SCAN])
def test_a_controller_that_falls_silent_during_set_up(opcode: int) -> None:
    host = Host(Controller(silent={opcode}))
    host.wait(3.5)
    assert host.session.failure is not None
    assert "no answer to" in host.session.failure
    assert "baud rate" in host.session.failure
    assert host.controller.opcodes().count(RESET) == (3 if opcode == RESET else 1)


def test_somebody_who_is_no_controller_is_told_from_silence() -> None:
    host = Host(Controller(silent={RESET}))
    for _ in range(40):
        host.wait(0.1)
        host.session.receive(b"\xfd\x09\x00\x00mavlink" * 2, host.now_s)
    assert host.session.failure is not None
    assert "only bytes that are no HCI events" in host.session.failure


def test_an_echo_is_no_controller() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    for step in range(50):
        for packet in session.packets():
            session.receive(packet, step / 10)
        session.tick(step / 10)
    assert session.failure is not None
    assert "no HCI events" in session.failure


def test_what_an_earlier_user_left_in_the_line_is_ignored() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    session.receive(extended_report(b"x" * 30)[9:] + complete(ENABLE) + complete(SCAN), 0.0)
    controller = Controller()
    for _ in range(100):
        for packet in session.packets():
            session.receive(controller.feed(packet), 0.0)
    assert session.ready


def test_listening_only_sets_up_no_advertising() -> None:
    host = Host(Controller(), send=False)
    assert host.session.ready
    assert host.session.can_send == set()
    assert not {PARAMETERS, DATA, ENABLE, SETS} & set(host.controller.opcodes())


def test_sending_only_does_not_scan() -> None:
    host = Host(Controller(), listen=False)
    assert host.session.abilities.hears == set()
    assert not {SCAN, SCAN_PARAMETERS, LEGACY_SCAN} & set(host.controller.opcodes())


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
    assert session.failure == "the controller takes no more commands"


def test_silence_is_noticed_even_by_a_listener() -> None:
    host = Host(Controller(), send=False)
    host.wait(60.0)
    assert host.session.failure is None
    host.controller.silent = {VERSION}
    host.wait(4.5)
    assert "no answer to Read Local Version Information" in str(host.session.failure)


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


# ---------------------------------------------------------------- without extended advertising


def test_a_legacy_controller_sends_ble4_by_legacy_commands_only() -> None:
    host = Host(Controller(features=0))
    frames = host.broadcast(BLE4, LOCATION, SELF_ID)
    host.run()
    assert host.controller.log[-1] == (LEGACY_ENABLE, b"\x01")
    host.wait(1.0)
    data = [content[1 : 1 + content[0]] for opcode, content in host.controller.log if opcode == LEGACY_DATA]
    assert data == frames
    switches = [content for opcode, content in host.controller.log if opcode == LEGACY_ENABLE]
    assert switches == [b"\x01", b"\x00"] * 2
    assert host.counts.sent == 2
    assert LEGACY_SCAN in host.controller.opcodes()
    assert all(not 0x2034 <= opcode <= 0x2043 for opcode in host.controller.opcodes())


# ---------------------------------------------------------------- hearing


def test_reports_become_frames_with_transport_address_and_strength() -> None:
    host = Host(Controller())
    ble4 = host.sender.frames(BLE4, [LOCATION])[0]
    ble5 = host.sender.frames(BLE5, [LOCATION, SERIAL])[0]
    heard = host.hear(extended_report(ble4, event_type=0x10, rssi=127), extended_report(ble5, rssi=-91))
    assert heard == [
        HeardFrame(BLE4, "c1:02:03:04:05:06", ble4, None),
        HeardFrame(BLE5, "c1:02:03:04:05:06", ble5, -91.0),
    ]


def test_what_is_not_remote_id_is_left_out() -> None:
    host = Host(Controller())
    assert host.hear(extended_report(b"\x02\x01\x06", event_type=0x10), extended_report(b"")) == []


def test_parts_are_put_together_by_address_and_sid() -> None:
    host = Host(Controller())
    one, two = (host.sender.frames(BLE5, [LOCATION, message])[0] for message in (SERIAL, SELF_ID))
    more = 0x20
    heard = host.hear(
        extended_report(one[:20], event_type=more, sid=1),
        extended_report(two[:30], event_type=more, sid=2),
        extended_report(one[20:40], event_type=more, sid=1),
        extended_report(two[30:], sid=2),
        extended_report(one[40:], sid=1),
    )
    assert [frame.data for frame in heard] == [two, one]


def test_parts_that_are_truncated_late_or_endless_are_dropped() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION, SERIAL])
    more, cut = 0x20, 0x40
    assert (
        host.hear(extended_report(frame[:20], event_type=more), extended_report(frame[20:], event_type=cut))
        == []
    )
    assert host.hear(extended_report(frame)) != []
    host.hear(extended_report(frame[:20], event_type=more))
    host.now_s += 2.0
    assert host.hear(extended_report(frame[20:])) == []
    for _ in range(100):
        assert host.hear(extended_report(frame + bytes(100), event_type=more)) == []
    assert host.hear(extended_report(frame, sid=3)) != []


def test_many_unfinished_advertisements_do_not_grow_memory() -> None:
    host = Host(Controller())
    for number in range(1000):
        host.hear(extended_report(b"x", event_type=0x20, address=number.to_bytes(6, "big")))
    assert len(host.session._reassembler._partial) <= 64


def test_frames_that_nobody_takes_are_bounded() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION])
    for _ in range(1500):
        host.session.receive(extended_report(frame), host.now_s)
    assert len(host.session.heard) == 1024
    assert host.counts.overrun == 1500 - 1024


# ---------------------------------------------------------------- hostile bytes


def test_a_flood_of_garbage_ends_the_session_in_words() -> None:
    host = Host(Controller())
    host.session.receive(b"\xaa" * 5000, host.now_s)
    assert "not HCI events (H4)" in str(host.session.failure)
    assert host.counts.garbage > 4000


def test_a_little_garbage_is_survived() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION])
    host.session.receive(b"\xaa" * 50 + bytes.fromhex("043e030d0900") + b"\x55", host.now_s)
    assert len(host.hear(extended_report(frame))) == 1
    assert host.counts.garbage == 51
    assert host.counts.malformed == 1
    assert host.session.failure is None


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32))
def test_damaged_conversations_only_fail_in_words(seed: int) -> None:
    generator = random.Random(seed)
    controller = Controller()
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    sender = FrameSender(ADDRESS)
    (frame,) = sender.frames(BLE5, [LOCATION, SERIAL])
    now_s = 0.0
    for _ in range(200):
        now_s += generator.choice((0.0, 0.01, 0.1))
        answer = bytearray(controller.feed(b"".join(session.packets())))
        if generator.random() < 0.3:
            answer += extended_report(frame, event_type=generator.choice((0, 0x10, 0x20, 0x40)))
        if answer and generator.random() < 0.2:
            position = generator.randrange(len(answer))
            match generator.randrange(3):
                case 0:
                    answer[position] = generator.randrange(256)
                case 1:
                    del answer[position:]
                case _:
                    answer[position:position] = generator.randbytes(generator.randrange(1, 40))
        session.receive(bytes(answer), now_s)
        session.offer(generator.choice((BLE4, BLE5)), sender.frames(BLE4, [LOCATION, SELF_ID]), now_s)
        session.tick(now_s)
        assert session.next_s >= 0.0
        assert isinstance(session.failure, str | None)
        if session.failure is not None:
            assert session.can_send == set()
            return


@given(st.binary(max_size=600))
def test_any_bytes_leave_the_session_standing(data: bytes) -> None:
    host = Host(Controller())
    host.session.receive(data, host.now_s)
    host.session.tick(host.now_s)
    assert len(host.session.heard) <= 1024
