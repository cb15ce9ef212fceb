"""What the training loop asks of an algorithm; see `ground_tools.atmc.learners.training`."""

from __future__ import annotations

from typing import Any, Protocol


class Learner(Protocol):
    """One training run of one algorithm."""

    rounds: int
    """How many calls of `train` the whole run takes: episodes, or rounds of another kind."""
    done: int
    """How many of them are behind."""

    def train(self) -> dict[str, float]:
        """One round. Returns what goes into metrics.csv, the same keys every time."""
        ...

    def validate(self) -> dict[str, float]:
        """Measure the present policy on a fixed validation set.

        Returns:
            "score", of which less is better, and what else is worth a column, the same keys every time.
        """
        ...

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the run depends on, for `torch.save`: networks, optimisers, replay
        buffer, states of all random sources, `done`."""
        ...

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a `state`, bit for bit."""
        ...

    def frozen(self, name: str, results: dict[str, float]) -> bytes:
        """The present policy as a file of `companion.atmc.policy`.

        Args:
            name: of the run, for messages.
            results: what `validate` gave for it, for people.
        """
        ...
