"""`ground-tools inspect RUN...`: shows runs as Rerun recordings, an HTML page, or figures (text or JSON).

A run is a run folder, an event record, or the log of any vehicle: a telemetry log (.tlog), or an onboard log
of ArduPilot (.bin) or PX4 (.ulg).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from companion.errors import ConfigError
from ground_tools.inspect.read.read_run import Run, read_run
from ground_tools.inspect.read.timeline import together
from ground_tools.inspect.report import compare, page, summary, terminal
from ground_tools.inspect.viewer import live, recording, web

EXAMPLE = "example: ground-tools inspect runs/20260101T000000Z-demo, then: rerun runs/.../inspect.rrd"
COMPARISON = "compare.rrd"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools inspect` to `parser`."""
    parser.description = (
        "Show what a run contains: paths, received traffic, predictions, decisions and Remote ID."
    )
    parser.epilog = EXAMPLE
    parser.add_argument(
        "run_folder", nargs="+", type=Path, metavar="RUN", help="run folder, or .tlog, .bin or .ulg file"
    )
    several = parser.add_mutually_exclusive_group()
    several.add_argument(
        "--together",
        action="store_true",
        help="merge all RUNs into one, with every aircraft on one UTC time line",
    )
    several.add_argument(
        "--compare", action="store_true", help="compare two or more RUNs, aligned at take-off"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--summary", action="store_true", help="print the results only; write no recording")
    what.add_argument(
        "--json",
        action="store_true",
        help="print the results only, as JSON with one object per line and run",
    )
    what.add_argument(
        "--report",
        type=Path,
        metavar="FILE.html",
        help="write an HTML report for reading and printing; write no recording",
    )
    what.add_argument(
        "--web",
        action="store_true",
        help="write the recording and show it in a browser on this machine, until Ctrl-C",
    )
    what.add_argument(
        "--live",
        action="store_true",
        help="show a run during the flight in a browser on this machine, until Ctrl-C",
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE.rrd",
        help=f"the recording to write (default: inspect.rrd, or {COMPARISON}, beside the first RUN)",
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools inspect`.

    Returns:
        0, or 2 if one of several inputs could not be read. With --live, 2 if a record could not be read, or
        not to its end.

    Raises:
        ConfigError: The options contradict each other, no input can be read, a file cannot be written, or
            rerun is not installed.
        PeerDataError: With --live, no record is undamaged and of this format version.
    """
    paths: list[Path] = args.run_folder
    _check(args, several=len(paths) > 1 and not (args.together or args.compare))
    if args.live:
        return live.follow(paths[0])
    runs = read_all(paths)
    if args.compare:
        _compare(runs, args)
    else:
        for one in [together(runs)] if args.together else runs:
            _show(one, args)
    return 0 if len(runs) == len(paths) else 2


def _check(args: argparse.Namespace, several: bool) -> None:
    """Raise ConfigError if the options contradict each other."""
    if args.save is not None and (args.summary or args.json or args.report or args.live):
        raise ConfigError(
            "--save cannot be combined with --summary, --json, --report or --live, which write no recording"
        )
    for name in ("save", "report", "web", "live"):
        if several and getattr(args, name):
            raise ConfigError(f"--{name} needs one run; for several runs add --together or --compare")
    if args.live and (args.together or args.compare):
        raise ConfigError("--live cannot be combined with --together or --compare")
    if args.compare and args.report:
        raise ConfigError("--report cannot be combined with --compare, because a report is about one run")


def _show(one: Run, args: argparse.Namespace) -> None:
    figures = summary.describe(one)
    if args.json:
        print(json.dumps(figures))
        return
    if args.report is not None:
        page.write(one, figures, args.report)
        print(f"wrote {args.report}")
        return
    terminal.show(figures, terminal.console())
    if not args.summary:
        path = args.save or one.recording
        recording.write(one, path)
        _wrote(path, args)


def _compare(runs: Sequence[Run], args: argparse.Namespace) -> None:
    differences = compare.compare(runs)
    if args.json:
        print(json.dumps(differences))
        return
    compare.show(differences, terminal.console())
    if not args.summary:
        path = args.save or runs[0].recording.with_name(COMPARISON)
        recording.write_comparison(runs, path)
        _wrote(path, args)


def _wrote(path: Path, args: argparse.Namespace) -> None:
    print(f"wrote {path}; open it with: rerun {path}")
    if args.web:
        web.serve(path)


def read_all(paths: Sequence[Path]) -> list[Run]:
    """Read every input that can be read. The errors of the others are printed to standard error.

    Raises:
        ConfigError: No input can be read.
    """
    runs = []
    for path in paths:
        try:
            runs.append(read_run(path))
        except ConfigError as error:
            if len(paths) == 1:
                raise
            print(f"skipped: {error}", file=sys.stderr)
    if not runs:
        raise ConfigError("none of the RUNs can be read")
    return runs
