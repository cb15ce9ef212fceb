"""`ground-tools inspect RUN...`: a run folder as a Rerun recording, or as figures in words or JSON."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from companion.errors import ConfigError
from ground_tools.inspect import compare, recording, report, summary, tables
from ground_tools.inspect.read_run import read_run

EXAMPLE = "example: ground-tools inspect runs/20260101T000000Z-demo, then: rerun runs/.../inspect.rrd"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `ground-tools inspect`."""
    parser.description = "Show what was flown, heard, predicted and decided in a run."
    parser.epilog = EXAMPLE
    parser.add_argument("run_folder", nargs="+", type=Path, metavar="RUN", help="run folder")
    parser.add_argument(
        "--save", type=Path, metavar="FILE.rrd", help="recording of one run (default: RUN/inspect.rrd)"
    )
    parser.add_argument("--summary", action="store_true", help="print the figures and write no recording")
    parser.add_argument(
        "--compare", action="store_true", help="print how two or more runs differ, aligned at take-off"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE.html",
        help="write one run as a page that prints, and no recording",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="like --summary (--compare: that), one JSON object per run and line",
    )


def run(args: argparse.Namespace) -> int:
    """`ground-tools inspect`. Returns 0.

    Raises:
        ConfigError: a folder that is no run, a file that cannot be written, or rerun is not installed.
    """
    folders: list[Path] = args.run_folder
    figures_only = args.summary or args.json
    if args.save is not None and (len(folders) > 1 or figures_only):
        raise ConfigError("--save: goes with one run, and not with --summary or --json")
    if args.compare:
        if args.save is not None or args.report is not None:
            raise ConfigError("--compare: goes with neither --save nor --report")
        differences = compare.compare([read_run(folder) for folder in folders])
        if args.json:
            print(json.dumps(differences))
        else:
            compare.show(differences, tables.console())
        return 0
    if args.report is not None:
        if len(folders) > 1 or args.save is not None:
            raise ConfigError("--report: goes with one run, and not with --save")
        one = read_run(folders[0])
        report.write(one, summary.describe(one), args.report)
        print(f"wrote {args.report}")
        return 0
    for folder in folders:
        one = read_run(folder)
        if args.json:
            print(json.dumps(summary.describe(one)))
            continue
        tables.show(summary.describe(one), tables.console())
        if not figures_only:
            path = args.save or folder / "inspect.rrd"
            recording.write(one, path)
            print(f"wrote {path}; open it with: rerun {path}")
    return 0
