"""Thinned results of training runs in one small file (gzipped JSON), the source of the paper's figures.

This module does not need PyTorch.
"""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Final

import msgspec

from companion.errors import ConfigError
from companion.shipped import shipped

CONVERGENCE: Final = shipped("results/atmc/convergence.json.gz")
"""Results file of the paper's algorithms."""
NAMES: Final = {
    "madqn": "MADQN-ATMC",
    "madqn-shared": "MADQN-ATMC, one network",
    "maddpg": "MADDPG",
    "iac": "IAC",
}
"""Display names of the paper's algorithms."""
UAV_EVERY: Final = 10
"""Number of episodes over which each aircraft's values are averaged."""


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common base of all parts of the file."""


class Run(_Part, frozen=True, kw_only=True):
    """One seed of one algorithm. Rewards (s) and delays (ms) are means per step, with exploration."""

    algorithm: str
    seed: int
    git_commit: str | None
    settings: dict[str, object]
    seconds: float
    """Training time; other programs may have run on that machine."""
    reward: tuple[float, ...]
    """Reward of the fleet, by episode."""
    delay_ms: tuple[float, ...]
    """System delay of the fleet, by episode."""
    reward_uav: tuple[tuple[float, ...], ...]
    """Reward of each aircraft, as means over `UAV_EVERY` episodes."""
    validation: tuple[tuple[int, float], ...]
    """Episode and system delay (ms) of the policy without exploration."""
    best: dict[str, float]
    """Delays (ms) of the policy with the best validation, on new environments; see `paper_task.measure`."""
    last: dict[str, float]
    """The same for the policy at the end of the run."""
    best_delay_uav_ms: tuple[float, ...] = ()
    """Mean delay of each aircraft over all six squares with the best policy."""


class Results(_Part, frozen=True, kw_only=True):
    """The contents of the file: all runs."""

    configurations: int
    """Number of environments in each of the six squares for `best` and `last`."""
    runs: tuple[Run, ...]

    def of(self, algorithm: str) -> list[Run]:
        """The runs of this algorithm, ordered by seed."""
        return sorted((run for run in self.runs if run.algorithm == algorithm), key=lambda run: run.seed)


def read(path: Path = CONVERGENCE) -> Results:
    """Read the file.

    Raises:
        ConfigError: The file cannot be read, or is not a file of results.
    """
    try:
        return msgspec.json.decode(gzip.decompress(path.read_bytes()), type=Results)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (EOFError, ValueError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: this is not a results file: {error}") from error


def write(path: Path, results: Results) -> None:
    """Write the file. The same results give the same bytes.

    Raises:
        ConfigError: The file cannot be written.
    """
    data = gzip.compress(msgspec.json.encode(results), 9, mtime=0)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
