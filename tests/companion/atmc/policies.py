"""Policies with random weights, made in a moment."""

from __future__ import annotations

import msgspec
import numpy as np

from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.policy import Bounds, Metadata, Policy, encode, golden_of

FN, FO = len(NEIGHBOUR_COLUMNS), len(OWN_COLUMNS)


def linear(rng, name, inputs, outputs, lead=()):
    return {
        f"{name}.weight": rng.normal(0.0, 1.0 / np.sqrt(inputs), (*lead, outputs, inputs)).astype(np.float32),
        f"{name}.bias": rng.normal(0.0, 0.1, (*lead, outputs)).astype(np.float32),
    }


def observation(rng, heard):
    """A random observation within the bounds of `metadata`."""
    return rng.uniform(0.0, 1.0, FO), rng.uniform(0.0, 1.0, (heard, FN))


def metadata(kind="set", **changes):
    made = Metadata(
        kind=kind,
        objective="awareness" if kind == "set" else "paper",
        decisions="phases",
        name="made for tests",
        neighbours=60 if kind == "set" else 9,
        neighbour_columns=NEIGHBOUR_COLUMNS,
        own_columns=OWN_COLUMNS,
        actions=SET_ACTIONS if kind == "set" else PAPER_ACTIONS,
        bounds=Bounds(
            neighbour_low=(0.0,) * FN,
            neighbour_high=(1.2,) * FN,
            own_low=(-1.0,) * FO,
            own_high=(1.0,) * FO,
        ),
        golden=(),
    )
    return msgspec.structs.replace(made, **changes)


def tensors(meta, seed=0, widths=(64, 128)):
    rng = np.random.default_rng(seed)
    own, columns, actions = len(meta.own_columns), len(meta.neighbour_columns), len(meta.actions)
    small, large = widths
    if meta.kind == "set":
        return {
            **linear(rng, "phi0", columns, small),
            **linear(rng, "phi1", small, small),
            **linear(rng, "rho0", 2 * small + own, large),
            **linear(rng, "rho1", large, large),
            **linear(rng, "out", large, actions),
        }
    lead = (meta.agents,)
    return {
        **linear(rng, "layer0", own + meta.neighbours * (columns + 1), large, lead),
        **linear(rng, "layer1", large, large, lead),
        **linear(rng, "layer2", large, actions, lead),
    }


def with_golden(meta, parts, seed=1):
    rng = np.random.default_rng(seed)
    policy = Policy(meta, parts, "x")
    cases = [
        golden_of(policy, *observation(rng, heard), agent)
        for heard in (0, 1, 5)
        for agent in {0, meta.agents - 1}
    ]
    return msgspec.structs.replace(meta, golden=tuple(cases))


def policy_file(kind="set", seed=0, **changes):
    """The bytes of a valid file."""
    meta = metadata(kind, **changes)
    parts = tensors(meta, seed, (8, 16))
    return encode(with_golden(meta, parts), parts)
