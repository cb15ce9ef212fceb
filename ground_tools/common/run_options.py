"""Options shared by several commands: a range of seeds, and worker processes or a Ray cluster."""

from __future__ import annotations

import argparse
import os
import re

from companion.errors import ConfigError

_MOST_SEEDS = 1_000_000


def seeds_of(text: str) -> range:
    """The seeds of `--seeds FROM-TO`.

    Raises:
        ConfigError: the text is not a rising range of at most a million seeds.
    """
    match = re.fullmatch(r"(\d+)-(\d+)", text)
    if match is None or not int(match[1]) <= int(match[2]) < int(match[1]) + _MOST_SEEDS:
        raise ConfigError(
            f"--seeds: {text} is not allowed; "
            f"allowed: a rising range of at most {_MOST_SEEDS:,} seeds, such as 1-100"
        )
    return range(int(match[1]), int(match[2]) + 1)


def processes_of(asked: int | None, option: str = "processes") -> int:
    """Number of worker processes; one per core if the option is not given.

    Raises:
        ConfigError: the number is out of range.
    """
    if asked is not None and not 1 <= asked <= 1024:
        raise ConfigError(f"--{option}: {asked} is out of range; allowed: 1 to 1024")
    return asked or os.cpu_count() or 1


def add_ray(parser: argparse.ArgumentParser) -> None:
    """Add the option `--ray`."""
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="fly on a Ray cluster: HOST:PORT on a machine of the cluster, ray://HOST:PORT elsewhere",
    )


def processes_unless_ray(asked: int | None, ray: str | None, option: str = "processes") -> int | None:
    """Number of worker processes as `processes_of` gives it; None on a Ray cluster, which uses all of its
    CPUs.

    Raises:
        ConfigError: the number is out of range, or both options are given.
    """
    if ray is None:
        return processes_of(asked, option)
    if asked is not None:
        raise ConfigError(f"--{option} cannot be combined with --ray, which uses all CPUs of the cluster")
    return None
