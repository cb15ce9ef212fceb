"""The file server alone, at the level of payloads."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.served import ftp
from companion.autopilot.served.ftp import DATA_BYTES, MOST_SESSIONS, PAYLOAD_BYTES, FileServer, crc32

FILES = {"short.json": b"{}", "long.json": bytes(range(256)) * 3, "even.json": b"x" * (2 * DATA_BYTES)}
NONE, TERMINATE, RESET, LIST, OPEN, READ, CREATE, WRITE, REMOVE, CRC, BURST = (
    0, 1, 2, 3, 4, 5, 6, 7, 8, 14, 15,
)  # fmt: skip
ACK, NAK = 128, 129
DATA_SIZE, SESSION, EOF, UNKNOWN, NOT_FOUND = 3, 4, 6, 7, 10


def request(opcode, data=b"", *, seq=1, session=0, size=None, offset=0):
    head = struct.pack(
        "<HBBBBBBI", seq, session, opcode, len(data) if size is None else size, 0, 0, 0, offset
    )
    return (head + data).ljust(PAYLOAD_BYTES, b"\0")


def said(reply):
    """Opcode and data of a reply."""
    return reply.payload[3], reply.payload[12 : 12 + reply.payload[4]]


def ask(server, opcode, data=b"", client=(255, 190), **fields):
    return server.reply(*client, request(opcode, data, **fields))


def download(server, path, opcode=READ, size=DATA_BYTES, session=0):
    kind, length = said(ask(server, OPEN, path, session=session))
    assert kind == ACK
    content = b""
    while True:
        reply = ask(server, opcode, size=size, offset=len(content), session=session)
        kind, data = said(reply)
        assert reply.payload[6] == (opcode == BURST)
        if kind == NAK:
            assert data == bytes((EOF,))
            assert not reply.refused
            break
        content += data
    assert said(ask(server, TERMINATE, session=session)) == (ACK, b"")
    assert struct.unpack("<I", length) == (len(content),)
    return content


@pytest.mark.parametrize("opcode", [READ, BURST])
@pytest.mark.parametrize("size", [1, 80, DATA_BYTES])
@pytest.mark.parametrize("path", FILES)
def test_a_file_is_read_whole(path, size, opcode):
    assert download(FileServer(FILES), b"/" + path.encode(), opcode, size, session=201) == FILES[path]


@pytest.mark.parametrize("path", [b"short.json", b"/short.json", b"short.json\0", b"short.json\0more"])
def test_a_path_may_begin_with_a_slash_and_end_with_a_zero(path):
    assert download(FileServer(FILES), path) == FILES["short.json"]


def test_a_reply_repeats_what_it_answers():
    reply = ask(FileServer(FILES), OPEN, b"short.json", seq=0xFFFF, session=9).payload
    assert struct.unpack_from("<HBBBBBBI", reply) == (0, 9, ACK, 4, OPEN, 0, 0, 0)
    assert len(reply) == PAYLOAD_BYTES


def test_what_is_asked_again_is_answered_again():
    server = FileServer(FILES)
    for fields in ({"opcode": OPEN, "data": b"long.json"}, {"opcode": READ, "size": 50, "offset": 700}):
        first = ask(server, **fields)
        assert said(first)[0] == ACK
        assert ask(server, **fields) == first


def test_the_checksum_is_mavlinks():
    """mavlink.io, guide/crc: the reflected polynomial 0xEDB88320, from 0, without a final inversion."""

    def bitwise(data):
        crc = 0
        for byte in data:
            crc ^= byte
            for _ in range(8):
                crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
        return crc

    for data in (b"", b"\0\0", *FILES.values()):
        assert crc32(data) == bitwise(data)
    assert said(ask(FileServer(FILES), CRC, b"long.json")) == (
        ACK,
        struct.pack("<I", bitwise(FILES["long.json"])),
    )


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        ({"opcode": OPEN, "data": b"other.json"}, NOT_FOUND),
        ({"opcode": OPEN, "data": b""}, NOT_FOUND),
        ({"opcode": OPEN, "data": b"../short.json"}, NOT_FOUND),
        ({"opcode": OPEN, "data": b"\xff" * DATA_BYTES}, NOT_FOUND),
        ({"opcode": CRC, "data": b"short.jso"}, NOT_FOUND),
        ({"opcode": OPEN, "data": b"short.json", "size": 255}, DATA_SIZE),
        ({"opcode": READ, "size": 10}, SESSION),
        ({"opcode": BURST, "size": 10}, SESSION),
        *(({"opcode": code, "data": b"short.json"}, UNKNOWN) for code in (LIST, CREATE, WRITE, REMOVE, 99)),
    ],
)
def test_what_cannot_be_answered_is_refused_with_the_reason(fields, error):
    reply = ask(FileServer(FILES), **fields)
    assert said(reply) == (NAK, bytes((error,)))
    assert reply.refused
    assert reply.payload[5] == fields["opcode"]


def test_a_read_of_nothing_is_refused():
    server = FileServer(FILES)
    ask(server, OPEN, b"short.json")
    assert said(ask(server, READ, size=0)) == (NAK, bytes((DATA_SIZE,)))


def test_what_is_closed_is_not_read():
    for closing in (TERMINATE, RESET):
        server = FileServer(FILES)
        ask(server, OPEN, b"short.json", session=3)
        assert said(ask(server, closing, session=3)) == (ACK, b"")
        assert said(ask(server, READ, size=2, session=3)) == (NAK, bytes((SESSION,)))


def test_clients_do_not_close_each_others_files():
    server, others = FileServer(FILES), [(255, 190), (254, 190), (255, 191)]
    for client in others:
        ask(server, OPEN, b"short.json", client)
    ask(server, RESET, client=others[0])
    ask(server, TERMINATE, client=others[1])
    assert [said(ask(server, READ, client=client, size=2))[0] for client in others] == [NAK, NAK, ACK]


def test_of_too_many_open_files_the_first_one_is_closed():
    server = FileServer(FILES)
    for session in range(MOST_SESSIONS + 1):
        assert said(ask(server, OPEN, b"short.json", session=session))[0] == ACK
    kinds = [said(ask(server, READ, size=2, session=session))[0] for session in range(MOST_SESSIONS + 1)]
    assert kinds == [NAK] + [ACK] * MOST_SESSIONS


@given(
    st.lists(
        st.one_of(
            st.binary(min_size=PAYLOAD_BYTES, max_size=PAYLOAD_BYTES),
            st.builds(
                request,
                st.integers(0, 20),
                st.sampled_from([b"", b"short.json", b"/long.json", b"\xfe"]),
                seq=st.integers(0, 0xFFFF),
                session=st.integers(0, 255),
                size=st.sampled_from([0, 1, 10, 239, 240, 255]),
                offset=st.sampled_from([0, 1, 700, 0xFFFF_FFFF]),
            ),
        ),
        max_size=30,
    )
)
@settings(max_examples=150, deadline=None)
def test_whatever_comes_there_is_an_answer(requests):
    server = FileServer(FILES)
    for at, payload in enumerate(requests):
        reply = server.reply(255, at % 2, payload)
        kind, data = said(reply)
        assert len(reply.payload) == PAYLOAD_BYTES
        assert ftp.sequence(reply.payload) == (ftp.sequence(payload) + 1) & 0xFFFF
        assert kind in (ACK, NAK)
        assert reply.refused == (kind == NAK and data != bytes((EOF,)))
        assert reply.payload[12 + len(data) :].count(0) == DATA_BYTES - len(data)
    assert len(server._open) <= MOST_SESSIONS
