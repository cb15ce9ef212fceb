"""Entry point of the installed `ground-tools` command."""

from __future__ import annotations

import os
import sys

from companion.commands.entry_point import start


def main() -> int:
    """Run the command. Returns its exit code.

    NumPy multiplies in one thread, unless the environment says otherwise: the networks here are so small that
    further threads only wait for each other.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return start("ground_tools.cli")


if __name__ == "__main__":
    sys.exit(main())
