"""What is said of signed and unsigned senders, and which signatures are refused by which name."""

from __future__ import annotations

import random

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from companion.config import TrafficConfig
from companion.events import RemoteIdHeard
from companion.remote_id.authentication import AuthenticationData, split
from companion.remote_id.codec import decode, encode, encode_pack
from companion.remote_id.drip.det import make_det
from companion.remote_id.drip.evidence import (
    FRAME,
    MANIFEST,
    NO_HASH,
    WRAPPER,
    manifest_content,
    sign,
    wrapper_content,
)
from companion.remote_id.drip.hashes import message_hash
from companion.remote_id.drip.keys import public_bytes
from companion.remote_id.drip.link import endorse
from companion.remote_id.messages import IdType
from companion.traffic.plausibility import Flag
from companion.traffic.signatures import Verdict
from tests.companion.traffic.flights import (
    SEPARATION_M,
    UTC_OFFSET_S,
    Listener,
    basic,
    fly,
    location,
    seconds,
    straight,
)
from tests.support.place import HOME

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER = Ed25519PrivateKey.from_private_bytes(bytes(32))
REGISTRY = Ed25519PrivateKey.from_private_bytes(b"r" * 32)
PUBLIC = public_bytes(KEY)
DET = make_det(PUBLIC, 16376, 10)
REGISTRY_DET = make_det(public_bytes(REGISTRY), 16376, 10)
KEYS = {"X": PUBLIC.hex()}
ANCHORS = {str(REGISTRY_DET): public_bytes(REGISTRY).hex()}


def as_sent(*messages):
    return tuple(decode(encode(message)) for message in messages)


def manifest(parts, t, key=KEY, det=DET, age_s=0.0, valid_s=120, previous=NO_HASH):
    """Pages of a Manifest over encoded messages or packs, signed at time `t` less `age_s`."""
    begin = int(UTC_OFFSET_S + t - age_s)
    content = manifest_content(previous, NO_HASH, [message_hash(part) for part in parts])
    evidence = sign(key, det, MANIFEST, content, begin, begin + valid_s)
    return split(AuthenticationData(5, float(begin), evidence.encode()))


def wrapper(messages, t, key=KEY, det=DET, *, in_pack=False):
    begin = int(UTC_OFFSET_S + t)
    content = wrapper_content([encode(m) for m in messages])
    evidence = sign(key, det, WRAPPER, content, begin, begin + 120, in_pack=in_pack)
    return split(AuthenticationData(5, float(begin), evidence.encode()))


def link(days=1, key=REGISTRY, child_key=KEY, begin_s=0.0):
    child = make_det(public_bytes(child_key), 16376, 10)
    begin = int(UTC_OFFSET_S + begin_s)
    made = endorse(key, REGISTRY_DET, child, public_bytes(child_key), begin, begin + 86_400 * days)
    return split(AuthenticationData(5, None, made.link()))


def signed_flight(listener, times_s, identity=None, north_m=200.0, address="a", change=None, **signing):
    """A pack with a Location, and half a second later a pack with the Manifest over it."""
    identity = basic() if identity is None else identity
    for t in times_s:
        messages = as_sent(identity, location(straight(north_m=north_m), t))
        pages = manifest([encode_pack(messages)], t, **signing)
        listener.hear(t + 0.2, *messages, address=address)
        listener.hear(t + 0.7, *(pages if change is None else change(pages)), address=address)


def counted(listener):
    return dict(listener.traffic.signatures.counts)


# ---------------------------------------------------------------- what is proven


def test_signed():
    listener = Listener(keys=KEYS)
    signed_flight(listener, seconds(20))
    assert listener.flags() == {Flag.SIGNED}
    assert [r.flag for r in listener.reports] == ["signed"]
    assert listener.traffic.tracks["X"].proven
    assert counted(listener) == {Verdict.VALID: 20}
    fly(listener, straight(), seconds(20, 30.0))
    assert listener.flags() == {Flag.UNSIGNED}
    assert not listener.traffic.tracks["X"].proven


def test_an_aircraft_whose_registry_is_trusted():
    """Its key arrives over the air; its identity is the DRIP entity tag itself."""
    listener = Listener(anchors=ANCHORS)
    session = basic(DET.identity, IdType.SPECIFIC_SESSION)
    signed_flight(listener, seconds(3), session)
    assert counted(listener) == {Verdict.UNKNOWN_KEY: 3}
    assert listener.ever == set()
    listener.hear(14.0, *link())
    signed_flight(listener, seconds(5, 15.0), session)
    assert listener.flags(DET.identity) == {Flag.SIGNED}
    assert listener.traffic.tracks[DET.identity].proven


@pytest.mark.parametrize("in_pack", [True, False])
def test_wrappers_prove_as_well(in_pack):
    listener = Listener(keys=KEYS)
    for t in seconds(5):
        messages = as_sent(basic(), location(straight(), t))
        pages = wrapper(messages, t, in_pack=in_pack)
        if in_pack:
            listener.hear(t + 0.2, *messages, *pages)
        else:
            listener.hear(t + 0.2, *messages)
            listener.hear(t + 0.3, *pages)
    assert listener.flags() == {Flag.SIGNED}


def test_signed_page_by_page_on_ble4():
    """A page is a frame, between the others."""
    listener = Ble4(keys=KEYS)
    for t in seconds(12):
        listener.fly(t)
        listener.pages(t, manifest([encode(listener.last)], t))
    assert listener.flags() == {Flag.SIGNED}
    assert listener.traffic.tracks["X"].latest.authentication.auth_type == 5


class Ble4(Listener):
    """Frames with one message each, counted by type."""

    counters: dict[type, int]

    def __init__(self, **config):
        super().__init__(**config)
        self.counters = {}
        self.last = None

    def one(self, now_s, message):
        kind = type(message)
        self.counters[kind] = (self.counters.get(kind, -1) + 1) & 0xFF
        heard = RemoteIdHeard(transport="ble4", address="a", messages=(message,), counter=self.counters[kind])
        self.traffic.hear(heard, now_s, self.utc_offset_s, HOME, SEPARATION_M)
        self.ever |= {flag for track in self.traffic.tracks.values() for flag in track.flags}

    def fly(self, t):
        self.last = location(straight(), t)
        self.one(t + 0.1, basic())
        self.one(t + 0.2, self.last)

    def pages(self, t, pages, lost=()):
        for k, page in enumerate(pages):
            if k in lost:
                self.counters[type(page)] = (self.counters.get(type(page), -1) + 1) & 0xFF
            else:
                self.one(t + 0.25 + 0.05 * k, page)


def test_unsigned_only_where_a_key_is_known():
    listener = Listener(keys=KEYS)
    fly(listener, straight(), seconds(20))
    fly(listener, straight(north_m=500.0), seconds(20), identity="Y", address="y")
    assert listener.flags() == {Flag.UNSIGNED}
    assert listener.flags("Y") == frozenset()


def test_a_signer_is_not_called_unsigned_before_it_could_sign():
    listener = Listener(keys=KEYS)
    fly(listener, straight(), seconds(8))
    signed_flight(listener, seconds(8, 18.0))
    assert listener.ever == {Flag.SIGNED}


def test_without_our_own_utc_nobody_is_called_unsigned():
    listener = Listener(utc_offset_s=None, keys=KEYS)
    signed_flight(listener, seconds(20))
    assert listener.ever == set()


def test_signatures_say_nothing_without_keys():
    listener = Listener()
    signed_flight(listener, seconds(20))
    assert listener.ever == set()
    assert listener.traffic.signatures is None
    assert len(listener.traffic.tracks["X"].latest.authentication.data) == 121
    listener, frame = Listener(keys=KEYS), AuthenticationData(5, None, bytes((FRAME, *range(100))))
    listener.hear(10.0, basic(), *split(frame))
    assert counted(listener) == {}, "a kind of evidence that is not judged"


def test_a_signed_liar_is_judged_like_any_other():
    """Its positions do not follow its velocity: it is flagged, and it stays a neighbour."""
    listener = Listener(keys=KEYS)
    for t in seconds(30):
        lie = location(straight(speed_mps=0.0), t, speed_mps=40.0, direction_deg=0.0)
        messages = as_sent(basic(), lie)
        listener.hear(t + 0.2, *messages)
        listener.hear(t + 0.7, *manifest([encode_pack(messages)], t))
    assert listener.flags() >= {Flag.SIGNED, Flag.VELOCITY_MISMATCH}
    assert "X" in [n.track_id for n in listener.traffic.neighbours(40.0)]


def test_a_manifest_proves_only_the_track_of_its_location():
    """From the signer's address another one puts X elsewhere: that track is not proven."""
    listener = Listener(keys=KEYS)
    for t in seconds(30):
        signed_flight(listener, [t])
        fly(listener, straight(north_m=-900.0), [t + 0.5])
    (copy,) = [t for t in listener.traffic.tracks.values() if t.track_id != "X"]
    assert Flag.SIGNED in listener.flags("X")
    assert not copy.proven
    assert Flag.UNSIGNED in copy.flags


def test_a_manifest_over_nothing_that_was_heard_proves_nothing():
    listener = Listener(keys=KEYS)
    for t in seconds(10):
        listener.hear(t + 0.2, basic(), location(straight(), t))
        listener.hear(t + 0.7, *manifest([b"something else"], t))
    assert counted(listener) == {Verdict.NOTHING_HEARD: 10}
    assert Flag.SIGNED not in listener.ever


# ---------------------------------------------------------------- what is refused


def flipped(pages):
    page = pages[2]
    data = bytes((page.data[0] ^ 0x10,)) + page.data[1:]
    return *pages[:2], type(page)(auth_type=5, page=2, data=data), *pages[3:]


@pytest.mark.parametrize(
    ("signing", "flag", "verdict"),
    [
        ({"change": flipped}, Flag.BAD_SIGNATURE, Verdict.WRONG),
        ({"key": OTHER}, Flag.BAD_SIGNATURE, Verdict.WRONG),
        (
            {"key": OTHER, "det": make_det(public_bytes(OTHER), 16376, 10)},
            Flag.FOREIGN_SIGNATURE,
            Verdict.FOREIGN,
        ),
        ({"age_s": 11.0}, Flag.REPLAYED_SIGNATURE, Verdict.REPLAYED),
        ({"age_s": -6.0}, Flag.REPLAYED_SIGNATURE, Verdict.EARLY),
        ({"age_s": 5.0, "valid_s": 4}, Flag.REPLAYED_SIGNATURE, Verdict.EXPIRED),
        ({"change": lambda pages: pages[:3] + pages[4:]}, Flag.INCOMPLETE_SIGNATURE, Verdict.INCOMPLETE),
    ],
    ids=["bit", "key", "det", "old", "early", "expired", "page"],
)
@pytest.mark.parametrize("by", ["key", "anchor"])
def test_each_wrong_signature_is_refused_and_named(by, signing, flag, verdict):
    if by == "key":
        listener, identity = Listener(keys=KEYS), basic()
    else:
        listener, identity = Listener(anchors=ANCHORS), basic(DET.identity, IdType.SPECIFIC_SESSION)
        listener.hear(9.0, identity, *link())
    signed_flight(listener, seconds(8), identity, **signing)
    track = listener.traffic.tracks[identity.uas_id]
    assert flag in track.flags
    assert not track.proven
    assert 7 <= counted(listener)[verdict] <= 8, "of eight, each once"
    assert not listener.ever & ({*Flag} - {flag, Flag.UNSIGNED})
    assert flag.value in [report.flag for report in listener.reports]
    assert listener.traffic.neighbours(20.0), "it is avoided like everybody"


@pytest.mark.parametrize("address", ["a", "b"])
def test_a_replay_11_s_later(address):
    """Locations and Manifests of a true flight, heard again from its address or another."""
    listener = Listener(keys=KEYS)
    frames = []
    for t in seconds(10):
        messages = as_sent(basic(), location(straight(), t))
        frames += [(t + 0.2, messages), (t + 0.7, manifest([encode_pack(messages)], t))]
    for at_s, messages in frames:
        listener.hear(at_s, *messages)
    assert listener.ever == {Flag.SIGNED}
    for at_s, messages in frames:
        listener.hear(at_s + 11.0, *messages, address=address)
    assert counted(listener) == {Verdict.VALID: 10, Verdict.REPLAYED: 10}
    assert Flag.REPLAYED_SIGNATURE in listener.ever


def test_a_replay_at_once_from_another_address():
    """What proves its sender proves nobody who repeats it, however soon."""
    listener = Listener(keys=KEYS)
    for t in seconds(10):
        messages = as_sent(basic(), location(straight(), t))
        for address, later_s in (("a", 0.2), ("b", 0.3)):
            listener.hear(t + later_s, *messages, address=address)
        for address, later_s in (("a", 0.7), ("b", 0.8)):
            listener.hear(t + later_s, *manifest([encode_pack(messages)], t), address=address)
    assert counted(listener) == {Verdict.VALID: 10, Verdict.REPLAYED: 10}


def test_after_a_clock_that_led_evidence_counts_again():
    """Both clocks are set ahead by an hour, as by a false GNSS signal, and back."""
    listener = Listener(keys=KEYS)
    for start_s, lead_s in ((10.0, 0.0), (20.0, 3600.0), (30.0, 0.0)):
        listener.utc_offset_s = UTC_OFFSET_S + lead_s
        signed_flight(listener, seconds(5, start_s), age_s=-lead_s)
    assert counted(listener) == {Verdict.VALID: 15}


def test_older_evidence_after_newer_is_replayed():
    listener = Listener(keys=KEYS)
    signed_flight(listener, seconds(5))
    messages = as_sent(basic(), location(straight(), 15.0))
    listener.hear(15.2, *messages)
    listener.hear(15.5, *manifest([encode_pack(messages)], 12.0))
    assert counted(listener) == {Verdict.VALID: 5, Verdict.REPLAYED: 1}


def test_lost_pages_on_ble4():
    """One lost page is restored; two are not, and are named. Neither is called forged."""
    listener = Ble4(keys=KEYS)

    def hear(times_s, lost):
        for t in times_s:
            listener.fly(t)
            begin = int(UTC_OFFSET_S + t)
            content = manifest_content(NO_HASH, NO_HASH, [message_hash(encode(listener.last))])
            made = sign(KEY, DET, MANIFEST, content, begin, begin + 120)
            listener.pages(t, split(AuthenticationData(5, float(begin), made.encode()), parity=True), lost)

    hear(seconds(5), {3})
    assert listener.flags() == {Flag.SIGNED}
    hear(seconds(15, 15.0), {2, 3})
    assert listener.flags() == {Flag.UNSIGNED, Flag.INCOMPLETE_SIGNATURE}
    assert Flag.BAD_SIGNATURE not in listener.ever


def test_pages_of_two_sets_are_not_called_forged():
    """Of each second set only the first pages arrive, of the next only the last: together they are whole."""
    listener = Ble4(keys=KEYS)
    for k, t in enumerate(seconds(20)):
        listener.fly(t)
        listener.pages(t, manifest([encode(listener.last)], t), lost=(3, 4, 5) if k % 2 == 0 else (0, 1, 2))
    assert Flag.BAD_SIGNATURE not in listener.ever
    assert Verdict.WRONG not in counted(listener)
    assert Flag.INCOMPLETE_SIGNATURE in listener.ever


@pytest.mark.parametrize(
    ("pages", "verdict"),
    [
        (link(key=OTHER), Verdict.WRONG),
        (link(begin_s=-2 * 86_400.0), Verdict.EXPIRED),
        (link(begin_s=3_600.0), Verdict.EARLY),
    ],
)
def test_endorsements_that_are_refused(pages, verdict):
    listener = Listener(anchors=ANCHORS)
    session = basic(DET.identity, IdType.SPECIFIC_SESSION)
    listener.hear(9.0, session, *pages)
    signed_flight(listener, seconds(3), session)
    assert counted(listener) == {verdict: 1, Verdict.UNKNOWN_KEY: 3}
    assert not listener.traffic.tracks[DET.identity].proven


def test_a_stranger_to_the_registry_does_not_become_known():
    """It endorses itself under the registry's name of authority, with a registry key of its own."""
    listener = Listener(anchors=ANCHORS)
    own_registry = make_det(public_bytes(OTHER), 16376, 10)
    made = endorse(OTHER, own_registry, DET, PUBLIC, int(UTC_OFFSET_S), int(UTC_OFFSET_S) + 9999)
    session = basic(DET.identity, IdType.SPECIFIC_SESSION)
    listener.hear(9.0, session, *split(AuthenticationData(5, None, made.link())))
    signed_flight(listener, seconds(3), session)
    assert counted(listener) == {Verdict.UNKNOWN_KEY: 3}


# ---------------------------------------------------------------- what it may cost


def test_a_repeated_signature_is_checked_once():
    listener = Listener(keys=KEYS)
    messages = as_sent(basic(), location(straight(), 10.0))
    pages = manifest([encode_pack(messages)], 10.0)
    for k in range(200):
        listener.hear(10.2 + 0.001 * k, *messages)
        listener.hear(10.2 + 0.001 * k, *pages)
    assert counted(listener) == {Verdict.VALID: 1}


def test_a_flood_of_garbage_costs_a_bounded_number_of_checks():
    """Well-formed evidence with random signatures, from ever new addresses and from the signer's own."""
    listener = Listener(keys=KEYS)
    generator = random.Random(1)
    signed_flight(listener, seconds(3))
    for k in range(5000):
        t = 14.0 + k / 1000.0
        content = manifest_content(generator.randbytes(8), NO_HASH, [b"12345678"])
        begin = int(UTC_OFFSET_S + t)
        forged = sign(OTHER, DET, MANIFEST, content, begin, begin + 120).encode()
        address = f"s{k}" if k % 2 else "f"
        listener.hear(t, basic(), *split(AuthenticationData(5, None, forged)), address=address)
        if k % 1000 == 500:
            signed_flight(listener, [t])
    verdicts = counted(listener)
    assert verdicts[Verdict.VALID] == 8, "the signer is still heard"
    assert verdicts[Verdict.WRONG] <= 25 * 6
    assert verdicts[Verdict.POSTPONED] >= 4800
    assert Flag.SIGNED in listener.flags()


def test_one_source_cannot_take_the_checks_of_others():
    listener = Listener(keys=KEYS)
    generator = random.Random(1)
    for k in range(200):
        t = 10.0 + k / 100.0
        content = manifest_content(generator.randbytes(8), NO_HASH, [b"12345678"])
        begin = int(UTC_OFFSET_S + t)
        forged = sign(OTHER, DET, MANIFEST, content, begin, begin + 120).encode()
        listener.hear(t, basic(), *split(AuthenticationData(5, None, forged)), address="f")
    assert counted(listener)[Verdict.WRONG] <= 10
    signed_flight(listener, [12.0])
    assert counted(listener)[Verdict.VALID] == 1


def test_what_is_remembered_is_bounded():
    listener = Listener(keys=KEYS, max_tracks=20)
    for k in range(2000):
        t = 10.0 + 0.01 * k
        listener.hear(t, basic(), location(straight(), t), address=f"s{k % 500}")
    table = listener.traffic._table.sources
    sources = [*table._idle.values(), *table._feeding.values()]
    assert len(sources) <= 80
    assert all(len(source.reported) <= 40 for source in sources)


def test_a_bad_configuration_is_named():
    with pytest.raises(Exception, match="64 hex digits"):
        Listener(keys={"X": "abc"})
    assert TrafficConfig(keys=KEYS, anchors=ANCHORS).anchors == ANCHORS
