"""Configuration: one device or address has one user, and a radio must be able to send the identity."""

from __future__ import annotations

import re

import pytest

from companion import config as configuration
from companion.errors import ConfigError
from tests.companion.test_config import IDENTITY, write


def radios(*sections: str) -> str:
    return "".join(f"[[radio]]\nbackend = {section}\n" for section in sections)


@pytest.mark.parametrize(
    ("link", "sections", "key", "user"),
    [
        (
            "udpout:127.0.0.1:14550",
            radios('"arduremoteid"\nlink = "udpout:localhost:14550"'),
            "radio[0].link: 'udpout:localhost:14550'",
            "vehicle.link",
        ),
        (
            "udpout:[::1]:14550",
            radios('"arduremoteid"\nlink = "udpout:::1:014550"'),
            "radio[0].link: 'udpout:::1:014550'",
            "vehicle.link",
        ),
        (
            "udpout:0.0.0.0:14550",
            radios('"arduremoteid"\nlink = "udpout:127.0.0.1:14550"'),
            "radio[0].link: 'udpout:127.0.0.1:14550'",
            "vehicle.link",
        ),
        (
            "serial:/dev/ttyACM0:57600",
            radios('"null"', '"arduremoteid"\nlink = "serial:/dev//ttyACM0:115200"'),
            "radio[1].link: 'serial:/dev//ttyACM0:115200'",
            "vehicle.link",
        ),
        (
            "serial:/dev/ttyS0:57600",
            radios('"hci"\nchannel = "uart:/dev/ttyS0:115200"'),
            "radio[0].channel: 'uart:/dev/ttyS0:115200'",
            "vehicle.link",
        ),
        (
            "tcp:h:1",
            radios(*['"arduremoteid"\nlink = "tcp:h:2"'] * 2),
            "radio[1].link: 'tcp:h:2'",
            "radio[0].link",
        ),
        (
            "tcp:h:1",
            radios('"hci"\nchannel = "user:0"', '"null"', '"hci"\nchannel = "user:00"\nsend = false'),
            "radio[2].channel: 'user:00'",
            "radio[0].channel",
        ),
        (
            "tcp:h:1",
            radios('"wifi"\ninject = "mon0"', '"wifi"\nmonitor = "mon0"'),
            "radio[1].monitor: 'mon0'",
            "radio[0].inject",
        ),
        (
            "tcp:h:1",
            radios('"wifi"\nhostapd = "/run/hostapd/wlan0"', '"wifi"\nhostapd = "/var/run/hostapd/wlan0"'),
            "radio[1].hostapd: '/var/run/hostapd/wlan0'",
            "radio[0].hostapd",
        ),
        (
            "tcp:h:1",
            radios(*['"ether"\naddress = "h:2"'] * 2),
            "radio[1].address: 'h:2'",
            "radio[0].address",
        ),
    ],
)
def test_one_device_has_one_user(tmp_path, link, sections, key, user):
    """A module on the vehicle's own link would be sent what the gate has not seen."""
    path = write(tmp_path, f'{IDENTITY}[vehicle]\nlink = "{link}"\n{sections}')
    message = f"c.toml: {key}: {user} uses it, too; each needs its own"
    with pytest.raises(ConfigError, match=re.escape(message)):
        configuration.load(path)


@pytest.mark.parametrize(
    ("link", "sections"),
    [
        ("udpin:0.0.0.0:0", radios('"arduremoteid"\nlink = "udpin:0.0.0.0:0"')),
        ("udpout:h:1", radios('"arduremoteid"\nlink = "udpout:h:2"', '"arduremoteid"\nlink = "tcp:h:1"')),
        ("udpout:h:1", radios('"wifi"\ninject = "mon0"\nmonitor = "mon0"', '"wifi"\nmonitor = "mon1"')),
        # Each connection to such a server gets a virtual controller of its own.
        ("tcp:h:1", radios(*['"hci"\nchannel = "tcp:h:2"'] * 2)),
        ("tcp:h:1", radios('"null"', '"null"')),
    ],
)
def test_different_devices_are_accepted(tmp_path, link, sections):
    configuration.load(write(tmp_path, f'{IDENTITY}[vehicle]\nlink = "{link}"\n{sections}'))


DET = '[identity]\nid_type = 4\nuas_id = "0120010030000000000000000000000001"\n'
MODULE = '"arduremoteid"\nlink = "serial:/dev/ttyACM0:57600"'


@pytest.mark.parametrize(
    "others", [(), ('"hci"\nchannel = "user:0"\nsend = false', '"wifi"\nmonitor = "mon0"', '"null"')]
)
def test_an_identity_that_no_radio_can_send_is_refused(tmp_path, others):
    """Every DRIP entity tag holds a zero byte, at which a module with ArduRemoteID cuts it."""
    path = write(tmp_path, DET + radios(MODULE, *others))
    with pytest.raises(ConfigError, match=r"c\.toml: identity\.uas_id: no \[\[radio\]\] can broadcast it"):
        configuration.load(path)


@pytest.mark.parametrize(
    ("identity", "sections"),
    [
        (IDENTITY, radios(MODULE)),
        (DET, radios(MODULE, '"hci"\nchannel = "user:0"')),
        (DET, radios('"hci"\nchannel = "user:0"\nsend = false')),
        (DET, ""),
    ],
)
def test_an_identity_that_one_radio_can_send_or_that_is_not_broadcast_is_accepted(
    tmp_path, identity, sections
):
    configuration.load(write(tmp_path, identity + sections))


def test_a_radio_that_only_listens_signs_nothing(tmp_path):
    signing = '[remote_id]\nsigning = { key = "a", raa = 0, hda = 0 }\n'
    path = write(tmp_path, IDENTITY + signing + radios('"hci"\nchannel = "user:0"\nsend = false'))
    with pytest.raises(ConfigError, match=r"remote_id\.signing: no \[\[radio\]\] sends signatures"):
        configuration.load(path)
