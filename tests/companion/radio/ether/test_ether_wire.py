"""Datagrams of the simulated air: what they look like, and what is none."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError, PeerDataError
from companion.radio.ether.datagrams import (
    MAX_DATAGRAM,
    Heard,
    Join,
    Leave,
    Send,
    Welcome,
    decode,
    encode,
    parse_endpoint,
)

ADDRESS = "c2:01:02:03:04:05"


@pytest.mark.parametrize(
    ("datagram", "data"),
    [
        (Join("é"), "4541 01 01 c3a9"),
        (Leave(), "4541 01 02"),
        (Send("ble4", ADDRESS, b"\xff"), "4541 01 03 01 c20102030405 ff"),
        (Send("ble5", ADDRESS, b"\xff"), "4541 01 03 02 c20102030405 ff"),
        (Heard("wifi", ADDRESS, b"\xfe\xff"), "4541 01 04 03 c20102030405 feff"),
        (Heard("nan", ADDRESS, b"\xff"), "4541 01 04 04 c20102030405 ff"),
        (Welcome(258), "4541 01 05 0201"),
    ],
)
def test_the_bytes_are_those_of_the_table(datagram: Send, data: str) -> None:
    assert encode(datagram) == bytes.fromhex(data)
    assert decode(bytes.fromhex(data)) == datagram


@given(st.binary(min_size=1, max_size=1000), st.sampled_from(["ble4", "ble5", "wifi", "nan"]))
def test_any_frame_comes_back(frame: bytes, transport: str) -> None:
    sent = Send(transport, ADDRESS, frame)
    assert decode(encode(sent)) == sent
    assert len(encode(sent)) <= MAX_DATAGRAM


@pytest.mark.parametrize(
    "data",
    [
        "",
        "454101",
        "5841 01 02",
        "4541 02 02",
        "4541 01 00",
        "4541 01 09",
        "4541 01 01",
        "4541 01 01 ff",
        "4541 01 01 0a",
        "4541 01 01" + "61" * 81,
        "4541 01 02 00",
        "4541 01 03",
        "4541 01 03 01 c20102030405",
        "4541 01 03 00 c20102030405 ff",
        "4541 01 03 05 c20102030405 ff",
        "4541 01 03 01 c20102030405" + "00" * 1001,
        "4541 01 05 02",
        "4541 01 05 020100",
    ],
)
def test_what_is_no_datagram_is_the_peers_error(data: str) -> None:
    with pytest.raises(PeerDataError):
        decode(bytes.fromhex(data))


@given(st.binary(max_size=60).map(lambda tail: b"EA\x01" + tail))
def test_any_bytes_are_a_datagram_or_the_peers_error(data: bytes) -> None:
    try:
        datagram = decode(data)
    except PeerDataError:
        return
    assert encode(datagram) == data


@pytest.mark.parametrize(
    "datagram",
    [
        Join(""),
        Join("n" * 81),
        Send("smoke", ADDRESS, b"x"),
        Send("wifi", "c2:00", b"x"),
        Send("wifi", ADDRESS, b""),
        Send("wifi", ADDRESS, b"x" * 1001),
    ],
)
def test_what_the_format_cannot_hold_is_refused(datagram: Send) -> None:
    with pytest.raises(ValueError):
        encode(datagram)


def test_an_endpoint_is_host_and_port() -> None:
    assert parse_endpoint("127.0.0.1:14640", "radio.address") == ("127.0.0.1", 14640)


@pytest.mark.parametrize("text", ["", "127.0.0.1", ":14640", "h:", "h:x", "h:-1", "h:65536", "h:²"])
def test_what_is_no_endpoint_names_the_key(text: str) -> None:
    with pytest.raises(ConfigError, match=r"radio\.address"):
        parse_endpoint(text, "radio.address")
