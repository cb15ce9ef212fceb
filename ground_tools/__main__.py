"""Entry point of the installed `ground-tools` command."""

from __future__ import annotations

import sys

from companion.commands.entry_point import start


def main() -> int:
    """Run the command. Returns its exit code."""
    return start("ground_tools.cli")


if __name__ == "__main__":
    sys.exit(main())
