"""`companion init`: writes a commented configuration, by options or by asking.

The written file is loaded before it is kept, so that `companion check` accepts it.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from companion import config as configuration
from companion.config import EXAMPLE_ID, Config, check_identity
from companion.errors import ConfigError
from companion.remote_id.transports import BLE4
from companion.shipped import names, shipped

_EPILOG: Final = """examples:
  companion init                                                    # asks, if it runs in a terminal
  companion init --px4 --radio ether=127.0.0.1:14640
  companion init --ardupilot --link serial:/dev/ttyAMA0:921600 --radio hci=user:0 --region us
"""
_COLUMN: Final = 36
_LINK: Final = "udpin:127.0.0.1:14540"
_WIRING: Final = {
    "ardupilot serial": (
        "# ArduPilot, for TELEM2: SERIAL2_PROTOCOL = 2 (MAVLink 2), SERIAL2_BAUD = 921 for 921600, and no\n"
        "# flow control where its wires are missing: BRD_SER2_RTSCTS = 0."
    ),
    "ardupilot network": (
        "# ArduPilot behind a router on this computer, or on Ethernet: there NET_ENABLE = 1, then, after a\n"
        "# restart, NET_P1_TYPE = 1 (UDP client), NET_P1_PROTOCOL = 2, NET_P1_IP0..3 this computer,\n"
        "# NET_P1_PORT = 14540; the link listens on 0.0.0.0."
    ),
    "px4 serial": (
        "# PX4, for TELEM2: MAV_1_CONFIG = 102, MAV_1_MODE = 2 (onboard), SER_TEL2_BAUD as in the link."
    ),
    "px4 network": (
        "# PX4 behind a router on this computer, its simulation (which sends to port 14540 by itself), or\n"
        "# on Ethernet: there MAV_2_CONFIG = 1000, MAV_2_MODE = 2 (onboard), MAV_2_UDP_PRT = 14540. PX4\n"
        "# sends nothing there before it has received something: use udpout: with its address. A companion\n"
        "# that restarts then receives nothing until PX4 restarts (docs/flying.md)."
    ),
}
"""What the autopilot's end of the link needs, by firmware and kind of link."""


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of radio, as `--radio` names it."""

    words: str
    example: str
    """Example of what follows the kind; empty if nothing does."""
    lines: tuple[tuple[str, str], ...]
    """Its keys, each with a comment. `{where}` stands for the text that follows the kind."""
    transports: tuple[str, ...]
    """Transports that are configured for it by default."""


_KINDS: Final = {
    "null": _Kind("no radio", "", (('backend = "null"', ""),), ()),
    "ether": _Kind(
        "the simulated air",
        "127.0.0.1:14640",
        (('backend = "ether"', ""), ("address = {where}", "")),
        ("wifi",),
    ),
    "hci": _Kind(
        "a Bluetooth controller that no other software uses",
        "user:0",
        (
            ('backend = "hci"', ""),
            ("channel = {where}", "or uart:DEVICE:BAUD, tcp:HOST:PORT"),
            ("# send = true", ""),
            ("# listen = true", ""),
        ),
        ("ble4", "ble5"),
    ),
    "wifi": _Kind(
        "a Wi-Fi card in monitor mode",
        "mon0",
        (
            ('backend = "wifi"', ""),
            ("inject = {where}", "sends beacons and NAN frames on it"),
            ("monitor = {where}", "listens on it"),
            ('# hostapd = "/run/hostapd/wlan0"', "in place of inject: sends beacons through hostapd"),
            ("# channel = 6", ""),
        ),
        ("wifi",),
    ),
    "arduremoteid": _Kind(
        "a module with ArduRemoteID firmware",
        "serial:/dev/ttyACM0:57600",
        (
            ('backend = "arduremoteid"', ""),
            ("link = {where}", "in the forms of vehicle.link"),
            ("# system_id = 1", "the vehicle's"),
        ),
        ("wifi",),
    ),
}


@dataclass(frozen=True, slots=True)
class Choices:
    """The choices from which a configuration is written."""

    firmware: Literal["ardupilot", "px4"] = "ardupilot"
    link: str = _LINK
    uas_id: str = EXAMPLE_ID
    region: str = "none"
    use: str = "watch"
    radios: tuple[tuple[str, str], ...] = (("null", ""),)
    """Kind of each radio, and its channel, interface or address."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `companion init`, which calls `run`."""
    parser.description = (
        "Write a commented configuration. Choices without an option are asked for in a terminal; without a "
        "terminal they take their defaults."
    )
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    firmware = parser.add_mutually_exclusive_group()
    for name in ("ardupilot", "px4"):
        firmware.add_argument(f"--{name}", dest="firmware", action="store_const", const=name,
                              help=f"the autopilot's firmware is {name}")  # fmt: skip
    parser.add_argument("--link", help=f"link to the autopilot (default: {_LINK})")
    parser.add_argument("--uas-id", metavar="ID", help="the aircraft's serial number by CTA-2063-A")
    regions = names("regions", ".toml")
    parser.add_argument("--region", choices=regions, help="region of the Remote ID law (default: none)")
    parser.add_argument("--use", choices=("watch", "guard"),
                        help="watch: never command; guard: avoid conflicts (default: watch)")  # fmt: skip
    kinds = ", ".join(f"{name}={kind.example}".rstrip("=") for name, kind in _KINDS.items())
    parser.add_argument("--radio", action="append", metavar="KIND=WHERE",
                        help=f"a radio: {kinds}; may be given several times (default: null)")  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("companion.toml"), metavar="FILE",
        help="the file to write (default: companion.toml)")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="replace the file if it exists")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the configuration. Returns 0.

    Raises:
        ConfigError: an option or answer is wrong, or the file exists or cannot be written.
    """
    path: Path = arguments.out
    if path.exists() and not arguments.force:
        raise ConfigError(f"--out: {path}: exists already; choose another file, or replace it with --force")
    asks = sys.stdin.isatty() and sys.stdout.isatty()
    text, config = written(chosen(arguments, _ask if asks else None), path)
    try:
        # Others must not read it: it will hold the secret characters of an operator ID. The group may: so the
        # service reads a file of root's.
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        with open(os.open(path, flags, 0o640), "w", encoding="utf-8") as file:
            # A file that is replaced keeps its mode.
            os.fchmod(file.fileno(), os.fstat(file.fileno()).st_mode & 0o770)
            file.write(text)
    except OSError as error:
        raise ConfigError(f"--out: {path}: cannot be written: {error.strerror}") from error
    print(f"wrote {path}; next: companion check --config {path}")
    if EXAMPLE_ID in text:
        print(f"identity.uas_id is an example: put the serial number of your aircraft into {path}")
    for note in check_identity(config.identity, config.remote_id, config.region):
        print(f"note: {note}")
    return 0


def chosen(arguments: argparse.Namespace, ask: Callable[[str, str], str] | None) -> Choices:
    """The choices by the options, by asking for the others, or by default.

    Args:
        arguments: the parsed options.
        ask: asks a question with a default answer and returns the answer; None: nobody is asked.

    Raises:
        ConfigError: an option or answer is wrong.
    """
    default = Choices()

    def answer(given: str | None, question: str, otherwise: str, allowed: Sequence[str] = ()) -> str:
        if given is not None or ask is None:
            return otherwise if given is None else given
        words = f"{question} ({', '.join(allowed)})" if allowed else question
        while allowed and (said := ask(words, otherwise)) not in allowed:
            print(f"{said!r}: allowed: {', '.join(allowed)}")
        return said if allowed else ask(words, otherwise)

    firmware = answer(arguments.firmware, "Firmware of the autopilot", default.firmware, ("ardupilot", "px4"))
    link = answer(arguments.link, "Link to the autopilot", default.link)
    uas_id = answer(arguments.uas_id, "Serial number of the aircraft (CTA-2063-A)", default.uas_id)
    region = answer(arguments.region, "Region", default.region, names("regions", ".toml"))
    given = arguments.radio or [answer(None, _radio_question(), "null")]
    radios = tuple(_radio(text) for item in given for text in item.split())
    heard = any(kind != "null" for kind, _ in radios)
    use = answer(arguments.use, "Use", default.use, ("watch", "guard")) if heard else arguments.use
    return Choices(
        firmware="px4" if firmware == "px4" else "ardupilot",
        link=link,
        uas_id=uas_id,
        region=region,
        use=use or default.use,
        radios=radios or default.radios,
    )


def _radio_question() -> str:
    lines = (f"  {f'{name}={kind.example}'.rstrip('='):40s} {kind.words}" for name, kind in _KINDS.items())
    return "\n".join(("Radios, one or more of these with a space between:", *lines, "Radios"))


def _ask(question: str, default: str) -> str:
    try:
        return input(f"{question} [{default}]: ").strip() or default
    except EOFError as error:
        raise ConfigError("the questions were not answered; nothing was written") from error


def _radio(text: str) -> tuple[str, str]:
    kind, _, where = text.partition("=")
    if kind not in _KINDS or bool(where) != bool(_KINDS[kind].example):
        forms = ", ".join(f"{name}={k.example}".rstrip("=") for name, k in _KINDS.items())
        raise ConfigError(f"--radio: {text!r}: allowed: one such as {forms}")
    return kind, where


def written(choices: Choices, path: Path) -> tuple[str, Config]:
    """The text of a configuration that can be loaded, and what it loads as.

    Raises:
        ConfigError: a choice is wrong; the message names its key.
    """
    text = _text(choices, path)
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / path.name
        draft.write_text(text, encoding="utf-8")
        try:
            config = configuration.load(draft)
        except ConfigError as error:
            raise ConfigError(str(error).replace(f"{folder}/", "")) from error
    return text, config


def _text(choices: Choices, path: Path) -> str:
    link = "serial" if choices.link.startswith("serial:") else "network"
    sent = [t for kind, _ in choices.radios for t in _KINDS[kind].transports] or ["wifi"]
    transports = ", ".join(f'"{name}"' for name in dict.fromkeys(sent))
    speed = "keep it below the vehicle's MPC_XY_VEL_MAX" if choices.firmware == "px4" else ""
    return _TEMPLATE.format(
        path=path,
        every_key=shipped("config/companion.toml"),
        wiring=_WIRING[f"{choices.firmware} {link}"],
        uas_id=_line(f"uas_id = {_quoted(choices.uas_id)}", "serial number by CTA-2063-A; it is broadcast"),
        link=_line(f"link = {_quoted(choices.link)}", "udpin:, udpout:, tcp:HOST:PORT or serial:DEVICE:BAUD"),
        use=_line(f'use = "{choices.use}"', "watch: never command. guard: take the vehicle off its mission"),
        speed=_line("max_speed_mps = 5.0", speed),
        region=_line(f"region = {_quoted(choices.region)}", "whose law applies: us, eu, jp, none, or a file"),
        transports=_line(f"transports = [{transports}]", "ble4, ble5, wifi (beacon), nan; used together"),
        # With BLE 4 the best fixed set lost less in simulated cities (docs/city-results.md).
        policy=_line(
            'policy = "fixed"' if BLE4 in sent else '# policy = "rule"',
            'what chooses transports and rates in flight: "fixed", "rule",',
        ),
        radios="\n\n".join(_radio_table(kind, where) for kind, where in choices.radios),
    )


def _radio_table(kind: str, where: str) -> str:
    lines = [_line("[[radio]]", f"{_KINDS[kind].words}; docs/radios.md")]
    lines += [_line(key.replace("{where}", _quoted(where)), words) for key, words in _KINDS[kind].lines]
    return "\n".join(lines)


def _line(assignment: str, words: str) -> str:
    return f"{assignment:<{_COLUMN - 1}} # {words}" if words else assignment


def _quoted(text: str) -> str:
    """A text as a TOML string."""
    for sign, escaped in (("\\", "\\\\"), ('"', '\\"')):
        text = text.replace(sign, escaped)
    if not text.isprintable():
        raise ConfigError(f"{text!r}: allowed: printable characters")
    return f'"{text}"'


_TEMPLATE: Final = """\
# Written by `companion init`. Check it with: companion check --config {path}
# A key after "#" shows its default or an example. Every key is explained in
# {every_key}

[identity]
{uas_id}
# registration_id = "JU322627C69E"  # registration by the state; broadcast in addition

[vehicle]
{wiring}
{link}
# system_id = 0                     # vehicle to use; 0: the only one on the link, refused if there are two
# signing_key = "signing.key"       # MAVLink 2 signing key (chmod 600); none: nothing is signed or checked

[flight]
{use}
                                    # only for a conflict. fly: command the timed trajectory (docs/uses.md)
rearm = "disarm"                    # how authority returns after a takeover: "mode", "disarm" or "never"

[limits]
{speed}
max_climb_mps = 2.0
max_descent_mps = 2.0
# floor_height_m = 20.0             # above home
# ceiling_height_m = 120.0
# fence = "fence.toml"              # or "vehicle": the geofence that the vehicle holds

[avoidance]
conflict_radius_m = 5.0             # radius of one aircraft; the separation is at least twice this
# crewed_horizontal_m = 610.0       # horizontal separation from crewed traffic (ADS-B), or alternatively
# crewed_vertical_m = 77.0          # vertical separation; both contain well clear of ASTM F3442

[remote_id]
{region}
{transports}
rate = 2                            # Location messages a second on each transport
# operator_id = "FIN87astrdge12k8-xyz"  # EU: full number; the three secret characters are checked, never sent

[atmc]
{policy}
                                    # "atmc" or a file; without it they stay as configured in [remote_id]

[record]
# folder = "runs"                   # relative to this file
keep_free_mb = 500.0                # with less free disk space nothing is recorded; the flight goes on
# delete_oldest = true              # delete the oldest runs; without it a full disk ends the recording

{radios}
"""
