"""The environment in which policies are trained and measured.

It holds many fleets in parallel; tensors are indexed [environment, aircraft, ...]. It follows the section
"MDP Transformation" of the paper. In each step the aircraft observe, some or all of them choose an action,
and the channel model gives the delays. Then positions are redrawn, as in the paper, or the aircraft fly on.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import msgspec
import torch
from torch import Tensor

from companion.atmc.observation import conflict_weight, neighbour_rows, own_row
from companion.atmc.senses import FEWEST_EXPECTED, FEWEST_SENDERS, SCAN_SHARE
from companion.traffic.senders.reception import HEARD_S, SHARE_MEMORY_S
from ground_tools.atmc.env.channel import Packets, TorchChannel
from ground_tools.atmc.env.objective import Air, Objective, costs
from ground_tools.atmc.env.world import World, WorldSettings, draw, move, redraw


class EnvSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How environments are drawn and how they change from step to step."""

    world: WorldSettings = WorldSettings()
    positions: Literal["redrawn", "flown"] = "redrawn"
    """What happens between two steps: "redrawn" puts all aircraft at new random positions, as in the paper;
    "flown" lets them fly for `step_s`."""
    side_drawn: Literal["step", "episode"] = "step"
    """When the side of the square is redrawn."""
    step_s: float = 1.0
    """Flight time between two steps (s)."""
    lossy: bool = False
    """Whether reception is random. If so, an aircraft observes only the neighbours whose messages it happened
    to receive, and it measures the share of packets that get through. If not, it observes all in range."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Observations of all aircraft, in the columns of `companion.atmc.observation`."""

    own: Tensor
    """(E, N, 16)."""
    rows: Tensor
    """(E, N, N, 8), indexed by observer and neighbour."""
    heard: Tensor
    """(E, N, N), 1 where the observer hears the neighbour, so that the row is valid."""

    def of(self, observers: Tensor) -> Observation:
        """The observations of the aircraft with these indices."""
        return Observation(self.own[:, observers], self.rows[:, observers], self.heard[:, observers])


class Env:
    """Many fleets of one size.

    Args:
        settings: How environments are drawn and how they change.
        objective: Gives the costs, and the channel with its actions.
        environments: Number of fleets (E).
        aircraft: Aircraft per fleet (N).
        generator: Source of all random numbers; all tensors are on its device.
    """

    def __init__(
        self,
        settings: EnvSettings,
        objective: Objective,
        environments: int,
        aircraft: int,
        generator: torch.Generator,
    ) -> None:
        self.settings = settings
        self.objective = objective
        self.environments, self.aircraft = environments, aircraft
        self._generator = generator
        self._others = 1.0 - torch.eye(aircraft, device=generator.device)
        self.reset()

    @property
    def channel(self) -> TorchChannel:
        """The objective's channel, with its actions."""
        return self.objective.channel

    def reset(self) -> None:
        """Draw new environments.

        With probability one half, all aircraft of an environment start with one common random action;
        otherwise each starts with a random action of its own.
        """
        shape, device = (self.environments, self.aircraft), self._generator.device
        actions = len(self.channel.actions)
        each, alike = (
            torch.randint(actions, size, generator=self._generator, device=device)
            for size in (shape, (shape[0], 1))
        )
        uniform = torch.rand((shape[0], 1), generator=self._generator, device=device) < 0.5
        self.action = torch.where(uniform, alike, each)
        """Current action of each aircraft, (E, N), as indices into the channel's actions."""
        identity = torch.randint(2, (*shape, 4), generator=self._generator, device=device)
        self.identity = identity.to(torch.float32) * 2.0 - 1.0
        self.place(draw(self.settings.world, *shape, self._generator))

    def place(self, world: World) -> None:
        """Continue in this world."""
        self.world = world
        self._distance = world.distance_m()
        loss = path_loss_db(self._distance, self.channel) + world.shadowing_db
        reach = self.channel.reach(loss, world.wifi_channel, world.busy)
        self._conflict = conflict_weight(torch, self._distance, world.closing_mps(self._distance))
        self.air = Air(reach, self._conflict * self._others)

    def observe(self) -> Observation:
        """Current observations of all aircraft."""
        rates = self.channel.rates[self.action]
        reach = torch.stack(self.air.reach.modes, -1)
        packets = None
        if self.settings.lossy:
            loads = self.channel.loads(self.air.reach, self.action)
            packets = self.channel.packets(self.air.reach, loads)
        on = (rates > 0)[:, None].to(torch.float32) * reach
        if packets is not None:
            on = on * self._received(packets)
        rows = neighbour_rows(torch, self._distance, self._conflict, rates[:, None] * on)
        success, measured = self._success(on, packets)
        return Observation(own_row(torch, rates, success, measured, self.identity), rows, on.amax(-1))

    def _received(self, packets: Packets) -> Tensor:
        """Draw on which transports a message was received recently, (E, receiver, sender, 3)."""
        level = self.channel.level_of[self.action][:, None]
        delays = [self.channel.log_delay_at(mode, level[..., mode], packets) for mode in range(3)]
        missing = torch.exp(-HEARD_S * torch.exp(-torch.stack(delays, -1)))
        luck = torch.rand(missing.shape, generator=self._generator, device=missing.device)
        return (luck >= missing).to(torch.float32)

    def _success(self, on: Tensor, packets: Packets | None) -> tuple[Tensor, Tensor]:
        """Measured share of surviving packets of the heard senders, and where it is known, each (E, N, 3).

        Packets are counted as `companion.atmc.senses.SuccessMeter` does aboard when few senders are near. In
        a crowd the measurement aboard is more precise, because it counts all senders within `NEAR_M`.
        """
        shape = (*self.action.shape, 3)
        if packets is None:
            # Aircraft in the paper do not measure packet survival.
            return on.new_zeros(shape), on.new_zeros(shape)
        p = packets
        alive = torch.exp(torch.stack([p.ble4, p.pointer + p.auxiliary, p.wifi], -1))
        heard = on.sum(2)
        counted = heard.clamp(min=1.0, max=float(FEWEST_SENDERS)) / heard.clamp(min=1.0)
        rates = self.channel.rates[self.action][:, None]
        expected = SHARE_MEMORY_S * counted * (rates * on).sum(2)
        measured = (expected >= FEWEST_EXPECTED).to(torch.float32)
        # Draw a Poisson count, because a share from few arrivals is noisy.
        whole = expected * torch.tensor(SCAN_SHARE, device=on.device)
        mean = (alive * on).sum(2) / heard.clamp(min=1.0)
        arrived = torch.poisson(whole * mean, generator=self._generator)
        return (arrived / whole.clamp(min=1e-6)).clamp(max=1.0), measured

    def act(self, action: Tensor, moving: Tensor | None = None) -> Tensor:
        """Change the actions; positions do not change.

        Args:
            action: New actions, (E, N).
            moving: Which aircraft take their new action, (E, N); None for all.

        Returns:
            Cost (s) of each aircraft's messages, (E, N).
        """
        self.action = action if moving is None else torch.where(moving, action, self.action)
        return costs(self.objective, self.air, self.action)

    def state(self) -> dict[str, Any]:
        """The complete state except the generator, for `load`."""
        world = {f.name: getattr(self.world, f.name) for f in fields(self.world)}
        return {"world": world, "action": self.action, "identity": self.identity}

    def load(self, state: dict[str, Any]) -> None:
        """Restore a state that `state` returned."""
        device = self._generator.device
        self.action, self.identity = state["action"].to(device), state["identity"].to(device)
        self.place(World(**{name: part.to(device) for name, part in state["world"].items()}))

    def go_on(self) -> None:
        """Advance to the next positions."""
        s = self.settings
        if s.positions == "flown":
            self.place(move(self.world, s.step_s))
        elif s.side_drawn == "step":
            self.place(draw(s.world, self.environments, self.aircraft, self._generator))
        else:
            self.place(redraw(self.world, self._generator))


def path_loss_db(distance_m: Tensor, channel: TorchChannel) -> Tensor:
    """Log-distance path loss without shadowing (dB)."""
    p = channel.parameters.propagation
    return p.loss_at_1m_db + 10.0 * p.exponent * torch.log10(distance_m)


def paper_reward(cost_s: Tensor, reaches: Tensor, local: float = 1.0, shared: float = 1.0) -> Tensor:
    """The paper's reward, alpha r_local + beta r_global (section "Reward Function"), in seconds.

    Args:
        cost_s: (E, N), mean delay of each aircraft to those it reaches.
        reaches: (E, N), whether the aircraft reaches any other. If not, its reward is 0, because both parts
            are sums over the aircraft that it reaches.
        local: Weight alpha.
        shared: Weight beta.
    """
    mean = cost_s.mean(1, keepdim=True)
    return (-local * cost_s + shared * (mean - cost_s)) * reaches
