"""The list of kept results, with what each file's content depends on and how to make a sample of it again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from companion.shipped import shipped
from ground_tools.common import provenance
from ground_tools.common.provenance import Provenance

_CHANNEL: Final = "config/channel/standard.toml"
_TRAINED: Final = ("numpy", "torch")
_FLOWN: Final = ("numba", "numpy")
OF_OTHERS: Final = ("benchmarl", "tensordict", "torchrl")
"""Packages of the extra crosscheck."""

Remake = Callable[[Path], list[str]]
"""Makes a sample of a file again. Returns the differences from the file, as text."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One kept file."""

    name: str
    """Path of the file in the checkout."""
    command: str
    """The command that makes it."""
    roots: tuple[str, ...]
    """Modules that compute its content."""
    remake: Remake
    data: tuple[str, ...] = ()
    """Data files on which its content depends, by their paths in the checkout."""
    packages: tuple[str, ...] = _FLOWN

    @property
    def path(self) -> Path:
        """The file."""
        return shipped(self.name)

    def now(self) -> Provenance:
        """The record that the file would have if the present software made it."""
        return provenance.now(self.command, self.roots, self.data, self.packages)

    def differences(self) -> list[str]:
        """Make a sample of the file again. Returns the differences from the file, as text.

        Raises:
            CannotSampleError: a package or a file is missing.
        """
        missing = next((package for package in self.packages if find_spec(package) is None), None)
        if missing is not None:
            raise provenance.CannotSampleError(f"{missing} is not installed")
        return self.remake(self.path)


def _campaign(path: Path) -> list[str]:
    from ground_tools.results import samples

    return samples.campaign_table(path)


def _crewed(path: Path) -> list[str]:
    from ground_tools.campaign.encounters import table

    return table.sample(path)


def _sensed(path: Path) -> list[str]:
    from ground_tools.campaign.sensed import cells

    return cells.sample(path)


def _closed_loop(path: Path) -> list[str]:
    from ground_tools.results import samples

    return samples.closed_loop_cell(path)


def _city(path: Path) -> list[str]:
    from ground_tools.paper.city import runs

    return runs.sample(path)


def _city_policy(path: Path) -> list[str]:
    from ground_tools.paper.city import cutouts

    return cutouts.sample(path)


def _city_learner(path: Path) -> list[str]:
    from ground_tools.atmc.learners import city_policy

    return city_policy.sample(path)


def _training(path: Path) -> list[str]:
    from ground_tools.results import training_samples

    return training_samples.training(path)


def _policy(path: Path) -> list[str]:
    from ground_tools.results import training_samples

    return training_samples.policy(path)


def _crosscheck(path: Path) -> list[str]:
    from ground_tools.atmc.commands import crosscheck

    return crosscheck.sample(path)


def _sweep(path: Path) -> list[str]:
    from ground_tools.atmc.commands import sweep

    return sweep.sample(path)


def entries() -> list[Entry]:
    """All kept files, in the order of their names."""
    found = [*_tables(), *_compared(), *_encounters(), _unheard(), *_flown(), *_cities(), *_trained()]
    return sorted(found, key=lambda entry: entry.name)


def _tables() -> list[Entry]:
    from ground_tools.campaign.cells import ENCOUNTERS, FLIGHT, TWINS
    from ground_tools.campaign.tables import TABLES

    twins = {"twins", "twins-lost"}
    # The command's own default is another number of flights.
    seeds = dict.fromkeys(TABLES, 1000) | {"laws": 4000, "twenty": 300, "twins-lost": 200}
    return [
        Entry(
            f"results/campaign/{name}.json",
            f"ground-tools campaign table {name} --seeds 1-{seeds[name]} --file results/campaign/{name}.json",
            (TWINS if name in twins else FLIGHT, *ENCOUNTERS),
            _campaign,
        )
        for name in TABLES
    ]


def _compared() -> list[Entry]:
    from ground_tools.campaign.cells import ENCOUNTERS, FLIGHT, PEERS, SCENARIOS

    roots = (FLIGHT, PEERS, *ENCOUNTERS)
    commands = {
        "peers-search": ("peers search", roots),
        "peers-encounters": ("peers table encounters", roots),
        "peers-missions": ("peers table missions", (*roots, *SCENARIOS)),
        "peers-pareto": ("peers pareto", roots),
        "scenarios": ("scenarios", (*roots, *SCENARIOS)),
    }
    return [
        Entry(
            f"results/campaign/{name}.json",
            f"ground-tools campaign {command} --file results/campaign/{name}.json",
            needs,
            _campaign,
        )
        for name, (command, needs) in commands.items()
    ]


def _encounters() -> list[Entry]:
    powered = tuple(f"uncor_1200only_{kind}_v1p2.txt" for kind in ("rotorcraft", "fwse", "fwme"))
    every = (*powered, "glider_v1.txt", "paraglider_v1.txt")
    flown = {
        "encounters": (every, "--range 2000 --seeds 100001-110000"),
        "encounters-range": (powered, "--range 3000 5000 --seeds 110001-112000"),
    }
    return [
        Entry(
            f"results/campaign/{name}.json",
            f"ground-tools campaign encounters --model {' '.join(models)} --own hover 5 10 "
            f"--altitude geometric pressure {options} --file results/campaign/{name}.json",
            ("ground_tools.campaign.encounters.cells",),
            _crewed,
        )
        for name, (models, options) in flown.items()
    ]


def _unheard() -> Entry:
    return Entry(
        "results/campaign/sensed.json",
        "ground-tools campaign sensed --seeds 1-1000 --file results/campaign/sensed.json",
        ("ground_tools.campaign.sensed.flight",),
        _sensed,
    )


def _flown() -> list[Entry]:
    from ground_tools.paper.closed_loop.flights import ATMC, CONDITIONS, METHODS

    region = "config/regions/us.toml"
    policies = {name: method.kept for name, method in METHODS.items()}
    policies[ATMC] = "config/policies/atmc.safetensors"
    return [
        Entry(
            f"results/atmc/closed-loop/{condition}-{method}.jsonl",
            f"ground-tools paper closed-loop --out results/atmc --conditions {condition} --methods {method}",
            ("ground_tools.paper.closed_loop.flights",),
            _closed_loop,
            (_CHANNEL, region, *([policy] if policy is not None else [])),
        )
        for condition in CONDITIONS
        for method, policy in policies.items()
    ]


def _cities() -> list[Entry]:
    from ground_tools.city.cells import ROOTS
    from ground_tools.city.spread import DATA
    from ground_tools.paper.city import cutouts
    from ground_tools.paper.city.runs import COMMAND, PACKAGES, SEPARATION_COMMAND

    name = "results/city-policy/runs.jsonl"
    policies = Entry(name, cutouts.COMMAND, cutouts.ROOTS, _city_policy, cutouts.data(), PACKAGES)
    return [
        policies,
        *(
            Entry(f"results/{study}/runs.jsonl", command, ROOTS, _city, DATA, PACKAGES)
            for study, command in (("city-paper", COMMAND), ("city-separation", SEPARATION_COMMAND))
        ),
    ]


def _trained() -> list[Entry]:
    learners = "ground_tools.atmc.learners"
    roots = {
        "madqn": f"{learners}.madqn",
        "madqn-shared": f"{learners}.madqn",
        "maddpg": f"{learners}.maddpg",
        "iac": f"{learners}.iac",
        "set": f"{learners}.flying_policy",
    }
    found = [
        Entry(
            "results/atmc/convergence.json.gz",
            "ground-tools atmc train --algorithm NAME --seeds 1-5, then ground-tools atmc collect RUN...",
            tuple(sorted({*roots.values()} - {roots["set"]})),
            _training,
            packages=_TRAINED,
        ),
        Entry(
            "results/atmc/crosscheck.jsonl",
            "ground-tools atmc crosscheck --out results/atmc/crosscheck.jsonl",
            (f"{learners}.outside",),
            _crosscheck,
            packages=(*_TRAINED, *OF_OTHERS),
        ),
        Entry(
            "results/atmc/sweep.jsonl",
            "ground-tools atmc sweep --winners 1-5 --out results/atmc/sweep.jsonl",
            tuple(roots[name] for name in ("iac", "maddpg", "madqn")),
            _sweep,
            packages=_TRAINED,
        ),
    ]
    made = "ground-tools atmc train --algorithm {} --seed N, then ground-tools atmc freeze RUN --out {}"
    policies = {f"results/policies/paper-{name}.safetensors": (name, root) for name, root in roots.items()}
    policies["config/policies/atmc.safetensors"] = ("flying", roots["set"])
    for file, (name, root) in policies.items():
        algorithm = "set-paper" if name == "set" else name
        found.append(Entry(file, made.format(algorithm, file), (root,), _policy, packages=_TRAINED))
    begun = ("config/policies/atmc.safetensors",)
    for seed in range(1, 6):
        file = f"results/policies/city-{seed}.safetensors"
        command = f"ground-tools atmc train --algorithm city --seed {seed}; the run's policy.safetensors"
        root = f"{learners}.city_policy"
        found.append(Entry(file, command, (root,), _city_learner, begun, packages=_TRAINED))
    return found
