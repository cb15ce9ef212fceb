"""What training runs gave, thinned, in one small file (gzipped JSON) that the paper's figures are drawn from.

Nothing here needs PyTorch.
"""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Final

import msgspec

from companion.errors import ConfigError

CONVERGENCE: Final = Path(__file__).parents[3] / "results" / "atmc" / "convergence.json.gz"
"""Of the paper's algorithms."""
NAMES: Final = {
    "madqn": "MADQN-ATMC",
    "madqn-shared": "MADQN-ATMC, one network",
    "maddpg": "MADDPG",
    "iac": "IAC",
}
"""The paper's algorithms, for people."""
UAV_EVERY: Final = 10
"""Episodes that a mean for each aircraft stands for."""


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common to all parts."""


class Run(_Part, frozen=True, kw_only=True):
    """One seed of one algorithm. Rewards (s) and delays (ms) are means of a step, while exploring."""

    algorithm: str
    seed: int
    git_commit: str | None
    settings: dict[str, object]
    seconds: float
    """Of work, with what else ran on that machine."""
    reward: tuple[float, ...]
    """Of the fleet, by episode."""
    delay_ms: tuple[float, ...]
    reward_uav: tuple[tuple[float, ...], ...]
    """Of each aircraft, means of `UAV_EVERY` episodes."""
    validation: tuple[tuple[int, float], ...]
    """Episode and system delay (ms) of the policy without exploration."""
    best: dict[str, float]
    """The policy of the best validation, measured on new environments; see `paper_task.measure`."""
    last: dict[str, float]
    """The same of the policy at the end of the run."""
    best_delay_uav_ms: tuple[float, ...] = ()
    """The best policy's mean delay of each aircraft over all six squares."""


class Results(_Part, frozen=True, kw_only=True):
    """All runs."""

    configurations: int
    """Environments of each of the six squares in `best` and `last`."""
    runs: tuple[Run, ...]

    def of(self, algorithm: str) -> list[Run]:
        """Its runs, by seed."""
        return sorted((run for run in self.runs if run.algorithm == algorithm), key=lambda run: run.seed)


def read(path: Path = CONVERGENCE) -> Results:
    """Read the file.

    Raises:
        ConfigError: it cannot be read, or holds something else.
    """
    try:
        return msgspec.json.decode(gzip.decompress(path.read_bytes()), type=Results)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (EOFError, ValueError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: not a file of results: {error}") from error


def write(path: Path, results: Results) -> None:
    """Write the file, the same bytes for the same results.

    Raises:
        ConfigError: it cannot be written.
    """
    data = gzip.compress(msgspec.json.encode(results), 9, mtime=0)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
