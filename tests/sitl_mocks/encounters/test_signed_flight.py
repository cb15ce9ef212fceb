"""Two whole companions in lock-step that sign and verify, over real frames."""

from __future__ import annotations

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from companion.broadcast.signer import Signer
from companion.config import TrafficConfig
from companion.core import Companion
from companion.remote_id.drip.det import make_det
from companion.remote_id.drip.evidence import MANIFEST
from companion.remote_id.drip.keys import public_bytes
from companion.remote_id.drip.link import endorse
from companion.remote_id.messages import IdType
from companion.system import CompanionSystem
from companion.traffic.plausibility import Flag
from companion.traffic.signatures import Verdict
from sitl_mocks.encounters import lockstep
from sitl_mocks.encounters.lockstep import UTC_AT_START_S
from tests.sitl_mocks.encounters.test_lockstep import HEAD_ON
from tests.support.drip_reader import Reader

REGISTRY = Ed25519PrivateKey.from_private_bytes(b"r" * 32)
REGISTRY_DET = make_det(public_bytes(REGISTRY), 16376, 10)
SHORT = msgspec.structs.replace(HEAD_ON, duration_s=16.0)


class Fleet:
    """Lets `lockstep.fly` make signing companions, and keeps what they are and what they send."""

    def __init__(self, monkeypatch, *, signing=True, trust=True, alter=lambda name, frame, tick: [frame]):
        self.systems = {}
        self.steps = {}
        self.frames = []
        self.keys = {}
        plain_config = lockstep.companion_config
        plain_sender = lockstep.FrameSender
        fleet = self

        def config(scenario, name, path, law=None):
            made = plain_config(scenario, name, path, law)
            key = Ed25519PrivateKey.from_private_bytes(name.encode().ljust(32))
            self.keys[made.vehicle.system_id] = key
            det = make_det(public_bytes(key), 16376, 10)
            identity = msgspec.structs.replace(
                made.identity, uas_id=det.identity, id_type=IdType.SPECIFIC_SESSION
            )
            anchors = {str(REGISTRY_DET): public_bytes(REGISTRY).hex()} if trust else {}
            return msgspec.structs.replace(made, identity=identity, traffic=TrafficConfig(anchors=anchors))

        def system(config, record=None, **more):
            key = self.keys[config.vehicle.system_id]
            det = make_det(public_bytes(key), 16376, 10)
            begin = int(UTC_AT_START_S)
            link = endorse(REGISTRY, REGISTRY_DET, det, public_bytes(key), begin, begin + 86_400)
            signer = Signer(key, det, [link], nonce=b"8 random") if signing else None
            steps = self.steps[config.vehicle.system_id] = []

            def keep(step):
                steps.append(step)
                if record is not None:
                    record(step)

            made = CompanionSystem(config, keep, signer=signer, **more)
            self.systems[config.vehicle.system_id] = made
            return made

        class Sender(plain_sender):
            def frames(self, transport, messages):
                out = []
                for frame in super().frames(transport, messages):
                    now_s = max(s.core._last_step_s or 0.0 for s in fleet.systems.values())
                    fleet.frames.append((transport, self.address, frame, now_s))
                    out += alter(self.address, frame, len(fleet.frames))
                return out

        monkeypatch.setattr(lockstep, "companion_config", config)
        monkeypatch.setattr(lockstep, "CompanionSystem", system)
        monkeypatch.setattr(lockstep, "FrameSender", Sender)


def on(*transports, rate=2):
    # With little delay, because the air draws one for each frame: pages would overtake each other.
    air = msgspec.structs.replace(SHORT.air, transports=transports, rate=rate, delay_s=(0.02, 0.04))
    return msgspec.structs.replace(SHORT, air=air)


def tracks(fleet):
    return [t for system in fleet.systems.values() for t in system.core.traffic.tracks.values()]


@pytest.mark.parametrize("transports", [("wifi",), ("ble4", "ble5")])
def test_a_second_companion_accepts_what_ours_signs(monkeypatch, transports):
    fleet = Fleet(monkeypatch)
    lockstep.fly(on(*transports), 1)
    assert len(tracks(fleet)) == 2
    for track in tracks(fleet):
        assert track.proven
        assert track.flags == {Flag.SIGNED}
    for system in fleet.systems.values():
        counts = system.core.traffic.signatures.counts
        assert counts[Verdict.VALID] >= 5
        # The first Manifests cover Locations without a position, and come before the Link.
        assert set(counts) <= {Verdict.VALID, Verdict.UNKNOWN_KEY, Verdict.NOTHING_HEARD}


def payload_of(transport, frame):
    """ASTM payload of a frame: after its header and message counter."""
    if transport in ("ble4", "ble5"):
        return frame[6:]
    return frame[frame.index(b"\xfa\x0b\xbc\x0d") + 5 :]


@pytest.mark.parametrize("transport", ["wifi", "ble4", "ble5"])
def test_an_independent_reader_accepts_the_same_frames(monkeypatch, transport):
    fleet = Fleet(monkeypatch, trust=False)
    lockstep.fly(on(transport), 1)
    sender = fleet.frames[0][1]
    reader = Reader({REGISTRY_DET.data: public_bytes(REGISTRY)})
    for used, address, frame, now_s in fleet.frames:
        if address == sender:
            reader.hear(payload_of(used, frame), UTC_AT_START_S + now_s)
    known = reader.outcomes[reader.outcomes.index("link") + 1 :]
    assert set(known) == {"manifest", "link"}
    assert len(set(reader.proven)) >= 5


def test_a_record_replays_without_the_key(monkeypatch):
    """The core's commands hold no signatures."""
    fleet = Fleet(monkeypatch)
    lockstep.fly(on("wifi"), 1)
    for number, steps in fleet.steps.items():
        core = Companion(fleet.systems[number].core.config)
        assert [tuple(core.step(step.now_s, step.events)) for step in steps] == [s.commands for s in steps]


def flip(address, frame, tick):
    """One bit in the signature of every Manifest."""
    head = frame.find(b"\x22\x50")
    if head < 0 or frame[head + 8] != MANIFEST:
        return [frame]
    at = head + 25 * 4 + 5
    return [frame[:at] + bytes((frame[at] ^ 4,)) + frame[at + 1 :]]


def test_a_flipped_bit_is_refused_and_named(monkeypatch):
    fleet = Fleet(monkeypatch, alter=flip)
    lockstep.fly(on("ble5"), 1)
    for track in tracks(fleet):
        assert not track.proven
        assert Flag.BAD_SIGNATURE in track.flags
    for system in fleet.systems.values():
        assert system.core.traffic.signatures.counts[Verdict.WRONG] >= 4
