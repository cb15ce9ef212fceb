"""What is said of signed and unsigned senders."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from companion.remote_id.authentication import (
    MESSAGE_SET_SIGNATURE,
    UAS_ID_SIGNATURE,
    sign_pages,
)
from companion.traffic.plausibility import Flag
from tests.companion.traffic.flights import (
    UTC_OFFSET_S,
    Listener,
    basic,
    fly,
    location,
    seconds,
    straight,
)

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC_HEX = KEY.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


def signed_flight(
    listener, times_s, key=KEY, auth_type=MESSAGE_SET_SIGNATURE, age_s=0.0, north_m=200.0, **heard
):
    for t in times_s:
        messages = (basic(), location(straight(north_m=north_m), t))
        pages = sign_pages(key, auth_type, "X", messages, UTC_OFFSET_S + int(t - age_s))
        listener.hear(t + 0.2, *messages, *pages, **heard)


@pytest.mark.parametrize("auth_type", [MESSAGE_SET_SIGNATURE, UAS_ID_SIGNATURE])
def test_signed(auth_type):
    listener = Listener(keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(20), auth_type=auth_type)
    assert listener.flags() == {Flag.SIGNED}
    assert [r.flag for r in listener.reports] == ["signed"]
    fly(listener, straight(), seconds(20, 30.0))
    assert listener.flags() == {Flag.UNSIGNED}


def test_signed_page_by_page_on_ble4():
    """Four frames for the pages, between the others; the track is vouched for by its address."""
    listener = Listener(keys={"X": PUBLIC_HEX})
    for t in seconds(12):
        fly(listener, straight(), [t], transport="ble4")
        for k, page in enumerate(sign_pages(KEY, UAS_ID_SIGNATURE, "X", (), UTC_OFFSET_S + int(t))):
            listener.hear(t + 0.3 + 0.1 * k, page, transport="ble4")
    assert listener.flags() == {Flag.SIGNED}
    assert listener.traffic.tracks["X"].about.authentication.auth_type == UAS_ID_SIGNATURE


def test_unsigned_only_where_a_key_is_known():
    listener = Listener(keys={"X": PUBLIC_HEX})
    fly(listener, straight(), seconds(20))
    fly(listener, straight(north_m=500.0), seconds(20), identity="Y", address="y")
    assert listener.flags() == {Flag.UNSIGNED}
    assert listener.flags("Y") == frozenset()


def test_a_signer_is_not_called_unsigned_before_it_could_sign():
    listener = Listener(keys={"X": PUBLIC_HEX})
    fly(listener, straight(), seconds(8))
    signed_flight(listener, seconds(8, 18.0))
    assert listener.ever == {Flag.SIGNED}


def test_without_our_own_utc_nobody_is_called_unsigned():
    listener = Listener(utc_offset_s=None, keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(20))
    assert listener.ever == set()


@pytest.mark.parametrize("age_s", [30.0, -30.0])
def test_an_old_or_early_signature_is_bad(age_s):
    listener = Listener(keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(5), age_s=age_s)
    assert listener.flags() == {Flag.BAD_SIGNATURE}


def test_a_forged_signature_is_bad():
    listener = Listener(keys={"X": PUBLIC_HEX})
    signed_flight(listener, seconds(5), key=Ed25519PrivateKey.from_private_bytes(bytes(32)))
    assert listener.flags() == {Flag.BAD_SIGNATURE}
    assert listener.traffic.neighbours(15.0), "a forger is avoided like everybody"


def test_a_signed_set_vouches_for_its_own_location_only():
    """From the signer's address another one puts X elsewhere: that track is not vouched for."""
    listener = Listener(keys={"X": PUBLIC_HEX})
    for t in seconds(30):
        signed_flight(listener, [t])
        fly(listener, straight(north_m=-900.0), [t + 0.5])
    (copy,) = [t for t in listener.traffic.tracks.values() if t.track_id != "X"]
    assert Flag.SIGNED in listener.flags("X")
    assert Flag.SIGNED not in copy.flags
    assert Flag.UNSIGNED in copy.flags


def test_signatures_say_nothing_without_keys():
    listener = Listener()
    signed_flight(listener, seconds(20))
    assert listener.ever == set()
    assert len(listener.traffic.tracks["X"].about.authentication.data) == 64


def test_a_repeated_signature_is_checked_once():
    listener = Listener(keys={"X": PUBLIC_HEX})
    messages = (basic(), location(straight(), 10.0))
    pages = sign_pages(KEY, MESSAGE_SET_SIGNATURE, "X", messages, UTC_OFFSET_S + 10.0)
    for k in range(200):
        listener.hear(10.2 + 0.001 * k, *messages, *pages)
    assert listener.flags() == {Flag.SIGNED}
    assert Flag.BAD_SIGNATURE not in listener.ever
