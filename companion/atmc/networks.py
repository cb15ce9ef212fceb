"""The networks of a policy: they map an observation to a value for each action, in NumPy (float32).

There are two kinds. A "set" network takes any number of neighbours: each row passes through the same small
network, and the outputs are pooled. A "flat" network is the paper's: its input has a fixed length and holds
the neighbours sorted by distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Protocol

import numpy as np

from companion.arrays import Float32s
from companion.errors import ConfigError

Tensors = Mapping[str, Float32s]

MAX_WIDTH: Final = 2048
"""Most outputs of a layer. A wider one, evaluated for each of many neighbours, would delay the flight
loop."""
SET_LAYERS: Final = ("phi0", "phi1", "rho0", "rho1", "out")


class PolicyError(ConfigError):
    """A policy cannot be used; the message names the file and what is wrong with it."""


class Network(Protocol):
    """Maps the columns that a policy selects from an observation to a value for each action."""

    def values(self, own: Float32s, rows: Float32s, agent: int) -> Float32s:
        """Value of each action, shape (actions,).

        Args:
            own: shape (own columns,).
            rows: shape (neighbours, neighbour columns). For a "flat" network nearest first, and not more than
                its input holds.
            agent: which network to use, if each aircraft has its own.
        """
        ...


class SetNetwork:
    """Network for any number of neighbours, shared by all aircraft.

    For each neighbour h = relu(phi1(relu(phi0(row)))). The pooled vector is (log1p(sum of h), max of h), or
    zeros if there are no neighbours. The output is out(relu(rho1(relu(rho0(pooled, own row))))).

    Raises:
        PolicyError: tensors are missing or unknown, or their shapes do not match.
    """

    def __init__(self, tensors: Tensors, own: int, columns: int, actions: int, name: str) -> None:
        wanted = {f"{layer}.{part}" for layer in SET_LAYERS for part in ("weight", "bias")}
        _check_names(tensors, wanted, name)
        size, layers = columns, {}
        for layer in SET_LAYERS:
            if layer == "rho0":
                self._hidden = size
                size = 2 * size + own
            layers[layer] = _linear(tensors, layer, size, (), name)
            size = layers[layer][0].shape[1]
        _check_actions(size, actions, name)
        self._phi = (layers["phi0"], layers["phi1"])
        self._rho = (layers["rho0"], layers["rho1"])
        self._out = layers["out"]

    def values(self, own: Float32s, rows: Float32s, agent: int) -> Float32s:
        """See `Network`. `agent` is ignored, because one network serves all aircraft."""
        size = self._hidden
        z = np.zeros(2 * size + len(own), np.float32)
        if len(rows):
            h = rows
            for weight, bias in self._phi:
                h = h @ weight
                h += bias
                np.maximum(h, 0.0, out=h)
            np.log1p(h.sum(axis=0), out=z[:size])
            h.max(axis=0, out=z[size : 2 * size])
        z[2 * size :] = own
        for weight, bias in self._rho:
            z = z @ weight
            z += bias
            np.maximum(z, 0.0, out=z)
        weight, bias = self._out
        q: Float32s = z @ weight + bias
        return q


class FlatNetwork:
    """Fully connected network with relu between its layers, for a fixed number of neighbours.

    The input is the own row, then for each neighbour its columns and a 1; unused places are zero.

    Raises:
        PolicyError: tensors are missing or unknown, or their shapes do not match.
    """

    def __init__(
        self, tensors: Tensors, own: int, columns: int, actions: int, neighbours: int, agents: int, name: str
    ) -> None:
        count = len(tensors) // 2
        wanted = {f"layer{i}.{part}" for i in range(max(count, 1)) for part in ("weight", "bias")}
        _check_names(tensors, wanted, name)
        self._own, self._columns, self._neighbours, self._agents = own, columns, neighbours, agents
        size = self._inputs = own + neighbours * (columns + 1)
        self._layers = []
        for i in range(count):
            weight, bias = _linear(tensors, f"layer{i}", size, (agents,), name)
            self._layers.append((weight, bias))
            size = weight.shape[2]
        _check_actions(size, actions, name)

    def values(self, own: Float32s, rows: Float32s, agent: int) -> Float32s:
        """See `Network`. `agent` is ignored if all aircraft share one network."""
        x = np.zeros(self._inputs, np.float32)
        x[: self._own] = own
        heard = len(rows)
        table = x[self._own :].reshape(self._neighbours, self._columns + 1)
        table[:heard, :-1] = rows
        table[:heard, -1] = 1.0
        if self._agents == 1:
            agent = 0
        for number, (weight, bias) in enumerate(self._layers):
            if number:
                np.maximum(x, 0.0, out=x)
            x = x @ weight[agent]
            x += bias[agent]
        return x


def _linear(
    tensors: Tensors, layer: str, inputs: int, lead: tuple[int, ...], name: str
) -> tuple[Float32s, Float32s]:
    """Weight of a layer, transposed for x @ weight, and its bias."""
    weight, bias = tensors[f"{layer}.weight"], tensors[f"{layer}.bias"]
    outputs = weight.shape[-2] if weight.ndim == len(lead) + 2 else 0
    if outputs == 0 or weight.shape != (*lead, outputs, inputs):
        wanted = ", ".join(map(str, (*lead, "outputs", inputs)))
        raise PolicyError(f"{name}: tensor {layer}.weight: shape {weight.shape}, expected ({wanted})")
    if outputs > MAX_WIDTH:
        raise PolicyError(f"{name}: tensor {layer}.weight: {outputs} outputs; allowed: up to {MAX_WIDTH}")
    if bias.shape != (*lead, outputs):
        raise PolicyError(f"{name}: tensor {layer}.bias: shape {bias.shape}, expected {(*lead, outputs)}")
    return np.ascontiguousarray(np.swapaxes(weight, -1, -2)), np.ascontiguousarray(bias)


def _check_names(tensors: Tensors, wanted: set[str], name: str) -> None:
    if missing := sorted(wanted - tensors.keys()):
        raise PolicyError(f"{name}: tensor {missing[0]}: missing")
    if extra := sorted(tensors.keys() - wanted):
        raise PolicyError(f"{name}: tensor {extra[0]:.80}: unknown; expected {', '.join(sorted(wanted))}")


def _check_actions(outputs: int, actions: int, name: str) -> None:
    if outputs != actions:
        raise PolicyError(f"{name}: {outputs} outputs of the last layer for {actions} actions")
