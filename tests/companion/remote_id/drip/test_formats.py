"""What the DRIP readers and writers allow, and what they refuse."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.codec import encode
from companion.remote_id.drip.det import Det, det_of, make_det, parse_det
from companion.remote_id.drip.evidence import (
    DATA_MAX,
    FRAME,
    MANIFEST,
    NO_HASH,
    WRAPPER,
    decode_evidence,
    manifest_content,
    read_manifest,
    read_wrapper,
    sign,
    wrapper_content,
)
from companion.remote_id.drip.keys import public_bytes
from companion.remote_id.drip.link import decode_endorsement, decode_link, endorse
from companion.remote_id.drip.times import EPOCH_S, pack_window, unpack_window
from companion.remote_id.drip.trust import Trust
from companion.remote_id.messages import BasicId, IdType, Location, UaType

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER = Ed25519PrivateKey.from_private_bytes(bytes(32))
DET = make_det(public_bytes(KEY), 16376, 10)
REGISTRY = make_det(public_bytes(OTHER), 16376, 10)
NOW_S = 1_767_225_600


@given(st.integers(0, 16383), st.integers(0, 16383))
def test_an_identity_and_its_forms(raa, hda):
    det = make_det(public_bytes(KEY), raa, hda)
    assert (det.raa, det.hda) == (raa, hda)
    assert parse_det(str(det)) == det
    assert det_of(det.identity) == det
    assert det.belongs_to(public_bytes(KEY))
    assert not Det(det.data[:15] + bytes((det.data[15] ^ 1,))).belongs_to(public_bytes(KEY))


@pytest.mark.parametrize(
    ("raa", "hda", "key"),
    [(-1, 0, bytes(32)), (0, 16384, bytes(32)), (16384, 0, bytes(32)), (0, 0, bytes(31))],
)
def test_authorities_and_keys_out_of_range(raa, hda, key):
    with pytest.raises(ValueError):
        make_det(key, raa, hda)


def test_what_is_no_identity():
    for data in (
        b"",
        DET.data[:15],
        b"\x20\x01\x00\x40" + DET.data[4:],
        DET.data[:7] + b"\x06" + DET.data[8:],
    ):
        with pytest.raises(PeerDataError):
            Det(data)
    for text in ("", "1596F0000DMUCA01", "\x02" + DET.identity[1:], DET.identity + "x", "\x01☃"):
        assert det_of(text) is None
    for text in ("fe80::1", "2001:30::", "x"):
        with pytest.raises(ValueError):
            parse_det(text)


def test_a_det_in_a_basic_id_is_the_published_form():
    """RFC 9886 figure 21: type 1, then the DET."""
    told = BasicId(id_type=IdType.SPECIFIC_SESSION, ua_type=UaType.NONE, uas_id=DET.identity)
    assert encode(told)[1:19] == b"\x40\x01" + DET.data


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=11), st.binary(min_size=8, max_size=8))
def test_manifests(hashes, previous):
    content = manifest_content(previous, NO_HASH, hashes)
    made = sign(KEY, DET, MANIFEST, content, NOW_S, NOW_S + 120)
    assert len(made.encode()) <= DATA_MAX
    held = decode_evidence(made.encode())
    assert held == made
    assert held.is_signed_by(public_bytes(KEY))
    assert not held.is_signed_by(public_bytes(OTHER))
    read = read_manifest(held.content)
    assert (read.previous, list(read.messages)) == (previous, hashes)


def test_a_manifest_that_contradicts_itself():
    content = manifest_content(NO_HASH, NO_HASH, [b"12345678"])
    for wrong in (content[:-1], content[:16], content[:-8] + b"87654321", b""):
        with pytest.raises(PeerDataError):
            read_manifest(wrong)
    with pytest.raises(ValueError, match="12 hashes"):
        manifest_content(NO_HASH, NO_HASH, [NO_HASH] * 12)


def test_wrappers():
    messages = [encode(Location()), encode(BasicId(id_type=IdType.NONE, ua_type=UaType.NONE, uas_id=""))]
    content = wrapper_content(messages)
    assert read_wrapper(content) == (messages[1], messages[0])
    attached = sign(KEY, DET, WRAPPER, content, NOW_S, NOW_S + 120, in_pack=True)
    held = decode_evidence(attached.encode())
    assert held.content == b""
    assert held.is_signed_by(public_bytes(KEY), content)
    assert not held.is_signed_by(public_bytes(KEY))
    for wrong in ([], messages * 3, [b"\x20" + bytes(24)], [bytes(24)]):
        with pytest.raises(ValueError):
            wrapper_content(wrong)
    for wrong in (content[1:], content * 3, messages[0] + messages[1], b"\x20" + bytes(24)):
        with pytest.raises(PeerDataError):
            read_wrapper(wrong)


def test_what_is_no_evidence():
    good = sign(KEY, DET, FRAME, b"\xf0", NOW_S, NOW_S).encode()
    assert decode_evidence(good).content == b"\xf0"
    for wrong in (good[:88], b"\x05" + good[1:], b"\x01" + good[1:], good + bytes(201), good[:20]):
        with pytest.raises(PeerDataError):
            decode_evidence(wrong)
    with pytest.raises(ValueError, match="113 bytes"):
        sign(KEY, DET, FRAME, bytes(113), NOW_S, NOW_S)
    with pytest.raises(ValueError, match="2019"):
        sign(KEY, DET, FRAME, b"", EPOCH_S - 1, NOW_S)


def test_the_lengths_of_evidence_are_those_of_the_standard():
    """201 bytes are nine pages; one more is refused."""
    longest = sign(KEY, DET, FRAME, bytes(112), NOW_S, NOW_S + 1).encode()
    assert len(longest) == 201
    assert decode_evidence(longest).content == bytes(112)
    with pytest.raises(PeerDataError, match="202 bytes"):
        decode_evidence(longest + b"\0")


@pytest.mark.parametrize("count", [1, 4])
def test_a_wrapper_holds_one_to_four_messages(count):
    messages = [encode(Location(lat_deg=47.0 + k, lon_deg=8.0)) for k in range(count)]
    assert read_wrapper(wrapper_content(messages)) == tuple(messages)
    for wrong in ([], messages * 5):
        with pytest.raises(ValueError, match="messages in a Wrapper"):
            wrapper_content(wrong)


def test_times_end_with_four_bytes():
    last_s = EPOCH_S + 2**32 - 1
    assert unpack_window(pack_window(EPOCH_S, last_s)) == (EPOCH_S, last_s)
    for wrong_s in (EPOCH_S - 1, last_s + 1):
        with pytest.raises(ValueError, match="2019"):
            pack_window(wrong_s, last_s)
        with pytest.raises(ValueError, match="2019"):
            pack_window(EPOCH_S, wrong_s)


def test_endorsements():
    made = endorse(OTHER, REGISTRY, DET, public_bytes(KEY), NOW_S, NOW_S + 60)
    assert decode_link(made.link()) == made == decode_endorsement(made.encode())
    assert made.is_signed_by(public_bytes(OTHER))
    assert not made.is_signed_by(public_bytes(KEY))
    with pytest.raises(ValueError, match="not the DRIP entity tag"):
        endorse(OTHER, REGISTRY, DET, public_bytes(OTHER), NOW_S, NOW_S + 60)
    elsewhere = make_det(public_bytes(KEY), 16376, 11)
    with pytest.raises(ValueError, match="may not endorse"):
        endorse(OTHER, REGISTRY, elsewhere, public_bytes(KEY), NOW_S, NOW_S + 60)
    assert make_det(public_bytes(OTHER), 16376, 4096).may_endorse(elsewhere)
    for wrong in (made.encode(), made.link()[:-1], b""):
        with pytest.raises(PeerDataError):
            decode_link(wrong)


# ---------------------------------------------------------------- whom to trust


def test_only_an_anchor_endorses():
    trust = Trust({}, {str(REGISTRY): public_bytes(OTHER).hex()})
    made = endorse(OTHER, REGISTRY, DET, public_bytes(KEY), NOW_S, NOW_S + 60)
    assert trust.key_of(DET.identity, NOW_S) is None
    assert trust.judges(DET.identity)
    assert trust.wants(made)
    assert trust.learn(made)
    assert trust.key_of(DET.identity, NOW_S) == public_bytes(KEY)
    assert trust.key_of(DET.identity, NOW_S + 61) is None
    assert not trust.wants(made)
    third = Ed25519PrivateKey.from_private_bytes(b"3" * 32)
    child = make_det(public_bytes(third), 16376, 10)
    assert not trust.wants(endorse(KEY, DET, child, public_bytes(third), NOW_S, NOW_S + 60))


def test_an_older_endorsement_takes_nothing_back():
    trust = Trust({}, {str(REGISTRY): public_bytes(OTHER).hex()})
    older = endorse(OTHER, REGISTRY, DET, public_bytes(KEY), NOW_S, NOW_S + 60)
    newer = endorse(OTHER, REGISTRY, DET, public_bytes(KEY), NOW_S, NOW_S + 600)
    assert trust.learn(newer)
    assert trust.learn(older)
    assert trust.key_of(DET.identity, NOW_S + 300) == public_bytes(KEY)


def test_a_forged_endorsement_is_not_learned():
    trust = Trust({}, {str(REGISTRY): public_bytes(OTHER).hex()})
    forged = endorse(KEY, REGISTRY, DET, public_bytes(KEY), NOW_S, NOW_S + 60)
    assert trust.wants(forged)
    assert not trust.learn(forged)
    assert trust.key_of(DET.identity, NOW_S) is None


def test_learned_keys_are_bounded():
    trust = Trust({}, {str(REGISTRY): public_bytes(OTHER).hex()})
    for k in range(600):
        key = Ed25519PrivateKey.from_private_bytes(k.to_bytes(32))
        det = make_det(public_bytes(key), 16376, 10)
        assert trust.learn(endorse(OTHER, REGISTRY, det, public_bytes(key), NOW_S, NOW_S + 60))
    assert len(trust) == 512


def test_configured_keys():
    trust = Trust({"SERIAL": public_bytes(KEY).hex(), str(DET): public_bytes(KEY).hex()}, {})
    assert trust.key_of("SERIAL", NOW_S) == trust.key_of(DET.identity, NOW_S) == public_bytes(KEY)
    assert trust.may_own("SERIAL", DET)
    assert not trust.may_own("SERIAL", REGISTRY)
    assert trust.owner("SERIAL") is None
    trust.note_owner("SERIAL", DET)
    assert trust.owner("SERIAL") == DET
    assert not Trust({}, {})


@pytest.mark.parametrize(
    ("keys", "anchors", "words"),
    [
        ({"A": "a.pem"}, {}, r"traffic\.keys.\"A\": 'a\.pem'"),
        ({"A" * 21: public_bytes(KEY).hex()}, {}, "1 to 20 Latin-1 characters"),
        ({str(DET): public_bytes(OTHER).hex()}, {}, "not the key of"),
        ({}, {"HDA": public_bytes(OTHER).hex()}, r"traffic\.anchors.\"HDA\": 'HDA': not a DRIP entity tag"),
        ({}, {str(REGISTRY): public_bytes(KEY).hex()}, "not the key of"),
        ({}, {str(REGISTRY): "ab"}, "64 hex digits"),
    ],
)
def test_wrong_entries_are_named(keys, anchors, words):
    with pytest.raises(ConfigError, match=words):
        Trust(keys, anchors)
