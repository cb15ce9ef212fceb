"""`python -m bench [NAME ...]`: runs the named benchmarks, or all, and prints a table for each.

Each benchmark runs in a separate process, so that its modules and memory do not affect the next one. Lines
that begin with "target" show a figure beside its target. The exit code is 1 if one of them says NOT MET, and
if a benchmark failed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from importlib import import_module

from bench.measuring.figures import Missed, reference_s

NAMES = (
    "avoidance",
    "core",
    "flood",
    "gate",
    "aboard",
    "display",
    "lockstep",
    "remote_id",
    "channel",
    "atmc",
    "inspect",
    "links",
    "city",
)


def main() -> int:
    """Run the benchmarks. Returns 1 if one of them failed or missed a target, else 0."""
    parser = argparse.ArgumentParser(
        prog="python -m bench", description="Runs benchmarks and prints their figures as tables."
    )
    parser.add_argument("name", nargs="*", help=f"benchmarks to run (default: all): {', '.join(NAMES)}")
    names = parser.parse_args().name or NAMES
    unknown = [name for name in names if name not in NAMES]
    if unknown:
        parser.error(f"there is no benchmark {', '.join(unknown)}; allowed: {', '.join(NAMES)}")
    if len(names) == 1:
        module = import_module(f"bench.bench_{names[0]}")
        print(f"\n== {(module.__doc__ or '').splitlines()[0]}\n")
        print(f"reference loop (bench.measuring.figures), CPU: {1e3 * reference_s():.0f} ms\n", flush=True)
        module.main()
        return 1 if Missed.count else 0
    return max([subprocess.run([sys.executable, "-m", "bench", name]).returncode != 0 for name in names])


if __name__ == "__main__":
    sys.exit(main())
