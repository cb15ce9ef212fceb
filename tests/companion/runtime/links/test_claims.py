"""A second companion on one computer gets neither the vehicle nor the aircraft of the first."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys

import msgspec
import pytest

from companion.commands import cli
from companion.config import EXAMPLE_ID, Config, IdentityConfig, VehicleConfig
from companion.errors import ConfigError
from companion.radio.ether.section import EtherRadio
from companion.runtime.links.claims import claimed

HELD = f"\\(process {os.getpid()}\\); stop that one first"
PORT = 20_000 + os.getpid() % 20_000
"""A port of this process's own: claims count for the whole computer."""
ETHER = EtherRadio(address="127.0.0.1:1")


def config_of(name, link="udpin:127.0.0.1:0", *radio):
    return Config(
        identity=IdentityConfig(uas_id=f"{name}{os.getpid()}"), vehicle=VehicleConfig(link=link), radio=radio
    )


def claim(config):
    return claimed(config, pytest.fail)


@pytest.mark.parametrize(
    ("link", "same"),
    [
        ("udpout:127.0.0.1", "udpout:localhost"),
        ("udpout:[::1]", "udpout:::1"),
        ("tcp:127.0.0.1", "tcp:localhost"),
    ],
)
def test_one_link_has_one_companion(link, same):
    with claim(config_of("A", f"{link}:{PORT}", ETHER)):
        with (
            pytest.raises(ConfigError, match=f"^vehicle.link: .*: another companion uses it {HELD}$"),
            claim(config_of("B", f"{same}:{PORT}", ETHER)),
        ):
            pass
        with claim(config_of("B", f"{link}:{PORT + 1}", ETHER)):
            pass
    with claim(config_of("B", f"{same}:{PORT}")):
        pass


def test_vehicles_of_different_system_ids_may_share_the_address_of_a_router():
    with contextlib.ExitStack() as held:
        for number in (1, 2):
            one = config_of(f"R{number}", f"udpout:127.0.0.1:{PORT}")
            one = msgspec.structs.replace(one, vehicle=msgspec.structs.replace(one.vehicle, system_id=number))
            held.enter_context(claim(one))


def test_one_aircraft_has_one_companion_whatever_the_links():
    with claim(config_of("A")):
        again = config_of("A", f"tcp:127.0.0.1:{PORT}")
        with (
            pytest.raises(ConfigError, match=f"^identity.uas_id: A.*flies this aircraft {HELD}$"),
            claim(again),
        ):
            pass
        with claim(config_of("B", f"tcp:127.0.0.1:{PORT}")):  # and the refused one has left its link
            pass


def test_many_simulated_aircraft_may_have_one_identity():
    example = Config(identity=IdentityConfig(uas_id=EXAMPLE_ID))
    with claim(example), claim(example):
        pass
    with claim(config_of("A", "udpin:127.0.0.1:0", ETHER)), claim(config_of("A", "udpin:127.0.0.1:0", ETHER)):
        pass


def test_a_killed_companion_holds_nothing():
    program = (
        "import time\n"
        "from companion.config import EXAMPLE_ID, Config, IdentityConfig\n"
        "from companion.runtime.links.claims import claimed\n"
        f"with claimed(Config(identity=IdentityConfig(uas_id='K{os.getpid()}')), print):\n"
        "    print('held', flush=True)\n"
        "    time.sleep(600)\n"
    )
    holder = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    mine = Config(identity=IdentityConfig(uas_id=f"K{os.getpid()}"))
    with pytest.raises(ConfigError, match=f"process {holder.pid}"), claim(mine):
        pass
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    holder.stdout.close()
    with claim(mine):
        pass


class NotFlown:
    """Stands for `Flight`; it must not begin."""

    def __init__(self, *_arguments, dry_run):
        self.dry_run = dry_run

    def run(self):
        assert self.dry_run


def test_run_refuses_before_anything_is_opened_but_a_dry_run_may_watch(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("companion.runtime.flight.Flight", NotFlown)
    path = tmp_path / "c.toml"
    path.write_text(f'[identity]\nuas_id = "R{os.getpid()}"\n')
    with claim(Config(identity=IdentityConfig(uas_id=f"R{os.getpid()}"))):
        assert cli.main(["run", "--config", str(path)]) == 2
        assert "another companion flies this aircraft" in capsys.readouterr().err
        assert cli.main(["run", "--config", str(path), "--dry-run"]) == 0
