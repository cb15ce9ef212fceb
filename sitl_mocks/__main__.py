"""Entry point of the installed command `sitl-mocks`."""

from __future__ import annotations

import sys

from companion.commands.entry_point import start


def main() -> int:
    """Run the command. Returns the exit code."""
    return start("sitl_mocks.cli")


if __name__ == "__main__":
    sys.exit(main())
