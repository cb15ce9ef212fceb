"""Reading a policy file: what is accepted, and what each fault is called."""

from __future__ import annotations

import json
import struct

import msgspec
import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.atmc.actions import SET_ACTIONS
from companion.atmc.policy import (
    MAX_BYTES,
    Policy,
    PolicyError,
    check_flyable,
    encode,
    golden_of,
    load,
)
from companion.errors import ConfigError
from tests.companion.atmc.policies import (
    FN,
    FO,
    linear,
    metadata,
    observation,
    policy_file,
    tensors,
    with_golden,
)

# ---------------------------------------------------------------- the file


@pytest.mark.parametrize("kind", ["set", "flat"])
def test_a_file_gives_the_same_policy_again(kind):
    meta = metadata(kind, regions=("us", "eu"), results={"delay_s": 0.1}, switch_price=0.25)
    parts = tensors(meta)
    meta = with_golden(meta, parts)
    data = encode(meta, parts)
    assert data == encode(meta, parts)
    policy = load(data, "x")
    assert msgspec.structs.replace(policy.metadata, checksum="") == meta
    own, rows = observation(np.random.default_rng(7), 5)
    assert (policy.values(own, rows) == Policy(meta, parts, "x").values(own, rows)).all()
    check_flyable(policy, None)


def test_of_networks_for_one_aircraft_each_the_one_that_flies_is_configured():
    policy = load(policy_file("flat", agents=2), "x")
    with pytest.raises(PolicyError, match=r"holds 2 networks, .*; atmc.agent must say which one flies"):
        check_flyable(policy, None)
    with pytest.raises(PolicyError, match=r"atmc.agent: 2 is out of range; allowed: 0 to 1"):
        check_flyable(policy, 2)
    check_flyable(policy, 1)


def parts_of(data):
    length = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + length])
    return json.loads(header["__metadata__"]["dmuca"]), safetensors.numpy.load(data)


def put(meta, parts):
    return safetensors.numpy.save(parts, {"dmuca": meta if isinstance(meta, str) else json.dumps(meta)})


def with_meta(**changes):
    def damage(meta, parts):
        return put({**meta, **changes}, parts)

    return damage


def with_tensor(name, change):
    def damage(meta, parts):
        changed = change(parts[name])
        rest = {key: value for key, value in parts.items() if key != name}
        return put(meta, rest if changed is None else {**rest, name: np.ascontiguousarray(changed)})

    return damage


def without(key):
    return lambda meta, parts: put({k: v for k, v in meta.items() if k != key}, parts)


def odd_tensor(shape, floats):
    """One tensor of a shape that safetensors lets pass."""

    def damage(meta, parts):
        entry = {"dtype": "F32", "shape": shape, "data_offsets": [0, 4 * floats]}
        head = json.dumps({"__metadata__": {"dmuca": json.dumps(meta)}, "a": entry}).encode()
        return struct.pack("<Q", len(head)) + head + bytes(4 * floats)

    return damage


def poked(value):
    def change(tensor):
        tensor = tensor.copy()
        tensor.flat[3] = value
        return tensor

    return change


DAMAGES = {
    "empty": (lambda meta, parts: b"", "not a safetensors file"),
    "text": (lambda meta, parts: b"hello, I am not a policy at all", "not a safetensors file"),
    "torn": (lambda meta, parts: put(meta, parts)[:-9], "not a safetensors file"),
    "large": (lambda meta, parts: bytes(MAX_BYTES + 1), "a policy has at most 4000000"),
    "no metadata": (lambda meta, parts: safetensors.numpy.save(parts), "missing or damaged"),
    "other metadata": (lambda meta, parts: safetensors.numpy.save(parts, {"a": "b"}), "missing or damaged"),
    "no JSON": (lambda meta, parts: put("{", parts), "missing or damaged"),
    "no object": (lambda meta, parts: put("[1]", parts), "missing or damaged"),
    "deep": (lambda meta, parts: put("[" * 50_000 + "]" * 50_000, parts), "missing or damaged"),
    "65 dimensions": (odd_tensor([1] * 65, 1), "tensor a: shape: "),
    "nothing of a huge size": (odd_tensor([0, 2**62], 0), "tensor a: shape: "),
    "a dimension of 2^63": (odd_tensor([2**63, 0], 0), "tensor a: shape: "),
    "schema": (with_meta(schema="dmuca-atmc-0"), "schema 'dmuca-atmc-0'; this version builds"),
    "no schema": (without("schema"), "missing or damaged"),
    "kind": (with_meta(kind="cube"), "Invalid enum value 'cube'"),
    "unknown field": (with_meta(colour="red"), "unknown field `colour`"),
    "no actions": (with_meta(actions=[]), "length >= 1"),
    "rate": (with_meta(actions=[[11, 0, 0]] * 47), "<= 10"),
    "twice": (with_meta(actions=[[10, 0, 0]] * 47), "actions: an action is listed twice"),
    "idle": (lambda m, p: put({**m, "actions": [[0, 0, 0], *m["actions"][1:]]}, p), "no transport"),
    "fewer actions": (lambda m, p: put({**m, "actions": m["actions"][1:]}, p), "sizes do not match"),
    "column": (with_meta(own_columns=["mood"]), r"own_columns: \('mood',\): allowed: ble4"),
    "column twice": (with_meta(own_columns=["ble4", "ble4"]), "own_columns: a name is listed twice"),
    "columns": (with_meta(own_columns=["ble4"]), "bounds: own_low, own_high"),
    "bounds": (
        lambda m, p: put({**m, "bounds": {**m["bounds"], "own_low": [2.0] * FO}}, p),
        "bounds: own_low, own_high",
    ),
    "agents": (with_meta(agents=2), "all aircraft share"),
    "no golden": (with_meta(golden=[]), "length >= 1"),
    "golden": (
        lambda m, p: put({**m, "golden": [{**m["golden"][0], "own": [0.0]}]}, p),
        r"golden\[0\]: its sizes",
    ),
    "golden agent": (
        lambda m, p: put({**m, "golden": [{**m["golden"][0], "agent": 1}]}, p),
        r"golden\[0\]: its sizes",
    ),
    "results": (with_meta(results={"a": "b"}), "Expected `float`"),
    "price": (with_meta(switch_price=-1.0), ">= 0"),
    "tensor missing": (with_tensor("rho1.bias", lambda t: None), "checksum differs"),
    "tensor changed": (with_tensor("rho1.bias", poked(3.0)), "checksum differs"),
    "metadata changed": (with_meta(switch_price=0.125), "checksum differs"),
    "NaN": (with_tensor("phi0.weight", poked(np.nan)), "phi0.weight: holds values that are not finite"),
    "infinite": (with_tensor("out.bias", poked(-np.inf)), "out.bias: holds values that are not finite"),
    "float64": (with_tensor("rho0.weight", lambda t: t.astype(np.float64)), "rho0.weight: type F64"),
    "float16": (with_tensor("rho0.weight", lambda t: t.astype(np.float16)), "rho0.weight: type F16"),
    "integers": (with_tensor("rho0.weight", lambda t: t.astype(np.int32)), "rho0.weight: type I32"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_file_is_refused_by_name(name):
    damage, words = DAMAGES[name]
    with pytest.raises(PolicyError, match=words) as error:
        load(damage(*parts_of(policy_file())), "some.safetensors")
    assert str(error.value).startswith("some.safetensors: ")
    assert isinstance(error.value, ConfigError)


@pytest.mark.parametrize(
    "damage",
    [
        with_meta(schema="x" * 300_000),
        with_meta(own_columns=["x" * 300_000]),
        with_meta(kind="x" * 300_000),
        lambda m, p: put({**m, "x" * 300_000: 1}, p),
        lambda m, p: put(m, {"x" * 300_000: p["out.bias"].astype(np.float16)}),
    ],
)
def test_what_is_told_of_a_damaged_file_is_short(damage):
    with pytest.raises(PolicyError) as error:
        load(damage(*parts_of(policy_file())), "x")
    assert len(str(error.value)) < 600


MISSHAPEN = {
    "missing": ("set", lambda p: p.pop("rho1.bias"), "tensor rho1.bias: missing"),
    "unknown": ("set", lambda p: p.update(extra=p["out.bias"]), "tensor extra: unknown"),
    "weight": (
        "set",
        lambda p: p.update({"rho0.weight": p["rho1.weight"]}),
        r"rho0.weight: shape \(128, 128\)",
    ),
    "bias": ("set", lambda p: p.update({"rho0.bias": p["phi0.bias"]}), r"rho0.bias: shape \(64,\)"),
    "vector": ("set", lambda p: p.update({"out.weight": p["out.bias"]}), "out.weight: shape"),
    "wide": (
        "set",
        lambda p: p.update(linear(np.random.default_rng(0), "phi0", FN, 2049)),
        "phi0.weight: 2049 outputs; allowed: up to 2048",
    ),
    "nothing": ("set", lambda p: p.clear(), "missing"),
    "flat missing": ("flat", lambda p: p.pop("layer1.bias"), "layer2.bias: unknown|layer1.bias: missing"),
    "flat lead": ("flat", lambda p: p.update({"layer1.bias": p["layer1.bias"][0]}), "layer1.bias: shape"),
    "flat nothing": ("flat", lambda p: p.clear(), "layer0.bias: missing"),
    "other kind": ("flat", lambda p: p.update(tensors(metadata())), "tensor layer3.bias: missing"),
    "actions": (
        "flat",
        lambda p: [p.pop("layer2.weight"), p.pop("layer2.bias")],
        "128 outputs .* 30 actions",
    ),
}


@pytest.mark.parametrize("name", MISSHAPEN)
def test_tensors_that_do_not_go_together_are_refused(name):
    kind, change, words = MISSHAPEN[name]
    meta = metadata(kind)
    parts = tensors(meta)
    meta = with_golden(meta, parts)
    change(parts)
    with pytest.raises(PolicyError, match=words):
        encode(meta, parts)


def test_other_values_than_the_golden_ones_are_refused():
    meta = metadata()
    parts = tensors(meta)
    case = golden_of(Policy(meta, parts, "x"), *observation(np.random.default_rng(3), 3))
    for by, refused in ((0.5e-5, False), (5e-5, True)):
        q = (case.q[0] + by * max(1.0, abs(case.q[0])), *case.q[1:])
        wrong = msgspec.structs.replace(meta, golden=(msgspec.structs.replace(case, q=q),))
        if refused:
            with pytest.raises(PolicyError, match=r"golden\[0\]: its outputs differ"):
                encode(wrong, parts)
        else:
            encode(wrong, parts)


def test_weights_of_another_type_are_not_written():
    meta = metadata()
    parts = tensors(meta)
    meta = with_golden(meta, parts)
    with pytest.raises(PolicyError, match=r"out\.bias: float64, expected float32"):
        encode(meta, {**parts, "out.bias": parts["out.bias"].astype(float)})


VALID = policy_file()


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_a_damaged_file_never_raises_anything_else(data):
    damaged = bytearray(VALID)
    for _ in range(data.draw(st.integers(1, 4))):
        # Half of the flips in the header, where the sense is.
        end = data.draw(st.sampled_from([16, 2000, len(VALID)]))
        damaged[data.draw(st.integers(0, end - 1))] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.just(len(VALID)) | st.integers(0, len(VALID)))
    try:
        policy = load(bytes(damaged[:cut]), "x")
    except PolicyError:
        return
    own, rows = observation(np.random.default_rng(1), 3)
    assert np.isfinite(policy.values(own, rows)).all()
    assert policy.actions == SET_ACTIONS


def test_rows_are_those_of_the_schema():
    assert (FN, FO) == (8, 16)
