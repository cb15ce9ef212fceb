"""What the learners of the paper's task have in common: choosing, measuring, keeping and freezing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Final

import torch
from torch import Tensor

from ground_tools.atmc.env.paper_task import PaperTask
from ground_tools.atmc.learners.replay_buffer import Replay
from ground_tools.atmc.learners.stack import Stack, frozen

_LEAST_DELAY_S: Final = 0.02
"""Added to a delay before its logarithm is taken. It is shorter than any delay that matters."""


def log_reward(cost_s: Tensor) -> Tensor:
    """Minus the logarithm of each aircraft's delay (s) plus 0.02 s, in the shape of the argument.

    Halving a short delay then counts as much as halving a long one, whereas the paper's reward is ruled by
    the few places in which delays are long.
    """
    return -(cost_s + _LEAST_DELAY_S).log()


class PaperLearner(ABC):
    """A `Learner` without its training."""

    done: int
    replay: Replay | None = None
    _task: PaperTask
    _generator: torch.Generator

    @property
    @abstractmethod
    def _chooser(self) -> Stack:
        """Networks whose highest output is the choice."""

    @abstractmethod
    def _parts(self) -> dict[str, Stack | torch.optim.Optimizer]:
        """Networks and optimisers to keep, by name."""

    def _best(self, seen: Tensor) -> Tensor:
        """Choices of the highest output: (E, N, inputs) to (E, N)."""
        with torch.no_grad():
            return self._chooser.of_all(seen).argmax(-1)

    def validate(self) -> dict[str, float]:
        """Measure the delays (ms) of the choices of the highest output. See `Learner.validate`."""
        return self._task.validate(self._best)

    def state(self) -> dict[str, Any]:
        """See `Learner.state`."""
        return {
            "done": self.done,
            "generator": self._generator.get_state(),
            **({} if self.replay is None else {"replay": self.replay.state()}),
            **{name: part.state_dict() for name, part in self._parts().items()},
        }

    def load(self, state: dict[str, Any]) -> None:
        """See `Learner.load`."""
        self.done = state["done"]
        self._generator.set_state(state["generator"])
        if self.replay is not None:
            self.replay.load(state["replay"])
        for name, part in self._parts().items():
            part.load_state_dict(state[name])

    def frozen(self, name: str, results: dict[str, float]) -> bytes:
        """See `Learner.frozen`."""
        return frozen(self._chooser, self._task.actions, name, results, self._task.examples())
