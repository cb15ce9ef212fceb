"""`python -m bench.commands.convert_run KIND RUN FILE`: makes one product of a run in this process.

KIND is recording, summary or report. It prints the peak memory in units of 10^6 bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench.measuring.memory import memory_mb
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import page, summary
from ground_tools.inspect.viewer import recording


def main(kind: str, folder: str, path: str) -> None:
    """Make the product and print the peak memory."""
    run = read_run(Path(folder))
    if kind == "recording":
        recording.write(run, Path(path))
    else:
        figures = summary.describe(run)
        if kind == "report":
            page.write(run, figures, Path(path))
    print(memory_mb("VmHWM"))


if __name__ == "__main__":
    main(*sys.argv[1:])
