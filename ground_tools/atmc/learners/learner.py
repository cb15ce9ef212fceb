"""The interface between the training loop (`ground_tools.atmc.learners.training`) and an algorithm."""

from __future__ import annotations

from typing import Any, Protocol


class Learner(Protocol):
    """One training run of one algorithm."""

    rounds: int
    """Number of `train` calls in the whole run: episodes, or rounds of another kind."""
    done: int
    """Number of `train` calls done so far."""

    def train(self) -> dict[str, float]:
        """Train for one round. Returns the values for metrics.csv, with the same keys every time."""
        ...

    def validate(self) -> dict[str, float]:
        """Measure the current policy on a fixed validation set.

        Returns:
            "score" (lower is better) and further columns for metrics.csv, with the same keys every time.
        """
        ...

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the run depends on, for `torch.save`.

        This includes networks, optimisers, the replay buffer, the states of all random generators, and
        `done`.
        """
        ...

    def load(self, state: dict[str, Any]) -> None:
        """Continue from a `state`; the results are the same bit for bit."""
        ...

    def frozen(self, name: str, results: dict[str, float]) -> bytes:
        """The current policy as a file of `companion.atmc.policy`.

        Args:
            name: Name of the run, for messages.
            results: Results of `validate` for this policy, as information for people.
        """
        ...
