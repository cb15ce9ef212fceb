"""No radio: it never pretends to be one."""

import pytest

from companion.radio.null.null_radio import NullTransport
from companion.remote_id.messages import SelfId

MESSAGES = (SelfId(description_type=0, text="test"),)


def test_nothing_goes_out_and_health_says_so() -> None:
    radio = NullTransport()
    for transport in radio.capabilities:
        radio.broadcast(transport, MESSAGES, 0.0)
    health = radio.health(1.0)
    assert radio.heard(1.0) == []
    assert not health.ok
    assert "nothing is sent" in health.text
    assert (health.frames_sent, health.frames_heard, health.bad_frames) == (0, 0, 0)
    radio.close()


def test_an_unknown_transport_is_refused() -> None:
    with pytest.raises(ValueError, match="lora"):
        NullTransport().broadcast("lora", MESSAGES, 0.0)
