"""Pages of authentication put together, and signatures in them."""

from __future__ import annotations

import contextlib
import random

import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.authentication import (
    MESSAGE_SET_SIGNATURE,
    UAS_ID_SIGNATURE,
    Assembler,
    AuthenticationData,
    Verifier,
    public_key_hex,
    sign_pages,
    signed_bytes,
    split,
)
from companion.remote_id.codec import decode, decode_pack, encode, encode_pack
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, OperatorId, UaType

UTC_S = 1_767_225_600.0
KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC_HEX = KEY.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()
BASIC = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.AEROPLANE, uas_id="1596F0000DMUCA01")
LOCATION = Location(lat_deg=47.3971234, lon_deg=8.5451234, speed_mps=4.25, timestamp_s=12.3)
MESSAGES = (BASIC, LOCATION, OperatorId(operator_id_type=0, operator_id="CHE87astrdge12k8"))


def content(size, seed=0):
    return random.Random(seed).randbytes(size)


def pages_of(size=64, seed=0, auth_type=1, timestamp_utc_s=UTC_S):
    return split(AuthenticationData(auth_type, timestamp_utc_s, content(size, seed)))


def assembled(assembler, pages, now_s=0.0, source="s"):
    """What the assembler gave, page by page, without the Nones."""
    return [data for page in pages if (data := assembler.add_page(source, page, now_s)) is not None]


@pytest.mark.parametrize(
    ("size", "count"), [(0, 1), (17, 1), (18, 2), (40, 2), (41, 3), (64, 4), (254, 12), (255, 12)]
)
def test_split_and_put_together_over_the_wire(size, count):
    pages = pages_of(size)
    assert len(pages) == count
    heard = [decode(encode(page)) for page in pages]
    assert assembled(Assembler(), heard) == [AuthenticationData(1, UTC_S, content(size))]


def test_more_than_the_length_byte_can_say_is_refused():
    with pytest.raises(ValueError, match="256 bytes"):
        split(AuthenticationData(1, UTC_S, bytes(256)))


@given(st.permutations(range(4)), st.lists(st.integers(0, 3), max_size=4))
def test_any_order_and_repetitions(order, again):
    pages = pages_of()
    heard = [pages[k] for k in (*order, *again)]
    assert assembled(Assembler(), heard)[0] == AuthenticationData(1, UTC_S, content(64))


def test_a_repeated_set_is_given_once():
    assert len(assembled(Assembler(), pages_of() * 5)) == 1


def test_a_new_page_0_starts_anew():
    first, second = pages_of(seed=1), pages_of(seed=2, timestamp_utc_s=UTC_S + 1)
    assembler = Assembler()
    assert not assembled(assembler, first[:3])
    assert not assembled(assembler, [second[0], second[3]])
    assert assembled(assembler, second[1:3]) == [AuthenticationData(1, UTC_S + 1, content(64, 2))]


def test_after_a_lost_page_0_the_next_sets_are_whole_again():
    """Sets that change every time, in order, the second without its page 0."""
    assembler = Assembler()
    given = []
    for k in range(5):
        pages = pages_of(seed=k, timestamp_utc_s=UTC_S + k)
        given += assembled(assembler, pages[1:] if k == 1 else pages, now_s=float(k))
    for k in (0, 2, 3, 4):
        assert AuthenticationData(1, UTC_S + k, content(64, k)) in given
    assert given[-1] == AuthenticationData(1, UTC_S + 4, content(64, 4))


def test_types_and_sources_do_not_mix():
    assembler = Assembler()
    one, three = pages_of(seed=1, auth_type=1), pages_of(seed=2, auth_type=3)
    given = []
    for a, b in zip(one, three, strict=True):
        given += assembled(assembler, [a, b])
    assert {data.auth_type: data.data for data in given} == {1: content(64, 1), 3: content(64, 2)}
    assert not assembled(assembler, pages_of(seed=5)[:2], source="x")
    assert not assembled(assembler, pages_of(seed=5)[2:], source="y")


def test_time_out():
    assembler = Assembler(timeout_s=15.0)
    pages = pages_of()
    assert not assembled(assembler, pages[:3], now_s=0.0)
    assert not assembled(assembler, pages[3:], now_s=15.1)
    assert len(assembled(assembler, pages, now_s=16.0)) == 1


def test_what_no_sound_set_can_be_is_left_alone():
    head = pages_of()[0]
    assembler = Assembler()
    for bad in (
        Authentication(auth_type=1, page=0, data=head.data),
        Authentication(auth_type=1, page=0, data=head.data, last_page=0, length=18),
        Authentication(auth_type=1, page=0, data=head.data, last_page=16, length=18),
        Authentication(auth_type=1, page=9, data=bytes(23)),
    ):
        assert assembler.add_page("s", bad, 0.0) is None


def test_a_flood_is_bounded():
    assembler = Assembler(max_sets=50)
    generator = random.Random(1)
    for k in range(5_000):
        data = encode(pages_of(64, seed=k % 7)[0])
        raw = bytes((0x22, generator.randrange(256))) + (data[2:] if k % 3 else generator.randbytes(23))
        with contextlib.suppress(PeerDataError):
            assembler.add_page(f"s{generator.randrange(300)}", decode(raw), k * 0.01)
    assert len(assembler) == 50
    assert assembler.held_bytes() <= 50 * (17 + 2 * 15 * 23)


# ---------------------------------------------------------------- signatures


@given(st.binary(min_size=23, max_size=23), st.integers(0, 5), st.integers(0, 2))
def test_what_is_encoded_anew_is_what_was_sent(body, kind, version):
    """A signature over our own encoding survives decoding and encoding at the receiver."""
    try:
        sent = encode(decode(bytes((kind << 4 | version,)) + body + b"\0"))
    except (PeerDataError, ValueError):
        return
    assert encode(decode(sent)) == sent


@pytest.mark.parametrize("auth_type", [UAS_ID_SIGNATURE, MESSAGE_SET_SIGNATURE])
def test_a_signature_over_the_air(auth_type):
    pages = sign_pages(KEY, auth_type, BASIC.uas_id, MESSAGES, UTC_S + 0.4)
    assert len(pages) == 4
    heard = decode_pack(encode_pack((*MESSAGES, *pages)))
    (data,) = assembled(Assembler(), [m for m in heard if isinstance(m, Authentication)])
    assert data.timestamp_utc_s == UTC_S
    assert len(data.data) == 64
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX})
    assert verifier.verify(BASIC.uas_id, data, heard)
    assert verifier.judge(BASIC.uas_id, data, heard, UTC_S + 2.0, -1.0, 0.0) is True


def signed(auth_type=MESSAGE_SET_SIGNATURE, messages=MESSAGES, identity=BASIC.uas_id, key=KEY):
    pages = sign_pages(key, auth_type, identity, messages, UTC_S)
    (data,) = assembled(Assembler(), pages)
    return data, (*messages, *pages)


def test_what_the_signatures_cover():
    stamp = (int(UTC_S) - 1_546_300_800).to_bytes(4, "little")
    name = b"1596F0000DMUCA01".ljust(20, b"\0")
    assert signed_bytes(1, BASIC.uas_id, (), UTC_S) == name + stamp == encode(BASIC)[2:22] + stamp
    whole = b"".join(map(encode, MESSAGES)) + stamp
    assert signed_bytes(3, BASIC.uas_id, (*MESSAGES, *pages_of()), UTC_S) == whole


@pytest.mark.parametrize(
    "change",
    [
        lambda d, m: (AuthenticationData(d.auth_type, d.timestamp_utc_s + 1.0, d.data), m),
        lambda d, m: (AuthenticationData(d.auth_type, d.timestamp_utc_s, d.data[:-1] + b"\0"), m),
        lambda d, m: (AuthenticationData(d.auth_type, d.timestamp_utc_s, d.data[:63]), m),
        lambda d, m: (AuthenticationData(d.auth_type, d.timestamp_utc_s, b""), m),
        lambda d, m: (d, (BASIC, Location(lat_deg=47.5, lon_deg=8.5), *m[2:])),
        lambda d, m: (d, m[1:]),
        lambda d, m: (d, (m[1], m[0], *m[2:])),
    ],
)
def test_a_message_set_that_was_changed_fails(change):
    data, heard = signed()
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX})
    assert verifier.verify(BASIC.uas_id, data, heard)
    changed, messages = change(data, heard)
    assert not verifier.verify(BASIC.uas_id, changed, messages)
    assert verifier.judge(BASIC.uas_id, changed, messages, UTC_S, -1.0, 0.0) is False


def test_anothers_key_or_identity_fails():
    other = Ed25519PrivateKey.from_private_bytes(bytes(32))
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX, "OTHER": PUBLIC_HEX})
    data, heard = signed(UAS_ID_SIGNATURE, key=other)
    assert not verifier.verify(BASIC.uas_id, data, heard)
    data, heard = signed(UAS_ID_SIGNATURE)
    assert verifier.verify(BASIC.uas_id, data, heard)
    assert not verifier.verify("OTHER", data, heard)


@pytest.mark.parametrize(
    ("utc_s", "not_before_s", "verdict"),
    [
        (UTC_S + 9.9, 0.0, True),
        (UTC_S + 10.1, 0.0, False),
        (UTC_S - 10.1, 0.0, False),
        (UTC_S, UTC_S, True),
        (UTC_S, UTC_S + 1.0, False),
        (None, 0.0, None),
    ],
)
def test_freshness_and_replay(utc_s, not_before_s, verdict):
    data, heard = signed()
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX}, fresh_s=10.0)
    assert verifier.judge(BASIC.uas_id, data, heard, utc_s, not_before_s, 0.0) is verdict


def test_what_cannot_be_judged_is_not_called_false():
    data, heard = signed()
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX})
    assert verifier.judge("STRANGER", data, heard, UTC_S, 0.0, 0.0) is None
    pages = tuple(m for m in heard if isinstance(m, Authentication))
    assert verifier.judge(BASIC.uas_id, data, pages, UTC_S, 0.0, 0.0) is None, "BLE 4: a page is a frame"
    for foreign in (0, 2, 4, 5, 10, 15):
        other = AuthenticationData(foreign, UTC_S, data.data)
        assert verifier.judge(BASIC.uas_id, other, heard, UTC_S, 0.0, 0.0) is None


def test_no_more_signatures_are_checked_than_the_processor_can_spare():
    data, heard = signed()
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX})
    verdicts = [verifier.judge(BASIC.uas_id, data, heard, UTC_S, 0.0, k * 0.001) for k in range(1000)]
    assert 20 <= verdicts.count(True) <= 41
    assert verdicts.count(False) == 0
    assert verifier.judge(BASIC.uas_id, data, heard, UTC_S, 0.0, 2.0) is True


@pytest.mark.parametrize(
    ("auth_type", "identity", "messages"),
    [(2, "A", MESSAGES), (5, "A", MESSAGES), (1, "", ()), (1, "A" * 21, ()), (1, "☃", ()), (3, "A", ())],
)
def test_what_is_not_signed_is_refused(auth_type, identity, messages):
    with pytest.raises(ValueError):
        sign_pages(KEY, auth_type, identity, messages, UTC_S)


# ---------------------------------------------------------------- keys


def test_keys_as_digits_and_as_files(tmp_path):
    pem = KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (tmp_path / "a.pem").write_bytes(pem)
    assert public_key_hex("a.pem", tmp_path) == PUBLIC_HEX
    assert public_key_hex(PUBLIC_HEX.upper(), tmp_path) == PUBLIC_HEX


def test_bad_keys_are_named(tmp_path):
    rsa_key = rsa.generate_private_key(65537, 2048).public_key()
    (tmp_path / "rsa.pem").write_bytes(rsa_key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    (tmp_path / "text.pem").write_text("hello")
    for text in ("nowhere.pem", "text.pem", PUBLIC_HEX[:-1], "\0", ""):
        with pytest.raises(ConfigError, match="neither 64 hex digits nor a PEM file"):
            public_key_hex(text, tmp_path)
    with pytest.raises(ConfigError, match="an Ed25519 public key is needed"):
        public_key_hex("rsa.pem", tmp_path)
    with pytest.raises(ConfigError, match=r"traffic\.keys.\"A\": 'a\.pem'"):
        Verifier({"A": "a.pem"})
    with pytest.raises(ConfigError, match="1 to 20 Latin-1 characters"):
        Verifier({"A" * 21: PUBLIC_HEX})


def test_twenty_signatures_a_second_are_checked_after_twenty_at_once():
    data, heard = signed()
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX})

    def checked(now_s, count):
        verdicts = [verifier.judge(BASIC.uas_id, data, heard, UTC_S, 0.0, now_s) for _ in range(count)]
        return verdicts.count(True)

    assert checked(100.0, 25) == 20
    assert checked(100.26, 25) == 5
    assert checked(90.0, 25) == 0, "a clock that goes back gives nothing"
    assert checked(900.0, 25) == 20, "a long pause gives no more than twenty"


@pytest.mark.parametrize(("gap_s", "complete"), [(14.9, True), (15.1, False)])
def test_each_page_keeps_a_set_for_fifteen_seconds(gap_s, complete):
    assembler = Assembler()
    given = [assembler.add_page("s", page, gap_s * k) for k, page in enumerate(pages_of())]
    assert (given[-1] is not None) is complete


def test_the_set_that_waited_longest_gives_way():
    assembler = Assembler(max_sets=2)
    for source, page in (("a", 0), ("b", 0), ("a", 1), ("c", 0)):
        assembler.add_page(source, pages_of()[page], 0.0)
    assert len(assembler) == 2
    # Page 0 (17 bytes) and page 1 (23 bytes) of "a", page 0 of "c".
    assert assembler.held_bytes() == 17 + 23 + 17
    assert len(assembled(assembler, pages_of()[2:], source="a")) == 1


def test_a_message_set_needs_all_its_pages_in_one_frame():
    data, heard = signed()
    verifier = Verifier({BASIC.uas_id: PUBLIC_HEX})
    assert verifier.judge(BASIC.uas_id, data, heard, UTC_S, 0.0, 0.0) is True
    assert verifier.judge(BASIC.uas_id, data, heard[:-1], UTC_S, 0.0, 0.0) is None
