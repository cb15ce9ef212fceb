"""The networks of the paper's learners, which take a flat observation, and their policy files.

There is either one network per aircraft or one for all.
`companion.atmc.networks.FlatNetwork` computes the same function aboard in NumPy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
import torch
from torch import Tensor, nn

from companion.arrays import Float32s
from companion.atmc import policy, policy_file
from companion.atmc.actions import PAPER_ACTIONS, Action
from companion.atmc.observation import OWN_COLUMNS
from ground_tools.atmc.env.flat_observation import FLAT_NEIGHBOUR_COLUMNS, FLAT_OWN_COLUMNS, whole_rows


class Stack(nn.Module):
    """Several networks of the same shape, computed in parallel, with ReLU between their layers.

    Each layer is one multiplication for all networks, which is several times faster than one after the other.

    Args:
        networks: Number of networks.
        sizes: Sizes of the input, the hidden layers and the output.
        generator: Source of the initial weights. They are Glorot uniform and the biases are 0, like the dense
            layers of the TensorFlow that the paper uses.
    """

    def __init__(self, networks: int, sizes: Sequence[int], generator: torch.Generator) -> None:
        super().__init__()
        device = generator.device
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for before, after in itertools.pairwise(sizes):
            bound = math.sqrt(6.0 / (before + after))
            drawn = torch.rand(networks, before, after, generator=generator, device=device)
            self.weights.append(nn.Parameter((2.0 * drawn - 1.0) * bound))
            self.biases.append(nn.Parameter(torch.zeros(networks, 1, after, device=device)))

    @property
    def networks(self) -> int:
        """Number of networks."""
        return int(self.weights[0].shape[0])

    def forward(self, x: Tensor) -> Tensor:
        """Apply each network to its batch: (networks, batch, input) to (networks, batch, output)."""
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, torch.relu(x) if index else x, weight)
        return x

    def after_first(self, x: Tensor) -> Tensor:
        """Apply all layers after the first: (networks, batch, first hidden) to (networks, batch, output)."""
        for weight, bias in zip(list(self.weights)[1:], list(self.biases)[1:], strict=True):
            x = torch.baddbmm(bias, torch.relu(x), weight)
        return x

    def of_all(self, x: Tensor) -> Tensor:
        """Apply network n to aircraft n, or a single network to all: (E, N, input) to (E, N, output)."""
        if self.networks == 1:
            return self(x.reshape(1, -1, x.shape[-1])).reshape(*x.shape[:-1], -1)  # type: ignore[no-any-return]
        return self(x.transpose(0, 1)).transpose(0, 1)  # type: ignore[no-any-return]


def soft_update(target: Stack, network: Stack, share: float) -> None:
    """Update the target network: theta' <- tau theta + (1 - tau) theta', where tau is `share`."""
    with torch.no_grad():
        torch._foreach_lerp_(list(target.parameters()), list(network.parameters()), share)


def clipped(gradients: Sequence[Tensor], norm: float) -> list[Tensor]:
    """Gradients of a stack's parameters, clipped separately for each network to a norm of at most `norm`."""
    squares = torch.stack([gradient.square().sum((1, 2)) for gradient in gradients]).sum(0)
    factor = (norm / squares.sqrt().clamp(min=1e-12)).clamp(max=1.0)[:, None, None]
    return [gradient * factor for gradient in gradients]


def frozen(
    stack: Stack, actions: Sequence[Action], name: str, results: Mapping[str, float], examples: Tensor
) -> bytes:
    """Encode a stack as a policy file. The policy chooses the action with the greatest output.

    Args:
        stack: The networks.
        actions: The actions to which the outputs belong.
        name: Name of the policy.
        results: Measured results, as information for people.
        examples: Observation rows of some aircraft, (cases, inputs), for the golden cases.
    """
    tensors = {}
    for index, (weight, bias) in enumerate(zip(stack.weights, stack.biases, strict=True)):
        tensors[f"layer{index}.weight"] = _array(weight.transpose(1, 2))
        tensors[f"layer{index}.bias"] = _array(bias[:, 0])
    neighbours = (examples.shape[-1] - len(FLAT_OWN_COLUMNS)) // (len(FLAT_NEIGHBOUR_COLUMNS) + 1)
    metadata = policy.Metadata(
        kind="flat",
        objective="paper",
        decisions="together",
        name=name,
        neighbours=neighbours,
        agents=stack.networks,
        neighbour_columns=FLAT_NEIGHBOUR_COLUMNS,
        own_columns=FLAT_OWN_COLUMNS,
        actions=tuple(actions),
        bounds=policy.Bounds(
            neighbour_low=(0.0,) * len(FLAT_NEIGHBOUR_COLUMNS),
            neighbour_high=(
                math.log10(math.hypot(1e4, 1e4)) / 4.0,
                *(1.0,) * (len(FLAT_NEIGHBOUR_COLUMNS) - 1),
            ),
            own_low=(0.0,) * len(FLAT_OWN_COLUMNS),
            own_high=(1.0,) * len(FLAT_OWN_COLUMNS),
        ),
        results=dict(results),
        golden=(policy.Golden(own=(0.0,) * len(OWN_COLUMNS), rows=(), q=(0.0,) * len(actions)),),
    )
    unchecked = policy.Policy(metadata, tensors, name)
    golden = tuple(
        policy.golden_of(unchecked, *whole_rows(row), agent=index % stack.networks)
        for index, row in enumerate(_array(examples))
    )
    metadata = msgspec.structs.replace(metadata, golden=golden)
    return policy.encode(metadata, tensors)


def freeze_layers(
    layers: Sequence[tuple[Float32s, Float32s]],
    examples: Float32s,
    *,
    name: str,
    actions: Sequence[Action] = PAPER_ACTIONS,
    results: Mapping[str, float] | None = None,
) -> bytes:
    """Encode a network of another library, which serves all aircraft, as a policy file.

    Args:
        layers: Weight (inputs, outputs) and bias (outputs,) of each layer; between layers is a ReLU. The
            input is a row of `flat`, the output a value for each action.
        examples: Observation rows for the golden cases, (cases, inputs).
        name: Name of the policy.
        actions: The actions to which the outputs belong.
        results: Measured results, as information for people.

    Raises:
        ValueError: The layers do not fit each other, the examples or the actions.
    """
    sizes = [examples.shape[-1], *(weight.shape[-1] for weight, _ in layers)]
    for (weight, bias), wanted in zip(layers, itertools.pairwise(sizes), strict=True):
        if weight.shape != wanted or bias.shape != wanted[1:]:
            raise ValueError(f"a layer has shapes {weight.shape} and {bias.shape}; expected {wanted}")
    if sizes[-1] != len(actions):
        raise ValueError(f"the last layer has {sizes[-1]} outputs for {len(actions)} actions")
    stack = Stack(1, sizes, torch.Generator())
    with torch.no_grad():
        for (weight, bias), to_weight, to_bias in zip(layers, stack.weights, stack.biases, strict=True):
            to_weight.copy_(torch.tensor(weight)[None])
            to_bias.copy_(torch.tensor(bias)[None, None])
    return frozen(stack, actions, name, results or {}, torch.tensor(examples))


def thawed(data: bytes, name: str) -> Stack:
    """Decode the stack of a policy file, on the CPU.

    Raises:
        PolicyError: The file is invalid; the message names the file and the fault.
    """
    _, tensors = policy_file.read(data, name)
    layers = [(tensors[f"layer{i}.weight"], tensors[f"layer{i}.bias"]) for i in range(len(tensors) // 2)]
    networks, _, first = layers[0][0].shape
    sizes = (first, *(bias.shape[1] for _, bias in layers))
    stack = Stack(networks, sizes, torch.Generator())
    with torch.no_grad():
        for index, (weight, bias) in enumerate(layers):
            stack.weights[index].copy_(torch.from_numpy(weight).transpose(1, 2))
            stack.biases[index].copy_(torch.from_numpy(bias)[:, None])
    return stack


def _array(tensor: Tensor) -> Float32s:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32)
