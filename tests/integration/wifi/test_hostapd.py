"""The Wi-Fi radio with a real hostapd.

They need hostapd, and one of them a TAP device (root, /dev/net/tun); the reason of a skip names what is
missing.
"""

from __future__ import annotations

import itertools
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import WifiTransport
from companion.remote_id.captures.radiotap import parse_radiotap
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import (
    build_vendor_element,
    parse_wifi,
)
from tests.integration.wifi.parts import (
    FULL,
    HOSTAPD,
    LOCATION,
    OWN,
    PATIENCE_S,
    SELF_ID,
    Tap,
    needs_hostapd,
    needs_tap,
    until,
)


class Hostapd:
    """A hostapd without a card: its driver does nothing, all the rest is real."""

    interface = "rid0"

    def __init__(self, folder: Path) -> None:
        self.log = folder / "log.txt"
        self.path = folder / "control" / self.interface
        self._configuration = folder / "hostapd.conf"
        self._configuration.write_text(
            f"interface={self.interface}\ndriver=none\nctrl_interface={self.path.parent}\nssid=RID\n"
        )
        self.start()

    def start(self) -> None:
        assert HOSTAPD is not None
        with self.log.open("a") as log:
            command = [HOSTAPD, "-d", str(self._configuration)]
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        until(self.path.exists, "hostapd's socket")

    def set_elements(self) -> list[str]:
        """The elements that it was given so far, as it logs them."""
        return re.findall(r"CTRL_IFACE SET 'vendor_elements'='(\w*)'", self.log.read_text(errors="replace"))

    def stop(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait(PATIENCE_S)


@pytest.fixture
def hostapd() -> Iterator[Hostapd]:
    folder = Path(tempfile.mkdtemp(prefix="rid-"))  # paths of sockets must be short
    hostapd = Hostapd(folder)
    yield hostapd
    hostapd.stop()
    shutil.rmtree(folder)


@needs_hostapd
def test_hostapd_takes_a_pack_of_nine(hostapd: Hostapd) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path), channel=6), OWN)
    assert (radio.capabilities, radio.hears) == ({"wifi"}, frozenset())
    assert radio.own_addresses == frozenset()  # this driver has no BSSID to tell
    assert radio.wifi_channel == 6
    for number, messages in enumerate((FULL, (LOCATION,)), start=1):
        radio.broadcast("wifi", messages, float(number))

        def taken(number: int = number) -> bool:
            radio.heard(float(number))
            return radio.health(float(number)).frames_sent == number

        until(taken, "OK")
    health = radio.health(2.0)
    assert (health.ok, health.can_send, health.missing) == (True, {"wifi"}, ())
    with pytest.raises(ValueError, match="nan"):
        radio.broadcast("nan", FULL, 2.0)
    with pytest.raises(ValueError, match="10 messages"):
        radio.broadcast("wifi", (*FULL, SELF_ID), 2.0)
    radio.broadcast("wifi", (), 2.0)
    radio.close()
    expected = [build_vendor_element(encode_pack(m), n).hex() for n, m in enumerate((FULL, (LOCATION,)))]
    until(lambda: len(hostapd.set_elements()) == 3, "the clearing")
    assert hostapd.set_elements() == [*expected, ""]


@needs_hostapd
def test_a_hostapd_that_dies_and_returns(hostapd: Hostapd) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path)), OWN)
    radio.broadcast("wifi", FULL, 0.0)
    radio.heard(0.0)
    hostapd.stop()
    radio.heard(1.0)
    radio.broadcast("wifi", FULL, 1.0)
    health = radio.health(1.0)
    assert (health.ok, health.can_send) == (False, frozenset())
    assert "check that hostapd runs" in health.text
    hostapd.start()
    seconds = itertools.count(2.0, 0.1)
    until(lambda: radio.heard(next(seconds)) or radio.health(0.0).ok, "the recovery")
    assert radio.health(0.0).can_send == {"wifi"}
    radio.close()


@needs_hostapd
def test_a_hostapd_that_hangs_and_goes_on(hostapd: Hostapd) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path)), OWN)
    hostapd.process.send_signal(signal.SIGSTOP)
    radio.broadcast("wifi", FULL, 0.0)
    radio.heard(2.5)
    health = radio.health(2.5)
    assert (health.ok, health.can_send) == (False, frozenset())
    assert "no answer to" in health.text
    hostapd.process.send_signal(signal.SIGCONT)
    seconds = itertools.count(4.0, 0.1)
    until(lambda: radio.heard(next(seconds)) or radio.health(0.0).ok, "the recovery")
    # What it was given before it hung would be old by now: it is off the air before we send again.
    element = build_vendor_element(encode_pack(FULL), 0)
    until(lambda: hostapd.set_elements()[-1] == "", "the clearing")
    assert hostapd.set_elements() == [element.hex(), ""]
    radio.close()


@needs_tap
@needs_hostapd
def test_injection_steps_in_for_a_lost_hostapd(hostapd: Hostapd, tap: Tap) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path), inject=tap.name), OWN)
    radio.broadcast("wifi", (SELF_ID,), 0.0)
    assert tap.waiting() == []
    hostapd.stop()
    radio.heard(1.0)
    radio.broadcast("wifi", (SELF_ID,), 1.0)
    (data,) = tap.sent(1)
    assert parse_wifi(parse_radiotap(data).frame).address == OWN
    assert radio.health(1.0).can_send == {"wifi", "nan"}
    assert not radio.health(1.0).ok
    radio.close()
