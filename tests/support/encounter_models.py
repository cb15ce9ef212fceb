"""Encounter models for tests: a small one made by hand, and the published ones if they are available."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_tools.campaign.encounters.model import Model, read

ROOT = Path(__file__).parents[2]
TINY = ROOT / "tests" / "data" / "encounters" / "tiny.txt"
PUBLISHED = ROOT.parent / "shared" / "data" / "encounters"
ROTORCRAFT = "uncor_1200only_rotorcraft_v1p2"
NAMES = (
    ROTORCRAFT, "uncor_1200only_fwse_v1p2", "uncor_1200only_fwme_v1p2", "glider_v1", "paraglider_v1",
)  # fmt: skip


def published(name: str) -> Model:
    """A published model; skips the test if its file is missing."""
    path = PUBLISHED / f"{name}.txt"
    if not path.is_file():
        pytest.skip(f"the encounter model {name} is not there; it is published in em-model-manned-bayes "
                    "by MIT Lincoln Laboratory")  # fmt: skip
    return read(path)


def model_of(name: str) -> Model:
    """The small model ("tiny") or a published one."""
    return read(TINY) if name == "tiny" else published(name)
