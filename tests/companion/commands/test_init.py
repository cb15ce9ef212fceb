"""`companion init` writes configurations that load, by options and by asking."""

from __future__ import annotations

import itertools
import os
import pty
import re
import subprocess
import sys

import pytest

from companion import config as configuration
from companion.commands import check, cli, init
from companion.commands.preflight import Preflight
from companion.config import EXAMPLE_ID

RADIOS = {
    "null": "null",
    "ether": "ether=127.0.0.1:14640",
    "hci": "hci=user:0",
    "wifi": "wifi=mon0",
    "arduremoteid": "arduremoteid=serial:/dev/ttyACM0:57600",
}
LINKS = ("udpin:127.0.0.1:14540", "serial:/dev/ttyAMA0:921600")


def made(tmp_path, *options):
    """The configuration that the options write."""
    path = tmp_path / "c.toml"
    assert cli.main(["init", "--out", str(path), "--force", *options]) == 0
    return configuration.load(path)


def test_the_default_watches_an_ardupilot_without_a_radio(tmp_path, capsys):
    config = made(tmp_path)
    assert (config.flight.use, config.vehicle.link, config.has_radio) == ("watch", LINKS[0], False)
    assert "ArduPilot" in (tmp_path / "c.toml").read_text()
    out = capsys.readouterr().out
    assert f"next: companion check --config {tmp_path}/c.toml" in out
    assert "identity.uas_id is an example" in out


def test_what_is_no_serial_number_is_noted(tmp_path, capsys):
    made(tmp_path, "--uas-id", "DRONE1")
    assert "note: identity.uas_id: 'DRONE1'" in capsys.readouterr().out
    made(tmp_path, "--uas-id", "1596B0000DMUCA11")
    assert "note:" not in capsys.readouterr().out


@pytest.mark.parametrize(("firmware", "link"), list(itertools.product(("ardupilot", "px4"), LINKS)))
def test_each_firmware_and_link_is_told_what_its_autopilot_needs(tmp_path, firmware, link):
    config = made(tmp_path, f"--{firmware}", "--link", link, "--uas-id", "1596B0000OWN0001")
    assert config.vehicle.link == link
    assert config.identity.uas_id == "1596B0000OWN0001"
    words = {"ardupilot": ("NET_ENABLE = 1", "SERIAL2_BAUD"), "px4": ("MAV_2_UDP_PRT", "SER_TEL2_BAUD")}
    assert words[firmware][LINKS.index(link)] in (tmp_path / "c.toml").read_text()


@pytest.mark.parametrize("region", ["us", "eu", "jp", "none"])
@pytest.mark.parametrize("kind", RADIOS)
def test_each_radio_and_region_loads(tmp_path, kind, region):
    use = "watch" if kind == "null" else "guard"
    config = made(tmp_path, "--radio", RADIOS[kind], "--region", region, "--use", use)
    assert [type(radio).__name__.lower() for radio in config.radio] == [f"{kind}radio".lower()]
    assert config.region.name == region
    legal = config.region.transport_sets
    assert not legal or any(set(one) <= set(config.remote_id.transports) for one in legal)


def test_several_radios_send_on_all_that_they_can(tmp_path):
    config = made(tmp_path, "--radio", "hci=user:0", "--radio", "wifi=mon0")
    assert config.remote_id.transports == ("ble4", "ble5", "wifi")
    assert len(config.radio) == 2


@pytest.mark.parametrize(("radio", "policy"), [("hci=user:0", "fixed"), ("wifi=mon0", None), ("null", None)])
def test_who_can_send_on_ble4_sends_the_best_fixed_set(tmp_path, radio, policy):
    assert made(tmp_path, "--radio", radio).atmc.policy == policy


def test_every_key_behind_a_hash_is_a_key(tmp_path):
    """Without their signs, the keys that are only shown still load."""
    path = tmp_path / "c.toml"
    made(tmp_path, *(f"--radio={text}" for text in RADIOS.values()))
    text = path.read_text()
    shown = re.sub(r"^# ([a-z_]+ = )", r"\1", text, flags=re.MULTILINE)
    assert len(re.findall(r"^[a-z_]+ = ", shown, re.MULTILINE)) > 12 + len(
        re.findall(r"^[a-z_]+ = ", text, re.M)
    )
    missing = ("fence", "hostapd", "operator_id", "registration_id")  # need a file, or another identity
    path.write_text("\n".join(line for line in shown.splitlines() if not line.startswith(missing)))
    configuration.load(path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--radio", "ether"], "--radio: 'ether': allowed: one such as null, ether=127.0.0.1:14640"),
        (["--radio", "null=3"], "--radio: 'null=3': allowed"),
        (["--radio", "bluetooth=0"], "--radio: 'bluetooth=0': allowed"),
        (["--radio", "hci=0"], "c.toml: radio[0].channel: '0': allowed: user:NUMBER"),
        (["--use", "guard"], 'c.toml: radio: none configured, so no aircraft is heard; use = "guard" needs'),
        (["--link", "udp:1"], "c.toml: vehicle.link: 'udp:1': allowed: udpin"),
        (["--uas-id", "DRONE1", "--region", "eu"], "c.toml: identity.uas_id: 'DRONE1': character 3"),
        (["--uas-id", 'A"\\', "--region", "us"], "c.toml: identity.uas_id: 'A\"\\\\'"),
        (["--uas-id", "A\nB"], "'A\\nB': allowed: printable characters"),
    ],
)
def test_what_cannot_be_flown_is_not_written(tmp_path, capsys, options, words):
    path = tmp_path / "c.toml"
    assert cli.main(["init", "--out", str(path), *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"companion: {words}")
    assert error.count("\n") == 1
    assert not path.exists()


def test_others_cannot_read_what_is_written(tmp_path):
    """The operator will write the secret characters of the operator ID into it."""
    path = tmp_path / "c.toml"
    before = os.umask(0o022)
    try:
        assert cli.main(["init", "--px4", "--out", str(path)]) == 0
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640
    path.chmod(0o664)
    assert cli.main(["init", "--px4", "--out", str(path), "--force"]) == 0
    assert path.stat().st_mode & 0o777 == 0o660


def test_a_file_that_exists_is_kept(tmp_path, capsys):
    path = tmp_path / "c.toml"
    path.write_text("mine")
    assert cli.main(["init", "--out", str(path)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert cli.main(["init", "--out", str(tmp_path / "no" / "c.toml")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def parsed(*options):
    return cli._parser(["init"]).parse_args(["init", *options])


def test_what_no_option_says_is_asked(capsys):
    answers = iter(["px5", "px4", LINKS[1], EXAMPLE_ID, "us", "hci=user:0 ether=127.0.0.1:1", "guard"])
    asked = []
    choices = init.chosen(parsed(), lambda words, default: asked.append((words, default)) or next(answers))
    assert choices == init.Choices(
        "px4", LINKS[1], EXAMPLE_ID, "us", "guard", (("hci", "user:0"), ("ether", "127.0.0.1:1"))
    )
    assert [default for _, default in asked] == [
        "ardupilot", "ardupilot", LINKS[0], EXAMPLE_ID, "none", "null", "watch"]  # fmt: skip
    assert "'px5': allowed: ardupilot, px4" in capsys.readouterr().out


def test_options_are_not_asked_and_a_watcher_without_a_radio_has_no_choice():
    given = parsed("--px4", "--link", LINKS[0], "--uas-id", EXAMPLE_ID, "--region", "none", "--radio", "null")
    choices = init.chosen(given, lambda *_: pytest.fail("asked"))
    assert choices == init.Choices("px4")


def test_in_a_terminal_it_asks(tmp_path):
    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "companion", "init", "--out", str(tmp_path / "c.toml")]
    with subprocess.Popen(words, stdin=theirs, stdout=theirs) as process:
        os.write(ours, b"px4\n\n\nus\nether=127.0.0.1:14640\n\n")
        assert process.wait(60) == 0
    os.close(theirs)
    os.close(ours)
    config = configuration.load(tmp_path / "c.toml")
    assert (config.region.name, config.flight.use, len(config.radio)) == ("us", "watch", 1)
    assert "PX4" in (tmp_path / "c.toml").read_text()


def test_check_tells_of_an_example_number(tmp_path):
    for options, told in (((), True), (("--uas-id", "1596B0000OWN0001"), False)):
        found = Preflight()
        check._configuration(made(tmp_path, *options), found)
        assert any("is the example" in finding.text for finding in found.findings) is told
        assert found.ready
    found = Preflight()
    check._configuration(made(tmp_path, "--region", "eu"), found)
    assert any(finding.do.startswith("set it as your registration") for finding in found.findings)
    found = Preflight()
    check._configuration(made(tmp_path, "--radio", "hci=user:0", "--use", "guard"), found)
    assert not found.ready, "two aircraft that fly with the example would not avoid each other"
