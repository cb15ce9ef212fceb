"""`ground-tools atmc freeze`: write the policy file that flies from a training run."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

import msgspec

from companion.atmc import policy, policy_file
from companion.errors import ConfigError
from ground_tools.atmc.commands.evaluate_command import evaluation

SAMPLES = {5: 200, 10: 100, 20: 30, 50: 5}
"""Sets of positions in each square, by fleet size, for the results that a frozen file contains."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools atmc freeze`."""
    parser.description = (
        "Take the best policy of a training run, measure it, and write the policy file for flight: weights,\n"
        "training settings, results, and golden cases that are checked whenever the file is loaded."
    )
    parser.epilog = (
        "example: ground-tools atmc freeze runs/atmc/20260101T000000Z-set-seed1 --out atmc.safetensors"
    )
    parser.add_argument("folder", type=Path, metavar="RUN", help="folder of a training run")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the policy file to write")
    parser.add_argument("--name", metavar="NAME", help="name of the policy (default: the file's name)")
    parser.add_argument(
        "--switch-price",
        type=float,
        metavar="S",
        help="gain in age (s) below which the policy does not switch (default: as trained)",
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools atmc freeze`. Returns 0.

    Raises:
        ConfigError: The run has no policy, an option is wrong, or the file cannot be written.
    """
    evaluate = evaluation()
    source = args.folder / "policy.safetensors"
    metadata, tensors = policy_file.read(evaluate.read_policy(source), str(source))
    name = args.name or args.out.name.removesuffix(".safetensors")
    price = metadata.switch_price if args.switch_price is None else args.switch_price
    if not 0.0 <= price <= 10.0:
        raise ConfigError(f"--switch-price: {price:g} is out of range; allowed: 0 to 10")
    config = evaluate.read_policy(args.folder / "config.toml")
    metadata = msgspec.structs.replace(
        metadata,
        name=name,
        switch_price=price,
        training_config_sha256=hashlib.sha256(config).hexdigest(),
    )
    data = policy.encode(metadata, tensors)
    results = _results(evaluate, data, str(args.out), metadata)
    data = policy.encode(msgspec.structs.replace(metadata, results=results), tensors)
    try:
        args.out.write_bytes(data)
    except OSError as error:
        raise ConfigError(f"{args.out}: cannot be written: {error.strerror}") from error
    print(f"wrote {args.out}: {len(data):,} bytes")
    for key, value in results.items():
        print(f"  {key}: {value:g}")
    return 0


def _results(evaluate: Any, data: bytes, name: str, metadata: Any) -> dict[str, float]:
    """Results for the file: delay or age (ms) of policy, best fixed mode, rule and search, by fleet size."""
    sizes = [metadata.neighbours + 1] if metadata.kind == "flat" else list(SAMPLES)
    results = {}
    for uavs in sizes:
        if uavs > metadata.neighbours + 1:
            continue
        question = evaluate.Question(metadata.objective, uavs=uavs, samples=SAMPLES.get(uavs, 100))
        found = evaluate.evaluate(data, name, question)
        for key in ("dynamic_ms", "best_fixed_dynamic_ms", "rule_dynamic_ms", "search_dynamic_ms"):
            results[f"uavs{uavs}_{key}"] = float(found[key])
    return results
