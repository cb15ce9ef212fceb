"""The `companion` command.

Modules are imported only for the subcommand that needs them: those for flight and replay load the compiler
(numba), and a flight needs nothing of `remote-id`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import msgspec

from companion import __version__, event_record
from companion import config as configuration
from companion.commands.entry_point import parser_of, run_command
from companion.errors import ConfigError

_EXAMPLES = """examples:
  companion init --ardupilot --radio hci=user:0
  companion check --config companion.toml
  companion run --config companion.toml --dry-run
  companion status
  companion display
  companion bench-test --evidence first-flights.json
  companion replay runs/20260101T000000Z-demo
  companion replay flight.tlog --json
  companion replay 00000042.BIN
  companion remote-id listen --radio wifi=mon0
  companion remote-id decode < messages.hex
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0 for success, 1 for a negative result, 2 for wrong input."""
    return run_command(_parser(sys.argv[1:] if argv is None else argv), argv)


def _parser(given: Sequence[str]) -> argparse.ArgumentParser:
    parser = parser_of(
        "companion",
        "Flight software for a companion computer: receive Remote ID, avoid other aircraft, fly timed paths.",
        _EXAMPLES,
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    run = commands.add_parser(
        "run", help="fly with an autopilot", epilog="companion run --config companion.toml"
    )
    run.add_argument("--config", type=Path, required=True, help="configuration file (TOML)")
    run.add_argument(
        "--dry-run", action="store_true", help="decide and record, but command nothing and broadcast nothing"
    )
    run.set_defaults(run=_run)

    begun = commands.add_parser("init", help="write a commented configuration, by options or by asking")
    if given and given[0] == "init":
        from companion.commands import init

        init.add_arguments(begun)

    status = commands.add_parser(
        "status", help="show the live state of a companion on this computer", epilog="companion status --once"
    )
    status.add_argument("--socket", type=Path, help="status socket; needed if several companions run")
    status.add_argument("--once", action="store_true", help="print the state once and exit")
    status.add_argument("--json", action="store_true", help="print the state once, as one JSON object")
    status.set_defaults(run=_status)

    display = commands.add_parser(
        "display",
        help="serve a page that shows the traffic around a flying aircraft",
        epilog="companion display; companion display --host 0.0.0.0 --token-file token.txt",
    )
    if given and given[0] == "display":
        from companion.commands import display as display_command

        display_command.add_arguments(display)

    checked = commands.add_parser(
        "check",
        help="check that everything is ready for a flight; say what is missing and what to do",
        epilog="companion check --config my.toml",
    )
    checked.add_argument("--config", type=Path, required=True, help="configuration file (TOML)")
    checked.add_argument("--json", action="store_true", help="print one JSON object")
    checked.set_defaults(run=_check)

    tested = commands.add_parser(
        "bench-test",
        help="walk through the first-flight checklist and record its evidence",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if given and given[0] == "bench-test":
        from companion.commands import bench_test

        bench_test.add_arguments(tested)
        tested.set_defaults(run=bench_test.run)

    again = commands.add_parser(
        "replay",
        help="run the core again on a recorded flight or a vehicle's log",
        epilog="companion replay runs/NAME",
    )
    again.add_argument("path", type=Path, help="run folder, or .events, .tlog, .bin or .ulg file")
    again.add_argument("--json", action="store_true", help="print one JSON object per line")
    again.set_defaults(run=_replay)

    remote_id = commands.add_parser("remote-id", help="receive, encode, decode or check Remote ID messages")
    if given and given[0] == "remote-id":
        from companion.commands import listen
        from companion.commands import remote_id as remote_id_command

        of_remote_id = remote_id.add_subparsers(title="commands", required=True, metavar="COMMAND")
        remote_id_command.add_arguments(of_remote_id)
        listen.add_arguments(of_remote_id)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from companion.runtime.flight import Flight
    from companion.runtime.links.claims import claimed

    def say(line: str) -> None:
        print(line, flush=True)

    config = configuration.load(arguments.config)
    # A dry run commands and broadcasts nothing, so it may run beside a flight, under another component id.
    with contextlib.nullcontext() if arguments.dry_run else claimed(config, say):
        Flight(config, say, dry_run=arguments.dry_run).run()
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from companion.commands.check import check

    colours = {"green": 32, "yellow": 33, "red": 31} if sys.stdout.isatty() else {}

    def say(line: str) -> None:
        light, _, rest = line.partition(" ")
        print(f"\x1b[{colours[light]}m{light}\x1b[0m {rest}" if light in colours else line, flush=True)

    return check(configuration.load(arguments.config), say, as_json=arguments.json)


def _status(arguments: argparse.Namespace) -> int:
    from companion.commands.status import show_state

    return show_state(arguments.socket, once=arguments.once, as_json=arguments.json)


def _replay(arguments: argparse.Namespace) -> int:
    path: Path = arguments.path
    if path.is_dir():
        files = sorted(path.glob("*.events"))
        if not files:
            raise ConfigError(f"{path}: not a run folder: it holds no .events file")
        return max([_replay_events(file, path, as_json=arguments.json) for file in files])
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    if path.suffix == ".events":
        return _replay_events(path, path.parent, as_json=arguments.json)
    return _replay_log(path, as_json=arguments.json)


def _replay_events(path: Path, folder: Path, *, as_json: bool) -> int:
    from companion import replay

    tolerance = 0.0 if _same_machine_and_software(folder / "manifest.json") else replay.ELSEWHERE
    with path.open("rb") as stream:
        reader = event_record.Reader(stream, str(path))
        result = replay.replay_record(reader.records(), str(path), tolerance)
        result.unread_bytes = stream.seek(0, os.SEEK_END) - reader.offset
    if as_json:
        print(msgspec.json.encode(result).decode(), flush=True)
    else:
        how = "bit for bit" if tolerance == 0.0 else f"to within {tolerance:g} (other machine or versions)"
        print(
            f"{result.aircraft}: {result.steps} steps, {result.commands} commands, "
            f"{result.differences} steps differ ({how})"
            + (f", {result.reworded} of them only in texts for people" if result.reworded else "")
        )
        if result.refused:
            rules = ", ".join(f"{name} {count}" for name, count in sorted(result.refused.items()))
            print(f"commands that the gate would now refuse, by rule: {rules}")
        for what, counts in (
            ("commands that the gate refuses now and did not refuse then", result.refused_anew),
            ("refusals in the record that the gate does not repeat now", result.passed_anew),
        ):
            if counts:
                rules = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
                print(f"{what}, by rule: {rules}")
    if result.first is not None:
        print(result.first, file=sys.stderr)
    if result.unread_bytes:
        words = f"the file is cut off; its last {result.unread_bytes} bytes are not a whole record"
        print(f"{path}: {words}", file=sys.stderr)
    if not result.steps:
        print(f"{path}: holds no step, so nothing was compared", file=sys.stderr)
    differs = result.differences or result.refused_anew or result.passed_anew
    return 1 if differs or not result.steps else 0


def _same_machine_and_software(manifest: Path) -> bool:
    try:
        facts = json.loads(manifest.read_text())
        return (
            facts["machine"] == platform.machine()
            and facts["dmuca"] == __version__
            and all(metadata.version(name) == version for name, version in facts["versions"].items())
        )
    except (OSError, ValueError, KeyError, TypeError, metadata.PackageNotFoundError):
        return False


def _replay_log(path: Path, *, as_json: bool) -> int:
    """Replay the log of a vehicle without a companion's record: telemetry, or what it logged on board."""
    from companion import replay
    from companion.autopilot.tlog import read_tlog
    from companion.flight_logs import KINDS, About

    with path.open("rb") as stream:
        head = stream.read(8)
        stream.seek(0)
        read_steps = next((reader for magic, reader in KINDS.items() if head.startswith(magic)), None)
        if read_steps is None:
            result, locations = replay.replay_tlog(read_tlog(stream, str(path)))
        else:
            result, locations = replay.replay_steps(read_steps(stream, str(path), About()))
        for location in locations:
            replay.on_air(location)
    if as_json:
        print(msgspec.json.encode(result).decode(), flush=True)
        return 0
    unit = "frames" if read_steps is None else "events"
    print(f"{path}: {result.vehicle or 'no vehicle'}; {result.duration_s:.1f} s, {result.frames} {unit}")
    print(
        "  no companion's record, so no commands are compared: the core got the events and commanded nothing"
    )
    print(f"  GNSS states {result.gnss_states} (GPS_RAW_INT {result.gnss_fixes})")
    for name, where in (("first", result.first), ("last", result.last)):
        if where is not None:
            print(f"  {name} position {where[0]:.7f} {where[1]:.7f}, {where[2]:.2f} m above mean sea level")
    print(f"  Remote ID broadcasts {result.broadcasts}, {result.locations_with_position} with a position")
    if result.counts:
        print("  " + ", ".join(f"{key} {value}" for key, value in result.counts.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
