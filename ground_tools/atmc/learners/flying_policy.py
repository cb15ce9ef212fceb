"""Training of the set network: for the policy that flies, and for the paper's objective.

One pass through the channel equations gives the difference cost of every action
(`objective.difference_costs`), so no trial and error is needed. The network learns, from each aircraft's
observation, how much every action loses against the best one. Many fleets of different sizes are simulated in
parallel. At each update a random part of the aircraft of one group acts, mostly as the network decides.
Decisions fall at random phases, in training as in flight, because simultaneous decisions make the choices
oscillate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import torch
from msgspec import Meta
from torch import Tensor

from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS, Action
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.policy import Bounds, Metadata, Policy, encode, golden_of
from ground_tools.atmc.env.channel import TorchChannel
from ground_tools.atmc.env.environment import Env, EnvSettings, Observation
from ground_tools.atmc.env.objective import AwarenessObjective, Objective, PaperObjective, difference_costs
from ground_tools.atmc.env.tasks import AWARENESS_CHANNEL, legal_sets
from ground_tools.atmc.env.world import WorldSettings
from ground_tools.atmc.learners.set_network import SetNet
from ground_tools.atmc.learners.validation import Validation
from sitl_mocks.channel.parameters import ChannelParameters

_SILENCE_PRICE_S = 1e-4
"""Price of sending one message per second less. An aircraft that hears no other may just be unable to
receive, so it must remain easy to receive. Without this price, a fleet in which no message gets through would
stay silent forever."""
_TIE_PRICE = 0.01
"""Weight of an action's undisturbed delay, added to its cost. The paper's objective rates all actions equally
that reach no other aircraft. Without this weight, an aircraft whose nearest neighbour is just out of reach
might choose the slowest action."""
_IMPORTANCE = 0.1, 10.0
"""Least and greatest weight of an aircraft's training sample, relative to its fleet."""
_LOSS_SCALE = 50.0
"""Scales the loss so that gradient clipping takes effect at a sensible norm."""
_ALONE = 0.01
"""Sum of the conflict weights below which an aircraft counts as alone."""
_GOLDEN = 6
"""Greatest number of golden cases in a policy file."""

_PAPER_WORLD = EnvSettings(world=WorldSettings(sides="any"))
_FLYING_WORLD = EnvSettings(
    world=WorldSettings(
        sides="any",
        shadowing_sigma_db=(0.0, math.sqrt(6.0)),
        wifi_channels="either",
        load=(0.0, 0.8),
        bluetooth_load=(0.0, 0.7),
    ),
    positions="flown",
    step_s=2.0,
    lossy=True,
)


PAPER_FLEETS = ((3, 192), (5, 160), (10, 128), (20, 48), (50, 16))


Aircraft = Annotated[int, Meta(ge=2, le=1000)]
Positive = Annotated[int, Meta(ge=1)]
Rate = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, le=1)]


class FlyingSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything except the seed that determines a training run of the set network."""

    objective: Literal["paper", "awareness"] = "awareness"
    fleets: Annotated[tuple[tuple[Aircraft, Positive], ...], Meta(min_length=1)] = (
        (2, 512),
        (5, 384),
        (10, 240),
        (20, 64),
        (50, 16),
        (75, 9),
        (100, 8),
        (100, 8),
    )
    """Groups: aircraft per fleet, and number of such fleets simulated in parallel. All groups get the same
    share of the updates."""
    episodes: Positive = 80
    """Number of rounds, each of `updates` updates."""
    updates: Positive = 110
    """Updates per round."""
    learning_rate: tuple[Rate, Rate] = (1e-3, 1e-5)
    """First and last learning rate; it follows a cosine between them."""
    clip: Rate = 5.0
    """Greatest norm of the gradient."""
    average: Annotated[float, Meta(ge=0, lt=1)] = 0.998
    """Share of the running average of the weights that is kept at each update. The averaged weights are
    frozen into the policy file."""
    exploration: tuple[Share, Share] = (0.35, 0.05)
    """Share of random actions, first and last. Without random actions the network would only see situations
    in which all aircraft act alike, and would forget the consequences of other actions."""
    acting: tuple[Share, Share] = (0.2, 0.4)
    """Range of the share of a fleet's aircraft that act at an update; at least two aircraft act."""
    going_on: Share = 0.4
    """Share of the updates after which a group's aircraft move to their next positions."""
    anew: Share = 0.08
    """Share of the updates after which a group's environments are redrawn."""
    regret_limit_s: Rate = 1.0
    """Upper limit of an action's regret in the targets (s)."""
    switch_price_s: Annotated[float, Meta(ge=0, le=10)] = 0.01
    """Gain in Q value (s) that is required for a switch; not used in training."""
    masked: Share = 0.3
    """Awareness only: share of aircraft with random missing transports, in half of the environments."""


@dataclass(slots=True)
class _Group:
    """Fleets of one size."""

    env: Env
    allowed: Tensor
    """Which actions each aircraft may take, (E, N, actions)."""


class FlyingLearner:
    """Trains the set network. A `Learner`."""

    def __init__(self, settings: FlyingSettings, seed: int, device: torch.device | str = "cpu") -> None:
        self.settings = settings
        self.rounds, self.done = settings.episodes, 0
        self._device = torch.device(device)
        self._generator = torch.Generator(self._device).manual_seed(seed)
        awareness = settings.objective == "awareness"
        self._actions: tuple[Action, ...] = SET_ACTIONS if awareness else PAPER_ACTIONS
        parameters = AWARENESS_CHANNEL if awareness else ChannelParameters()
        channel = TorchChannel(parameters, self._actions, self._device)
        self._objective: Objective = AwarenessObjective(channel) if awareness else PaperObjective(channel)
        measured = ("success", "measured")
        self._own = [i for i, c in enumerate(OWN_COLUMNS) if awareness or not c.endswith(measured)]
        self._columns = [i for i, c in enumerate(NEIGHBOUR_COLUMNS) if awareness or c != "conflict"]
        torch.manual_seed(seed)
        self._net, self._average = (
            SetNet(len(self._columns), len(self._own), len(self._actions)).to(self._device) for _ in range(2)
        )
        self._average.load_state_dict(self._net.state_dict())
        self._optimiser = torch.optim.Adam(self._net.parameters(), settings.learning_rate[0])
        world = _FLYING_WORLD if awareness else _PAPER_WORLD
        self._groups = [
            self._group(Env(world, self._objective, fleets, aircraft, self._generator))
            for aircraft, fleets in settings.fleets
        ]
        widest = len(OWN_COLUMNS)
        self._bounds = torch.full((4, widest), torch.inf, device=self._device)
        """Observed minima. Rows: own columns, neighbour columns, and the negatives of both."""
        self._validation: Validation | None = None

    def _group(self, env: Env) -> _Group:
        """A group of these environments, with the actions that each aircraft may take."""
        shape, count = env.action.shape, len(self._actions)
        allowed = torch.ones((*shape, count), dtype=torch.bool, device=self._device)
        if self.settings.objective == "awareness":
            allowed = self._allowed(shape)
        return _Group(env, allowed)

    def _allowed(self, shape: Sequence[int]) -> Tensor:
        """Allowed actions for random regions (per environment) and radios (per aircraft), (E, N, actions)."""
        g, device = self._generator, self._device
        sets = torch.tensor(legal_sets(self._actions), device=device)
        region = torch.randint(len(sets), (shape[0],), generator=g, device=device)
        law = sets[region][:, None, :]
        lacks = torch.rand((*shape, 3), generator=g, device=device) < 0.5
        some = torch.rand((shape[0], 1, 1), generator=g, device=device) < 0.5
        whole = (torch.rand((*shape, 1), generator=g, device=device) >= self.settings.masked) | ~some
        lacks = (lacks & ~whole).to(torch.float32)
        uses = (self._objective.channel.rates > 0).to(torch.float32)
        possible = law & ((lacks @ uses.T) == 0)
        # An aircraft whose radios allow no legal action would not fly: give it all radios.
        return torch.where(possible.any(-1, keepdim=True), possible, law)

    # ------------------------------------------------------------ training

    def train(self) -> dict[str, float]:
        """Train for one round of updates. See `Learner.train`."""
        s = self.settings
        losses, regrets = [], []
        for update in range(s.updates):
            share = (self.done * s.updates + update) / (self.rounds * s.updates)
            first, last = s.learning_rate
            rate = last + (first - last) * 0.5 * (1.0 + math.cos(math.pi * share))
            self._optimiser.param_groups[0]["lr"] = rate
            group = self._groups[update % len(self._groups)]
            loss, regret = self._update(group, share)
            losses.append(loss)
            regrets.append(regret)
        self.done += 1
        return {
            "loss": float(torch.stack(losses).mean()),
            "regret_ms": 1e3 * float(torch.stack(regrets).mean()),
            "learning_rate": rate,
        }

    def _update(self, group: _Group, share: float) -> tuple[Tensor, Tensor]:
        """Train on the action costs of some aircraft of each fleet, and let these aircraft act.

        Returns the loss and the mean regret (s) of the network's choices.
        """
        s, env = self.settings, group.env
        acting = self._draw_acting(env.aircraft)
        allowed = group.allowed[:, acting]
        seen = self._select(env.observe().of(acting))
        self._note(seen)
        target = self._target(group, acting)
        values = self._net(seen.own, seen.rows, seen.heard)
        # Squared error, because its minimum is the mean: being deaf in a conflict is rare and costly, and a
        # loss that is robust to outliers would ignore it. All actions have equal weight, because a bad action
        # that is learned less accurately could be mistaken for a good one.
        error = (values - target).square()
        weight = allowed * self._importance(group, acting)[..., None]
        loss = _LOSS_SCALE * (error * weight).sum() / weight.sum()
        self._optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._net.parameters(), s.clip)
        self._optimiser.step()
        with torch.no_grad():
            done = self.done * s.updates
            keep = min(s.average, (1.0 + done) / (10.0 + done))
            for mean, now in zip(self._average.parameters(), self._net.parameters(), strict=True):
                mean.lerp_(now, 1.0 - keep)
            greedy = values.masked_fill(~allowed, -torch.inf).argmax(-1)
            regret = -target.gather(-1, greedy[..., None]).mean()
            self._act(group, acting, greedy, share)
        return loss.detach(), regret

    def _draw_acting(self, aircraft: int) -> Tensor:
        """Draw the indices of the aircraft that act.

        The indices are the same in all fleets of a group. Their positions are random anyway.
        """
        low, high = self.settings.acting
        share = low + (high - low) * float(torch.rand((), generator=self._generator, device=self._device))
        count = min(aircraft, max(2, round(share * aircraft)))
        return torch.randperm(aircraft, generator=self._generator, device=self._device)[:count]

    def _importance(self, group: _Group, acting: Tensor) -> Tensor:
        """Weight of each acting aircraft's sample relative to its fleet, (E, acting).

        For awareness, targets are normalised by the total conflict weight of the other aircraft, but the
        fleet's loss is not; this weight compensates for it. An aircraft that hears no other may be alone,
        which is likely and harmless, or deaf in a conflict, which is rare and matters.
        """
        if self.settings.objective == "paper":
            return torch.ones(group.env.environments, len(acting), device=self._device)
        others = _ALONE + group.env.air.weight.sum(1)
        low, high = _IMPORTANCE
        return (others[:, acting] / others.mean(1, keepdim=True)).clamp(low, high)

    def _target(self, group: _Group, acting: Tensor) -> Tensor:
        """Negative regret (s) of every action, (E, acting, actions); 0 for the best allowed action."""
        env, allowed = group.env, group.allowed[:, acting]
        _, cost = difference_costs(self._objective, env.air, env.action, acting)
        if self.settings.objective == "awareness":
            # Normalise by the total conflict weight of the others, which gives a mean age in seconds.
            cost = cost / (_ALONE + env.air.weight.sum(1)[:, acting])[..., None]
            cost = cost - _SILENCE_PRICE_S * self._objective.channel.rates.sum(1)
        else:
            cost = cost + _TIE_PRICE * self._objective.channel.undisturbed_s()
        least = cost.masked_fill(~allowed, torch.inf).amin(-1, keepdim=True)
        # A forbidden action may be better than the best allowed one; the loss ignores it.
        return -(cost - least).clamp(min=0.0, max=self.settings.regret_limit_s)

    def _act(self, group: _Group, acting: Tensor, greedy: Tensor, share: float) -> None:
        """Apply the choices, some of them replaced by random ones; sometimes move or redraw the group."""
        s, env, g, device = self.settings, group.env, self._generator, self._device
        explore = s.exploration[1] + (s.exploration[0] - s.exploration[1]) * (1.0 - share)
        allowed = group.allowed[:, acting]
        chance = (torch.rand(allowed.shape, generator=g, device=device) * allowed).argmax(-1)
        exploring = torch.rand(greedy.shape, generator=g, device=device) < explore
        env.action = env.action.clone()
        env.action[:, acting] = torch.where(exploring, chance, greedy)
        draw = float(torch.rand((), generator=g, device=device))
        if draw < s.anew:
            env.reset()
            group.allowed = self._group(env).allowed
        elif draw < s.anew + s.going_on:
            env.go_on()

    def _select(self, seen: Observation) -> Observation:
        return Observation(seen.own[..., self._own], seen.rows[..., self._columns], seen.heard)

    def _note(self, seen: Observation) -> None:
        """Update the bounds of the observed values."""
        own = seen.own.reshape(-1, seen.own.shape[-1])
        rows = seen.rows[seen.heard > 0]
        for index, values in enumerate((own, rows)):
            if len(values):
                for sign, at in ((1.0, index), (-1.0, index + 2)):
                    known = self._bounds[at, : values.shape[1]]
                    known.copy_(torch.minimum(known, (sign * values).amin(0)))

    # ------------------------------------------------------------ measuring, keeping, freezing

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """Choice of the averaged network, with all actions allowed; see `Decider.decide`."""
        chosen = self._select(seen)
        with torch.no_grad():
            values: Tensor = self._average(chosen.own, chosen.rows, chosen.heard)
        return values.argmax(-1)

    def validate(self) -> dict[str, float]:
        """See `Learner.validate`. "score" is the mean cost beyond the best fixed mode (%) over fleet
        sizes."""
        if self._validation is None:
            self._validation = Validation(self._objective, self.settings.objective, seed=1_000_003)
        return self._validation.measure(self)

    def state(self) -> dict[str, Any]:
        """See `Learner.state`."""
        return {
            "done": self.done,
            "net": self._net.state_dict(),
            "average": self._average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "generator": self._generator.get_state(),
            "bounds": self._bounds,
            "groups": [{"env": g.env.state(), "allowed": g.allowed} for g in self._groups],
        }

    def load(self, state: dict[str, Any]) -> None:
        """See `Learner.load`."""
        self.done = state["done"]
        self._net.load_state_dict(state["net"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._generator.set_state(state["generator"])
        self._bounds = state["bounds"].to(self._device)
        for group, kept in zip(self._groups, state["groups"], strict=True):
            group.env.load(kept["env"])
            group.allowed = kept["allowed"].to(self._device)

    def frozen(self, name: str, results: dict[str, float]) -> bytes:
        """See `Learner.frozen`."""
        s = self.settings
        tensors = {k: v.detach().cpu().numpy().copy() for k, v in self._average.state_dict().items()}
        metadata = Metadata(
            kind="set",
            objective=s.objective,
            decisions="phases",
            name=name,
            neighbours=max(aircraft for aircraft, _ in s.fleets) - 1,
            neighbour_columns=tuple(NEIGHBOUR_COLUMNS[i] for i in self._columns),
            own_columns=tuple(OWN_COLUMNS[i] for i in self._own),
            actions=self._actions,
            regions=("none", "us", "eu") if s.objective == "awareness" else (),
            switch_price=s.switch_price_s,
            bounds=self._frozen_bounds(),
            results=results,
            golden=(),
        )
        golden = [golden_of(Policy(metadata, tensors, name), *case) for case in self._cases()]
        return encode(msgspec.structs.replace(metadata, golden=tuple(golden)), tensors)

    def _frozen_bounds(self) -> Bounds:
        own, columns = len(self._own), len(self._columns)
        low, high = self._bounds[:2], -self._bounds[2:]
        return Bounds(
            own_low=tuple(low[0, :own].tolist()),
            own_high=tuple(high[0, :own].tolist()),
            neighbour_low=tuple(low[1, :columns].tolist()),
            neighbour_high=tuple(high[1, :columns].tolist()),
        )

    def _cases(self) -> list[tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]]:
        """Observations for the golden cases, of the first aircraft of fleets of different sizes."""
        cases = []
        for group in self._groups[:_GOLDEN]:
            seen = group.env.observe()
            heard = seen.heard[0, 0] > 0
            cases.append(
                (seen.own[0, 0].cpu().double().numpy(), seen.rows[0, 0][heard].cpu().double().numpy())
            )
        return cases
