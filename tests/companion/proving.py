"""Theorems over the real numbers, for Z3."""

from __future__ import annotations

import z3

_EFFORT = 30_000_000
"""Z3's own count of steps: unlike a time limit it gives the same answer on every machine."""


def prove(claim: z3.BoolRef, *given: z3.BoolRef) -> None:
    """Fail unless `claim` follows from what is given, and unless what is given is possible at all."""
    assert _solved(*given) == z3.sat, "nothing fulfils what is given"
    solver = _solver(*given, z3.Not(claim))
    answer = solver.check()
    if answer == z3.sat:
        raise AssertionError(f"counterexample: {solver.model()}")
    assert answer == z3.unsat, f"not decided: {solver.reason_unknown()}"


def refute(claim: z3.BoolRef, *given: z3.BoolRef) -> None:
    """Fail unless there is a counterexample: the theorem next to it says no more than it may."""
    assert _solved(*given, z3.Not(claim)) == z3.sat


def _solver(*assertions: z3.BoolRef) -> z3.Solver:
    solver = z3.SolverFor("QF_NRA")
    solver.set("rlimit", _EFFORT)
    solver.add(*assertions)
    return solver


def _solved(*assertions: z3.BoolRef) -> z3.CheckSatResult:
    return _solver(*assertions).check()
