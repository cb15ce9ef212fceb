"""The examples that RFC 9575 (appendix B.2 of draft-ietf-drip-auth-49) and RFC 9886 (appendix A) publish."""

from __future__ import annotations

import contextlib
import hashlib

import pytest

from companion.errors import PeerDataError
from companion.remote_id.authentication import Assembler, AuthenticationData, split
from companion.remote_id.codec import decode, encode
from companion.remote_id.drip.det import Det, make_det
from companion.remote_id.drip.evidence import (
    MANIFEST,
    WRAPPER,
    decode_evidence,
    manifest_content,
    read_manifest,
    read_wrapper,
    wrapper_content,
)
from companion.remote_id.drip.hashes import message_hash, orchid_hash
from companion.remote_id.drip.link import decode_link
from tests.support import drip_reader

DET = bytes.fromhex("2001003ffe000105a29b3ff42226c04e")
KEY = bytes.fromhex("b5fef530d450dedb59ebafa18b00d7f5ed0ac08a81975034297bea2b00041813")
MESSAGES = [
    bytes.fromhex(line)
    for line in [
        "0240012001003ffe000105a29b3ff42226c04e000000000000",
        "12000000000000000000000000000000000000000060220000",
        "32004578616d706c652053656c662049440000000000000000",
        "420000000000000000000100000000000000000010ea510900",
        "52004578616d706c65204f70657261746f7220494400000000",
    ]
]
LINK = """
2250078910ea510904314b8564b17e66662001003ffe000105
2251a29b3ff42226c04eb5fef530d450dedb59ebafa18b00d7
2252f5ed0ac08a81975034297bea2b000418132001003ffe00
22530105b82bf1c99d87273103fc83f6ecd9b91842f205c222
2254dd71d8e165ad18ca91daf9299a73eec850c756a7e9be46
2255f51dddfa0f09db7bfdde14eec07c7a6dd1061c1d5ace94
2256d9ad97940d280000000000000000000000000000000000
2257a03b0f7a6feb0d198167045058cfc49f73129917024d22
"""
"""Its SAM type is 4, the number of a Frame, instead of 1. All else of it is as in the text."""
WRAPPED = """
2250078b10ea510902e0dd7c6560115e671200000000000000
22510000000000000000000000000060220000420000000000
2252000000000100000000000000000010ea5109002001003f
2253fe000105a29b3ff42226c04ef0ecad581a030ca790152a
22542f08df5762a463e24a742d1c530ec977bbe0d113697e2b
2255b909d6c7557bdaf1227ce86154b030daadda4a6b8474de
22569a62f6c375020826000000000000000000000000000000
2257f5e8eebcb04f8c2197526053e66c010d5d7297ff7c1fe0
"""
MANIFESTED = """
225008b110ea510903e0dd7c6560115e670000000000000000
2251d57594875f8608b4d61dc9224ecf8b842bd4862734ed01
22522ca2e5f2b8a3e61547b81704766ba3eeb651be7eafc928
22538884e3e28a24fd5529bc2bd4862734ed012ca2e5f2b8a3
2254e61547b81704766ba3eeb62001003ffe000105a29b3ff4
22552226c04efb729846e7d110903797066fd96f49a77c5a48
2256c4c3b330be05bc4a958e9641718aaa31aeabad368386a2
22579ed2dce2769120da83edbcdc0858dd1e357755e7860317
2258e7c06a5918ea62a937391cbfe0983539de1b2e688b7c83
"""
REGISTERED = {
    "2001003ffe0000055e60a1571e91a0b7": "9990d5b04b72a18066d4092b52c7d4994fb7c16bd7e8c1f440ffa8d04ff1e13f",
    "2001003ffe000a056615ee45d42709a0": "ce681e36e1141aeb560d6e76bc796b7b7cb454e463ccb1f12de30a380101803f",
    "2001003ffe000a05260ed4376b256e28": "8233fdaeb5068bc14859d113a0edfcf8dc07814e3dd2765e6b5b82e04d070597",
    "2001003ffe000a05130824699a4bc6b2": "c92e2f9d97e8960f9b5f1654f8b09039f9dadc5bcf061eac4f0cea79e8e877fa",
    DET.hex(): KEY.hex(),
}
"""RFC 9886 figures 11, 15, 17 and 20, and RFC 9575 appendix B.2."""
ENDORSED = [
    "01FADEF6670AEDF6672001003FFE0000055E60A1571E91A0B79990D5B04B72A18066D4092B52C7D4994FB7C16BD7E8C1F440FFA8D04FF1E13F2001003FFE0000055E60A1571E91A0B7BC2F66D4982EBD7B7B5B6A38C313EE99A4F520FDD340DDDF40FDBC86922748896C4B0ABC5023639B669DEE9753BE6D84A9F38940D3CA0A5BD1666E2A4CEE450C",
    "0197E0F667A7EEF6672001003FFE000A056615EE45D42709A0CE681E36E1141AEB560D6E76BC796B7B7CB454E463CCB1F12DE30A380101803F2001003FFE0000055E60A1571E91A0B7EFDEAFA62D1077C9AE539A363CFB70B37680D94FD459F97A4DE610E203A272CB1049BD47B0C4BCCF3614D7429F2F103EF55C013CDAD326B777C1E336F358D40B",
    "010AE1F6671AEFF6672001003FFE000A05260ED4376B256E288233FDAEB5068BC14859D113A0EDFCF8DC07814E3DD2765E6B5B82E04D0705972001003FFE000A056615EE45D42709A088F20AB8890B10320164CE1CF9A51CBD3630A4A9B07BE2893CDEAB0047F4AFD1AF3E350988B1F476B300838064EF0571F53933E58B2C96686905811E731B4D0C",
    "01DCE2F667ECF0F6672001003FFE000A05130824699A4BC6B2C92E2F9D97E8960F9B5F1654F8B09039F9DADC5BCF061EAC4F0CEA79E8E877FA2001003FFE000A05260ED4376B256E2880E7DCF234E29982E64CE3B2159A14C768CE3B0B41D639EA509AFA6D86B03283EB4773252860465AC573D725CDA94511A02A98770B187BAD6F7798BA609AA701",
]
"""RFC 9886 figure 21: four Broadcast Endorsements, each by the one before; the first by itself."""


def pages(text):
    return [bytes.fromhex(line) for line in text.split()]


def assembled(text, leave_out=None):
    assembler = Assembler()
    found = [
        assembler.add_page("s", decode(raw), 0.0, k) for k, raw in enumerate(pages(text)) if k != leave_out
    ]
    return [data for data in found if data is not None]


@pytest.mark.parametrize(("det", "key"), REGISTERED.items())
def test_identities(det, key):
    tag, key = Det(bytes.fromhex(det)), bytes.fromhex(key)
    assert tag.belongs_to(key)
    assert make_det(key, tag.raa, tag.hda) == tag
    assert not tag.belongs_to(bytes(32))
    assert drip_reader.det_is_of(tag.data, key)
    assert not drip_reader.det_is_of(tag.data, bytes(32))


def test_the_parts_of_an_identity():
    tag = Det(bytes.fromhex("2001003ffe000a05130824699a4bc6b2"))
    assert (tag.raa, tag.hda) == (16376, 10)
    assert str(tag) == "2001:3f:fe00:a05:1308:2469:9a4b:c6b2"
    # RFC 9374 section 5: RAA 10 and HDA 20.
    assert Det(bytes.fromhex("200100300280 1405 a3ad19520ad0a69e")).raa == 10
    assert Det(bytes.fromhex("200100300280 1405 a3ad19520ad0a69e")).hda == 20


def test_the_hashes_of_both_readers():
    for size in (0, 1, 25, 167, 168, 169, 228, 400):
        data = bytes(k % 251 for k in range(size))
        assert drip_reader.sponge(data, 0x1F, 16) == hashlib.shake_128(data).digest(16)
        assert message_hash(data) == drip_reader.message_hash(data)
        context = bytes.fromhex("00B5A69C795DF5D5F0087F56843F2C40")
        assert orchid_hash(data) == drip_reader.cshake128(data, 8, context)


@pytest.mark.parametrize("number", range(4))
def test_endorsements(number):
    raw = bytes.fromhex(ENDORSED[number])
    link = decode_link(raw)
    assert link.link() == raw
    assert REGISTERED[link.child.data.hex()] == link.child_key.hex()
    assert link.child.belongs_to(link.child_key)
    parent = bytes.fromhex(REGISTERED[link.parent.data.hex()])
    assert link.is_signed_by(parent)
    assert link.parent.may_endorse(link.child)
    assert link.not_after_utc_s - link.not_before_utc_s == 3600
    for bit in (8, 100, 500, 1087):
        flipped = bytearray(raw)
        flipped[bit // 8] ^= 1 << bit % 8
        with contextlib.suppress(PeerDataError):  # a form that is refused before the signature is checked
            assert not decode_link(bytes(flipped)).is_signed_by(parent)


@pytest.mark.parametrize("text", [LINK, WRAPPED, MANIFESTED])
def test_the_pages_are_made_as_published(text):
    (data,) = assembled(text)
    assert [encode(page) for page in split(data, parity=True)] == pages(text)
    assert drip_reader.payload({raw[1] & 15: raw[2:] for raw in pages(text)}) == data.data


@pytest.mark.parametrize("text", [LINK, WRAPPED, MANIFESTED])
def test_each_lost_page_but_the_first_is_restored(text):
    (data,) = assembled(text)
    for lost in range(1, len(pages(text))):
        assert assembled(text, leave_out=lost) == [data]
    assert assembled(text, leave_out=0) == []


def test_the_manifest():
    (data,) = assembled(MANIFESTED)
    evidence = decode_evidence(data.data)
    assert (evidence.sam_type, evidence.det) == (MANIFEST, Det(DET))
    assert evidence.is_signed_by(KEY)
    assert evidence.encode() == data.data
    hashes = read_manifest(evidence.content)
    # The example sends Basic ID, Location and System a second time, after Self ID and Operator ID.
    order = [MESSAGES[k] for k in (0, 1, 3, 2, 4, 0, 1, 3)]
    assert list(hashes.messages) == [message_hash(message) for message in order]
    (link,) = assembled(LINK)
    assert hashes.link == message_hash(link.data[1:])
    assert manifest_content(hashes.previous, hashes.link, hashes.messages) == evidence.content


def test_the_wrapper():
    (data,) = assembled(WRAPPED)
    evidence = decode_evidence(data.data)
    assert (evidence.sam_type, evidence.det) == (WRAPPER, Det(DET))
    assert evidence.is_signed_by(KEY)
    assert read_wrapper(evidence.content) == (MESSAGES[1], MESSAGES[3])
    assert wrapper_content((MESSAGES[3], MESSAGES[1])) == evidence.content


@pytest.mark.parametrize("text", [WRAPPED, MANIFESTED])
def test_no_bit_can_be_flipped(text):
    (data,) = assembled(text)
    for bit in range(8, 8 * len(data.data), 37):
        flipped = bytearray(data.data)
        flipped[bit // 8] ^= 1 << bit % 8
        with contextlib.suppress(PeerDataError):  # a form that is refused before the signature is checked
            assert not decode_evidence(bytes(flipped)).is_signed_by(KEY)


def test_the_messages_decode_to_what_encodes_to_them():
    for message in MESSAGES:
        assert encode(decode(message)) == message
    assert AuthenticationData(5, None, b"").page_count == 1
