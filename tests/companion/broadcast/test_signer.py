"""What the signer adds to the broadcasts, and that an independent reader accepts it."""

from __future__ import annotations

import itertools

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from companion.broadcast.schedule import Schedule
from companion.broadcast.signer import PAGE_GAP_S, Signer
from companion.events import Broadcast
from companion.remote_id.authentication import Assembler
from companion.remote_id.codec import PACK_MAX_MESSAGES, encode, encode_pack
from companion.remote_id.drip.det import make_det
from companion.remote_id.drip.evidence import LINK, MANIFEST, decode_evidence, read_manifest
from companion.remote_id.drip.hashes import message_hash
from companion.remote_id.drip.keys import public_bytes
from companion.remote_id.drip.link import decode_link, endorse
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, OperatorId, System, UaType
from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4
from tests.support.drip_reader import Reader

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
REGISTRY = Ed25519PrivateKey.from_private_bytes(b"r" * 32)
ABOVE = Ed25519PrivateKey.from_private_bytes(b"a" * 32)
DET = make_det(public_bytes(KEY), 16376, 10)
REGISTRY_DET = make_det(public_bytes(REGISTRY), 16376, 10)
ABOVE_DET = make_det(public_bytes(ABOVE), 16376, 0)
UTC_S = 1_767_225_600
LINKS = [
    endorse(REGISTRY, REGISTRY_DET, DET, public_bytes(KEY), UTC_S, UTC_S + 86_400),
    endorse(ABOVE, ABOVE_DET, REGISTRY_DET, public_bytes(REGISTRY), UTC_S, UTC_S + 86_400),
]
STEP_S = 0.05
US = Region(
    name="us",
    transport_sets=(("wifi",), ("ble4", "ble5")),
    location_period_s=1.0,
    basic_id_period_s=1.0,
    system_period_s=1.0,
    other_period_s=3.0,
)


def messages_at(t):
    return (
        BasicId(
            id_type=IdType.SPECIFIC_SESSION, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=DET.identity
        ),
        Location(lat_deg=47.4 + 1e-6 * t, lon_deg=8.5, timestamp_s=round(int(10 * t) / 10 % 3600, 1)),
        System(timestamp_utc_s=float(UTC_S + int(t))),
        OperatorId(operator_id_type=0, operator_id="CHE87astrdge12k8"),
    )


def flown(seconds, rates, signer, region=US):
    """Broadcasts of a flight with the real schedule: (time, what the core sends, what goes on the air)."""
    schedule = Schedule(region, "X")
    for step in range(round(seconds / STEP_S)):
        t = step * STEP_S
        messages = messages_at(t)
        due = schedule.due(rates, frozenset(rates), 6, frozenset(map(type, messages)), t)
        core = [Broadcast(transport=to, messages=tuple(m for m in messages if type(m) in k)) for to, k in due]
        yield t, core, core if signer is None else signer.add(core, t, UTC_S + t)


def a_signer(links=LINKS, **more):
    return Signer(KEY, DET, links, nonce=b"8 random", **more)


def raw(broadcast):
    """The bytes that go on the air, by frame."""
    if broadcast.transport == BLE4:
        return [encode(message) for message in broadcast.messages]
    return [encode_pack(broadcast.messages)]


@pytest.mark.parametrize(
    ("transport", "rate"), [("ble4", 1), ("ble4", 10), ("ble5", 1), ("wifi", 1), ("wifi", 10), ("nan", 1)]
)
def test_an_independent_reader_accepts_everything(transport, rate):
    reader = Reader({REGISTRY_DET.data: public_bytes(REGISTRY)})
    for t, _, sent in flown(60.0, {transport: rate}, a_signer()):
        for broadcast in sent:
            for frame in raw(broadcast):
                reader.hear(frame, UTC_S + t + 0.1)
    known = reader.outcomes[reader.outcomes.index("link") + 1 :]
    assert set(known) <= {"manifest", "link", "stranger's link"}
    assert known.count("manifest") >= 20
    assert reader.outcomes.count("link") >= 2
    assert reader.outcomes.count("stranger's link") >= 2
    assert len(set(reader.proven)) >= 20


@pytest.mark.parametrize("rates", [{"wifi": 1}, {"ble4": 1, "ble5": 1}, {"wifi": 10, "ble4": 10}])
def test_nothing_that_the_core_sends_is_changed_or_late(rates):
    """The law's floor is kept as without signatures: the core's broadcasts come first, at their times."""
    plain = [(t, core) for t, core, _ in flown(30.0, rates, None)]
    for (t, core), (at, again, sent) in zip(plain, flown(30.0, rates, a_signer()), strict=True):
        assert (t, core) == (at, again)
        assert sent[: len(core)] == core
        for added in sent[len(core) :]:
            assert any(type(m) is Authentication for m in added.messages)


@pytest.mark.parametrize("rate", [2, 10])
def test_packs_hold_a_location_and_no_parity(rate):
    for _, core, sent in flown(30.0, {"wifi": rate}, a_signer()):
        for added in sent[len(core) :]:
            kinds = [type(m) for m in added.messages]
            assert kinds[:2] == [BasicId, Location]
            assert len(kinds) <= PACK_MAX_MESSAGES
            head = added.messages[2]
            assert (head.last_page, len(kinds) - 3) == (len(kinds) - 3, head.last_page)
            assert head.length <= 201


@pytest.mark.parametrize("transport", ["ble5", "wifi", "nan"])
def test_a_transport_that_is_given_up_repeats_no_location_of_old(transport):
    """Whenever that is: no Location may be older than a second."""
    ages = []
    for tenths in range(10, 40):
        signer = a_signer(period_s=2.0)
        last_s = list(flown(0.1 * tenths, {transport: 2}, signer))[-1][0]
        for step in range(1, 60):
            t = last_s + step * STEP_S
            ages += [
                (UTC_S + t) % 3600.0 - message.timestamp_s
                for added in signer.add([], t, UTC_S + t)
                for message in added.messages
                if type(message) is Location
            ]
    assert 0.5 < max(ages) <= 1.0 + 1e-6


def test_pages_on_ble4_are_apart():
    times = [
        t
        for t, core, sent in flown(60.0, {"ble4": 10}, a_signer())
        for added in sent[len(core) :]
        for _ in added.messages
    ]
    assert len(times) > 100
    assert min(b - a for a, b in itertools.pairwise(times)) >= PAGE_GAP_S - 1e-6


@pytest.mark.parametrize("transport", ["ble4", "wifi"])
def test_the_periods_of_the_standard(transport):
    """Section 6.3: a signature every 5 s, our own Link every minute, the others every 5 minutes."""
    manifests, links = [], []
    for t, core, sent in flown(120.0, {transport: 1}, a_signer(period_s=3.0)):
        for added in sent[len(core) :]:
            for page in added.messages:
                if type(page) is Authentication and page.page == 0:
                    kind = page.data[0]
                    (manifests if kind == 3 else links).append(t)
    assert max(b - a for a, b in itertools.pairwise(manifests)) <= 5.0
    assert max(b - a for a, b in itertools.pairwise(links)) <= 12.0, (
        "the own Link takes every other turn: 24 s"
    )
    assert links[0] <= 6.0


def sets_on_ble4(seconds=30.0, rate=2, links=LINKS):
    """Sets of pages in the order in which they were sent, with the times of the pages."""
    found = []
    for t, core, sent in flown(seconds, {"ble4": rate}, a_signer(links)):
        for added in sent[len(core) :]:
            (page,) = added.messages
            if page.page == 0:
                found.append([])
            found[-1].append((t, page))
    return found[:-1]


@pytest.mark.parametrize("lost", range(11))
def test_any_one_page_of_a_set_on_ble4_may_be_lost(lost):
    """The parity page restores it; so each set has one more page than its data."""
    for pages in sets_on_ble4():
        head = pages[0][1]
        assert [page.page for _, page in pages] == list(range(head.last_page + 1))
        if 0 < lost <= head.last_page:
            assembler = Assembler()
            whole = [assembler.add_page("a", page, t) for t, page in pages if page.page != lost]
            assert sum(data is not None for data in whole) == 1


def test_pages_on_ble4_follow_each_other_as_soon_as_they_may():
    times = [t for pages in sets_on_ble4() for t, _ in pages]
    assert min(b - a for a, b in itertools.pairwise(times)) == pytest.approx(0.15)


def manifests(sets):
    """Number of messages that each Manifest covers, and the hashes."""
    for pages in sets:
        data = b"".join(page.data for _, page in pages)[: pages[0][1].length]
        if data[0] == MANIFEST:
            yield read_manifest(decode_evidence(data).content).messages


def test_a_manifest_on_ble4_covers_ten_messages_with_a_location_among_them():
    """Basic ID, System and others take half of it at most; the rest are Locations."""
    sent = [
        message
        for _, core, _ in flown(30.0, {"ble4": 10}, None)
        for broadcast in core
        for message in broadcast.messages
    ]
    places = {message_hash(encode(m)) for m in sent if type(m) is Location}
    others = {message_hash(encode(m)) for m in sent} - places
    for hashes in list(manifests(sets_on_ble4(rate=10)))[1:]:
        assert len(hashes) == 10
        assert len(places & set(hashes)) >= 5
        assert 1 <= len(others & set(hashes)) <= 5


def test_links_take_turns_and_ours_is_every_other_one():
    found = []
    for pages in sets_on_ble4(seconds=95.0):
        data = b"".join(page.data for _, page in pages)[: pages[0][1].length]
        if data[0] == LINK:
            found.append(decode_link(data).child)
    assert found[:4] == [DET, REGISTRY_DET, DET, REGISTRY_DET]


def test_one_link_alone_is_sent_again_and_again():
    found = [
        decode_link(data).child
        for pages in sets_on_ble4(seconds=45.0, links=LINKS[:1])
        if (data := b"".join(page.data for _, page in pages)[: pages[0][1].length])[0] == LINK
    ]
    assert len(found) >= 3
    assert set(found) == {DET}


def test_after_a_pause_only_what_was_sent_since_is_covered():
    signer = a_signer((), period_s=3.0)
    core = [Broadcast(transport="wifi", messages=messages_at(0.0))]
    assert len(signer.add(core, 0.0, UTC_S)) == 2
    signer.add([Broadcast(transport="wifi", messages=messages_at(0.5))], 0.5, UTC_S + 0.5)
    for step in range(10, 100):
        assert not signer.add([], 0.1 * step, UTC_S + 0.1 * step)
    _, added = signer.add([Broadcast(transport="wifi", messages=messages_at(10.0))], 10.0, UTC_S + 10.0)
    data = b"".join(m.data for m in added.messages if type(m) is Authentication)[: added.messages[2].length]
    hashes = read_manifest(decode_evidence(data).content).messages
    assert hashes == (message_hash(encode_pack(messages_at(10.0))),)


def test_without_utc_or_broadcasts_nothing_is_added():
    signer = a_signer()
    for t, core, _ in flown(5.0, {"wifi": 1}, None):
        assert signer.add(core, t, None) == core
    assert signer.signed == 0
    broadcast = Broadcast(transport="wifi", messages=messages_at(5.0))
    assert len(signer.add([broadcast], 5.0, UTC_S + 5.0)) == 2
    assert all(not signer.add([], 7.1 + 0.1 * k, UTC_S + 7.0) for k in range(200)), "the transport was left"


@pytest.mark.parametrize(
    "utc_s", [0.0, -5.0, 1_420_070_400.0, 1_546_300_779.0, 1_546_300_800 + 2**32 - 60.0, 1e12, float("nan")]
)
def test_a_clock_that_is_years_off_ends_the_signatures_and_nothing_else(utc_s):
    """A GNSS receiver without a fix, or one forged SYSTEM_TIME; then the right time."""
    signer = a_signer()
    for start_s, clock_s, signed in ((0.0, utc_s, False), (20.0, UTC_S, True)):
        added = 0
        for step in range(400):
            t = start_s + step * STEP_S
            core = [Broadcast(transport="wifi", messages=messages_at(t))] if step % 20 == 0 else []
            sent = signer.add(core, t, clock_s + t)
            assert sent[: len(core)] == core
            added += len(sent) - len(core)
        assert (added > 5) is signed


def test_what_is_remembered_is_bounded():
    signer = a_signer(period_s=4.0)
    for k in range(2000):
        signer.add([Broadcast(transport="ble4", messages=messages_at(0.1 * k))], 0.0, None)
    assert all(len(lane.sent) <= 40 for lane in signer._lanes.values())


def test_wrong_links_are_refused():
    with pytest.raises(ValueError, match="the first link endorses"):
        Signer(KEY, DET, LINKS[::-1])
    with pytest.raises(ValueError, match="6 links"):
        Signer(KEY, DET, LINKS[:1] * 6)
    with pytest.raises(ValueError, match="nonce"):
        Signer(KEY, DET, nonce=b"")
