"""Pages of authentication put together, and keys."""

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
from companion.remote_id.authentication import Assembler, AuthenticationData, split
from companion.remote_id.codec import decode, encode
from companion.remote_id.drip.keys import public_key_hex
from companion.remote_id.messages import Authentication

UTC_S = 1_767_225_600.0
KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC_HEX = KEY.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


def content(size, seed=0):
    return random.Random(seed).randbytes(size)


def pages_of(size=64, seed=0, auth_type=1, timestamp_utc_s=UTC_S):
    return split(AuthenticationData(auth_type, timestamp_utc_s, content(size, seed)))


def assembled(assembler, pages, now_s=0.0, source="s"):
    """What the assembler gave, page by page, without the Nones."""
    return [data for page in pages if (data := assembler.add_page(source, page, now_s, 0)) is not None]


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
    assert len(split(AuthenticationData(1, UTC_S, bytes(255)), parity=True)) == 13


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


# ---------------------------------------------------------------- lost pages


def parity_pages(size, seed=0):
    return split(AuthenticationData(5, UTC_S, content(size, seed)), parity=True)


@pytest.mark.parametrize(
    ("size", "count"),
    [(0, 2), (16, 2), (17, 3), (39, 3), (40, 4), (89, 6), (137, 8), (177, 9), (200, 10), (201, 11)],
)
def test_pages_with_parity(size, count):
    """The counts of RFC 9575 appendix B.1 are among these."""
    pages = parity_pages(size)
    assert len(pages) == count
    heard = [decode(encode(page)) for page in pages]
    whole = AuthenticationData(5, UTC_S, content(size))
    for lost in range(1, count):
        left = [page for k, page in enumerate(heard) if k != lost]
        assert [d.data for d in assembled(Assembler(), left)] == [whole.data]
    assert [d.data for d in assembled(Assembler(), heard)] == [whole.data]


def test_two_lost_pages_are_too_many():
    heard = parity_pages(137)
    for first in range(1, 7):
        left = [page for k, page in enumerate(heard) if k not in (first, first + 1)]
        assert not assembled(Assembler(), left)


def test_a_lost_page_without_parity_is_missed():
    assembler = Assembler()
    first, second = pages_of(137, 1), pages_of(137, 2, timestamp_utc_s=UTC_S + 1)
    assert not assembled(assembler, [page for k, page in enumerate(first) if k != 3])
    assert not assembler.gave_up
    assembler.add_page("s", second[0], 0.0)
    assert assembler.gave_up
    assert assembled(assembler, second[1:])
    assembler.add_page("s", first[0], 0.0)
    assert not assembler.gave_up, "the set before was whole"


@pytest.mark.parametrize(
    ("counters", "consistent"),
    [
        (range(4), True),
        ([254, 255, 0, 1], True),
        ([7] * 4, True),
        ([0, 1, 12, 13], False),
        ([None] * 4, False),
        ([0, None, 2, 3], False),
    ],
)
def test_counters_tell_whether_pages_belong_together(counters, consistent):
    assembler = Assembler()
    found = [assembler.add_page("s", p, 0.0, c) for p, c in zip(pages_of(), counters, strict=True)]
    assert found[-1] == AuthenticationData(1, UTC_S, content(64), consistent)


def test_a_flood_of_strangers_does_not_end_a_vouched_set():
    assembler = Assembler(max_sets=20)
    pages = pages_of()
    for page in pages[:-1]:
        assembler.add_page("known", page, 0.0, vouched=True)
    for k in range(1000):
        assembler.add_page(f"stranger {k}", pages[0], 0.001 * k)
    assert len(assembler) == 21
    assert assembler.add_page("known", pages[-1], 1.0, vouched=True) is not None


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
