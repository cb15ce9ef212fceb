"""`ground-tools orca check CASES.json`: compare the avoidance kernels with an oracle of solved ORCA cases.

The oracle file holds inputs (one agent and its neighbours) and the answers of a double-precision reference.
The comparison uses plain ORCA: half of the responsibility, no margins, no stretched volumes. Feasible,
well-conditioned cases must agree in velocity within 1e-5 m/s. Infeasible cases must reach the same largest
violation, because their velocity need not be unique. Cases marked `ill` must only agree in feasibility. Cases
marked `degenerate` (an exact head-on, for which the reference has no answer) must give a finite velocity that
separates the two.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import Floats
from companion.avoidance import kernels

TOLERANCE_MPS = 1e-5

Vector = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]


class Body(msgspec.Struct, frozen=True):
    """A neighbour."""

    position: Vector
    velocity: Vector
    radius: Annotated[float, Meta(ge=0)]


class Agent(Body, frozen=True):
    """The agent that decides."""

    preferred_velocity: Vector
    max_speed: Positive
    time_horizon: Positive
    time_step: Positive


class Case(msgspec.Struct, frozen=True):
    """One oracle case; SI units, any right-handed frame."""

    id: str
    category: str
    agent: Agent
    neighbours: tuple[Body, ...]
    new_velocity_float64: Vector | None
    feasible: bool | None
    max_violation: float | None
    conditioning: Literal["well", "ill", "float32_nan", "degenerate"]


class CaseFile(msgspec.Struct, frozen=True):
    """The oracle file; other keys are ignored."""

    cases: Annotated[tuple[Case, ...], Meta(min_length=1)]


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of the kernels to a case."""

    velocity: Vector
    feasible: bool
    max_violation: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommand `check`."""
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    check = commands.add_parser(
        "check",
        help="compare the kernels with an oracle's answers",
        description="Solve every case of an oracle file with the avoidance kernels and compare the answers.",
    )
    check.add_argument("cases", type=Path, help="file of oracle cases (.json or .json.gz)")
    check.add_argument("--json", action="store_true", help="print the result as one JSON object")


def run(args: argparse.Namespace) -> int:
    """Compare and print. Returns 0 if all cases agree, 1 if some (named) differ, 2 for an invalid file."""
    try:
        cases = load(args.cases)
    except (OSError, EOFError, ValueError, zlib.error, msgspec.DecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        print(f"{args.cases}: cannot be checked: {reason}".replace("\n", " "), file=sys.stderr)
        return 2
    differing = {case.id: why for case in cases if (why := compare(case, solve(case))) is not None}
    total = Counter(case.category for case in cases)
    wrong = Counter(case.category for case in cases if case.id in differing)
    if args.json:
        categories = {name: {"cases": total[name], "differing": wrong[name]} for name in sorted(total)}
        result = {"cases": len(cases), "differing": differing, "categories": categories}
        print(json.dumps(result, indent=2))
    else:
        for name in sorted(total):
            print(f"{name:28s} {total[name] - wrong[name]:5d} of {total[name]:5d} agree")
        for name, why in differing.items():
            print(f"{name}: {why}")
        print(f"{len(cases) - len(differing)} of {len(cases)} cases agree")
    return 1 if differing else 0


def load(path: Path) -> tuple[Case, ...]:
    """Read an oracle file.

    Raises:
        OSError, EOFError, zlib.error: The file cannot be read.
        ValueError, msgspec.DecodeError: The file does not have the format; the message names the place.
    """
    raw = path.read_bytes()
    if raw.startswith(b"\x1f\x8b"):
        raw = gzip.decompress(raw)
    cases = msgspec.json.decode(raw, type=CaseFile).cases
    seen: set[str] = set()
    for case in cases:
        if case.id in seen:
            raise ValueError(f"case {case.id} is in the file twice")
        seen.add(case.id)
        known = case.feasible is not None and case.max_violation is not None
        if case.conditioning != "degenerate" and not (known and case.new_velocity_float64 is not None):
            raise ValueError(
                f"case {case.id}: conditioning {case.conditioning!r} needs an answer, but the case has none"
            )
        for body in (case.agent, *case.neighbours):
            if not body.radius + case.agent.radius > 0.0:
                raise ValueError(f"case {case.id}: both radii are 0")
    return cases


def solve(case: Case) -> Answer:
    """Run the kernels on a case."""
    planes, count = _planes(case), len(case.neighbours)
    wish, speed = kernels.Vector(*case.agent.preferred_velocity), case.agent.max_speed
    feasible, v = kernels.solve(planes, 0, count, speed, 0.0, wish, np.zeros_like(planes))
    violation = float((planes[:count, 3] - planes[:count, :3] @ np.array(v)).max(initial=0.0))
    return Answer((v.n, v.e, v.d), feasible, violation)


def compare(case: Case, answer: Answer) -> str | None:
    """Describe how an answer differs from the oracle's; None if it agrees."""
    speed = math.hypot(*answer.velocity)
    if not math.isfinite(speed):
        return f"velocity {answer.velocity} is not finite"
    if speed > case.agent.max_speed + TOLERANCE_MPS:
        return f"speed {speed:.9g} m/s is above the limit, {case.agent.max_speed:.9g} m/s"
    if case.conditioning == "degenerate":
        return _not_avoiding(case, answer)
    if answer.feasible != case.feasible:
        words = {True: "feasible", False: "infeasible", None: "unknown"}
        return f"feasibility: {words[answer.feasible]} by the kernels, {words[case.feasible]} by the oracle"
    if case.conditioning == "ill":
        return None
    assert case.new_velocity_float64 is not None  # load() ensures this.
    assert case.max_violation is not None
    if case.feasible:
        gap = math.dist(answer.velocity, case.new_velocity_float64)
        if not gap <= TOLERANCE_MPS:
            return (
                f"velocity {answer.velocity} is {gap:.3g} m/s from the oracle's, {case.new_velocity_float64}"
            )
        return None
    gap = answer.max_violation - case.max_violation
    if not abs(gap) <= TOLERANCE_MPS:
        found = f"{answer.max_violation:.9g} m/s by the kernels, {case.max_violation:.9g} m/s by the oracle"
        return f"largest violation: {found}"
    return None


def _planes(case: Case) -> Floats:
    """The half-spaces of all neighbours, (neighbours, 4)."""
    agent = case.agent
    planes = np.zeros((max(len(case.neighbours), 1), 4))
    own = kernels.Vector(*agent.velocity)
    for row, other in enumerate(case.neighbours):
        p = kernels.minus(kernels.Vector(*other.position), kernels.Vector(*agent.position))
        v = kernels.minus(own, kernels.Vector(*other.velocity))
        radius = agent.radius + other.radius
        n, s = kernels.half_space(p, v, radius, agent.time_horizon, agent.time_step)
        kernels.put_plane(planes, row, n, kernels.dot(n, own) + 0.5 * s)
    return planes


def _not_avoiding(case: Case, answer: Answer) -> str | None:
    """Check a case without a reference answer.

    If both sides avoid with half of the responsibility, the agent must keep the radius to every neighbour
    within the time horizon. Returns a description of the failure, or None.
    """
    agent = case.agent
    for number, other in enumerate(case.neighbours):
        p = [b - a for a, b in zip(agent.position, other.position, strict=True)]
        radius = agent.radius + other.radius
        if math.hypot(*p) <= radius:
            continue
        before = [a - b for a, b in zip(agent.velocity, other.velocity, strict=True)]
        least = radius
        if answer.feasible:
            theirs = solve(_seen_by(other, agent)).velocity
        else:  # No velocity keeps the separation: do not come nearer than by flying on.
            theirs = other.velocity
            least = min(radius, _nearest(p, before, agent.time_horizon))
        v = [a - b for a, b in zip(answer.velocity, theirs, strict=True)]
        nearest = _nearest(p, v, agent.time_horizon)
        if not nearest >= least * (1.0 - 1e-6) - 1e-6:
            return (
                f"the agent comes within {nearest:.6g} m of neighbour {number}; allowed: {radius:g} m or more"
            )
    return None


def _nearest(p: list[float], v: list[float], window_s: float) -> float:
    """Least distance (m) within the window, from relative position p and velocity v = v_self - v_other."""
    _, near2 = kernels.closest(kernels.Vector(*p), kernels.Vector(*v), window_s)
    return math.sqrt(near2)


def _seen_by(other: Body, agent: Agent) -> Case:
    """The case from a neighbour's view. It prefers to fly on and sees only the agent."""
    as_agent = Agent(
        position=other.position,
        velocity=other.velocity,
        radius=other.radius,
        preferred_velocity=other.velocity,
        max_speed=max(agent.max_speed, math.hypot(*other.velocity)),
        time_horizon=agent.time_horizon,
        time_step=agent.time_step,
    )
    as_body = Body(position=agent.position, velocity=agent.velocity, radius=agent.radius)
    return Case(
        id="mirror",
        category="mirror",
        agent=as_agent,
        neighbours=(as_body,),
        new_velocity_float64=None,
        feasible=None,
        max_violation=None,
        conditioning="degenerate",
    )
