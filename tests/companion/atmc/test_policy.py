"""A policy: its numbers, what it refuses to answer, its file, and everything that can be wrong with that."""

from __future__ import annotations

import json
import struct

import msgspec
import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.atmc.actions import SET_ACTIONS, TRANSPORTS, able, legal, transports_of
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.policy import (
    MAX_BYTES,
    Bounds,
    Policy,
    PolicyError,
    check_flyable,
    encode,
    golden_of,
    load,
)
from companion.errors import ConfigError
from companion.remote_id.region import Region
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

ALL = np.ones(len(SET_ACTIONS), bool)


def made(kind="set", **changes):
    meta = metadata(kind, **changes)
    parts = tensors(meta)
    return Policy(meta, parts, "made"), parts


def by_the_book(meta, parts, own, rows, agent):
    """The forward pass in float64, row by row."""
    p = {key: value.astype(np.float64) for key, value in parts.items()}
    own_at = [list(OWN).index(c) for c in meta.own_columns]
    at = [list(NEIGHBOUR).index(c) for c in meta.neighbour_columns]
    if meta.kind == "set":
        total, most = 0.0, 0.0
        for row in rows[:, at]:
            h = np.maximum(p["phi0.weight"] @ row + p["phi0.bias"], 0.0)
            h = np.maximum(p["phi1.weight"] @ h + p["phi1.bias"], 0.0)
            total, most = total + h, np.maximum(most, h)
        size = len(p["phi1.bias"])
        z = np.concatenate([np.log(1.0 + total) + np.zeros(size), most + np.zeros(size), own[own_at]])
        for layer in ("rho0", "rho1"):
            z = np.maximum(p[f"{layer}.weight"] @ z + p[f"{layer}.bias"], 0.0)
        return p["out.weight"] @ z + p["out.bias"]
    nearest = sorted(rows.tolist(), key=lambda row: row[0])
    x = list(own[own_at])
    for k in range(meta.neighbours):
        x += [nearest[k][c] for c in at] + [1.0] if k < len(nearest) else [0.0] * (len(at) + 1)
    which = agent if meta.agents > 1 else 0
    for i in range(3):
        x = p[f"layer{i}.weight"][which] @ np.maximum(x, 0.0 if i else -np.inf) + p[f"layer{i}.bias"][which]
    return x


NEIGHBOUR, OWN = metadata().neighbour_columns, metadata().own_columns
SOME = {
    "neighbour_columns": ("wifi_rate", "log_distance"),
    "own_columns": ("wifi", "ble4"),
    "bounds": Bounds(neighbour_low=(0, 0), neighbour_high=(1, 1), own_low=(0, 0), own_high=(1, 1)),
}


@pytest.mark.parametrize("heard", [0, 1, 9, 50])
@pytest.mark.parametrize("changes", [{}, SOME, {"agents": 3}], ids=["all columns", "some columns", "agents"])
@pytest.mark.parametrize("kind", ["set", "flat"])
def test_values_are_those_of_the_equations(kind, changes, heard):
    if kind == "set" and "agents" in changes:
        pytest.skip("one network for all")
    if kind == "flat" and heard > 9:
        pytest.skip("no room for them")
    policy, parts = made(kind, **changes)
    rng = np.random.default_rng(heard)
    for agent in range(policy.metadata.agents):
        own, rows = observation(rng, heard)
        expected = by_the_book(policy.metadata, parts, own, rows, agent)
        np.testing.assert_allclose(policy.values(own, rows, agent), expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("kind", ["set", "flat"])
def test_the_order_of_neighbours_does_not_matter(kind):
    policy, _ = made(kind)
    rng = np.random.default_rng(1)
    own, rows = observation(rng, 9)
    expected = policy.values(own, rows)
    for _ in range(10):
        rng.shuffle(rows)
        np.testing.assert_allclose(policy.values(own, rows), expected, rtol=1e-5, atol=1e-5)


def test_a_flat_network_looks_at_the_nearest():
    policy, _ = made("flat")
    own, rows = observation(np.random.default_rng(1), 12)
    nearest = rows[np.argsort(rows[:, 0])[:9]]
    assert (policy.values(own, rows) == policy.values(own, nearest)).all()


def test_the_best_allowed_action_is_taken():
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    order = np.argsort(-policy.values(own, rows))
    best = policy.choose(own, rows, ALL, None)
    assert best == Choice(int(order[0]), SET_ACTIONS[order[0]])
    allowed = ALL.copy()
    allowed[order[:3]] = False
    assert policy.choose(own, rows, allowed, None).index == order[3]


def test_a_switch_has_its_price():
    policy, parts = made()
    own, rows = observation(np.random.default_rng(1), 4)
    q = np.sort(policy.values(own, rows))[::-1]
    second = int(np.argsort(-policy.values(own, rows))[1])
    gap = float(q[0] - q[1])
    for price, stays in ((0.5 * gap, False), (2.0 * gap, True)):
        priced = Policy(msgspec.structs.replace(policy.metadata, switch_price=price), parts, "x")
        assert (priced.choose(own, rows, ALL, second).index == second) is stays
        assert priced.choose(own, rows, ALL, None) == policy.choose(own, rows, ALL, None)


names = st.sets(st.sampled_from([*TRANSPORTS, "nan"]), min_size=1)
POLICY = made()[0]


@given(
    sets=st.lists(names, max_size=3),
    can_send=st.sets(st.sampled_from([*TRANSPORTS, "nan"])),
    seed=st.integers(0, 1000),
    current=st.none() | st.integers(0, len(SET_ACTIONS) - 1),
)
def test_what_is_not_legal_or_not_able_is_never_chosen(sets, can_send, seed, current):
    region = Region(transport_sets=tuple(tuple(sorted(names)) for names in sets))
    allowed = legal(SET_ACTIONS, region) & able(SET_ACTIONS, can_send)
    rng = np.random.default_rng(seed)
    answer = POLICY.choose(*observation(rng, int(rng.integers(0, 8))), allowed, current)
    if isinstance(answer, Refused):
        assert answer.why is Why.NOTHING_ALLOWED
        assert not allowed.any()
        return
    used = transports_of(answer.action)
    assert used <= can_send
    assert not sets or any(names <= used for names in sets)


@pytest.mark.parametrize(
    ("change", "why", "words"),
    [
        (lambda own, rows: rows.__setitem__((2, 0), -0.3), Why.OUTSIDE, "neighbour's log_distance -0.3"),
        (lambda own, rows: rows.__setitem__((0, 1), -0.2), Why.OUTSIDE, "neighbour's conflict -0.2"),
        (lambda own, rows: rows.__setitem__((1, 7), np.nan), Why.OUTSIDE, "wifi_rate nan"),
        (lambda own, rows: own.__setitem__(6, np.inf), Why.OUTSIDE, "own ble4_success inf"),
        (
            lambda own, rows: own.__setitem__(3, np.nan),
            Why.OUTSIDE,
            "own ble4_rate nan, trained with -1 to 1",
        ),
    ],
)
def test_what_training_did_not_see_is_refused(change, why, words):
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    change(own, rows)
    answer = policy.choose(own, rows, ALL, None)
    assert isinstance(answer, Refused)
    assert answer.why is why
    assert words in answer.text


def test_who_is_farther_than_any_in_training_is_left_out():
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    far = rows.copy()
    far[2, 0] = 1.3
    answer = policy.choose(own, far, ALL, None)
    assert isinstance(answer, Choice)
    assert answer == policy.choose(own, np.delete(rows, 2, axis=0), ALL, None)


def test_a_little_outside_is_not_outside():
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    rows[0, 0] = 1.24
    assert isinstance(policy.choose(own, rows, ALL, None), Choice)


def test_those_who_are_far_do_not_count():
    policy, _ = made()
    most = policy.metadata.neighbours
    own, rows = observation(np.random.default_rng(1), most + 5)
    rows[1:, 0] = 1.3
    assert policy.choose(own, rows, ALL, None) == policy.choose(own, rows[:1], ALL, None)


@pytest.mark.parametrize("kind", ["set", "flat"])
def test_more_neighbours_than_in_training_are_refused(kind):
    policy, _ = made(kind)
    most = policy.metadata.neighbours
    allowed = np.ones(len(policy.actions), bool)
    own, rows = observation(np.random.default_rng(1), most + 1)
    assert isinstance(policy.choose(own, rows[:-1], allowed, None), Choice)
    answer = policy.choose(own, rows, allowed, None)
    assert answer == Refused(Why.TOO_MANY, f"{most + 1} neighbours, trained with up to {most}")


def test_an_answer_that_is_no_number_is_refused():
    meta = metadata()
    parts = tensors(meta)
    for layer in ("rho0", "rho1"):
        parts[f"{layer}.weight"] *= np.float32(1e30)
    own, rows = observation(np.random.default_rng(1), 4)
    answer = Policy(meta, parts, "x").choose(own, rows, ALL, None)
    assert isinstance(answer, Refused)
    assert answer.why is Why.NO_NUMBER


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
    check_flyable(policy)


def test_networks_of_one_aircraft_each_do_not_fly():
    with pytest.raises(PolicyError, match="holds 2 networks"):
        check_flyable(load(policy_file("flat", agents=2), "x"))


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
    "large": (lambda meta, parts: bytes(MAX_BYTES + 1), "a policy has at most 1000000"),
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
    "twice": (with_meta(actions=[[10, 0, 0]] * 47), "actions: one stands there twice"),
    "idle": (lambda m, p: put({**m, "actions": [[0, 0, 0], *m["actions"][1:]]}, p), "no transport"),
    "fewer actions": (lambda m, p: put({**m, "actions": m["actions"][1:]}, p), "sizes do not fit"),
    "column": (with_meta(own_columns=["mood"]), r"own_columns: \('mood',\): allowed: ble4"),
    "column twice": (with_meta(own_columns=["ble4", "ble4"]), "own_columns: one stands there twice"),
    "columns": (with_meta(own_columns=["ble4"]), "bounds: own_low, own_high"),
    "bounds": (
        lambda m, p: put({**m, "bounds": {**m["bounds"], "own_low": [2.0] * FO}}, p),
        "bounds: own_low, own_high",
    ),
    "agents": (with_meta(agents=2), "shared by all"),
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
    "NaN": (with_tensor("phi0.weight", poked(np.nan)), "phi0.weight: not finite"),
    "infinite": (with_tensor("out.bias", poked(-np.inf)), "out.bias: not finite"),
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
            with pytest.raises(PolicyError, match=r"golden\[0\]: gives other values"):
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
