"""ground_tools -> sitl_mocks -> companion, never the other way; and what must not load aboard."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from typing import get_args

import pytest

from companion.radio.registry import RadioConfig
from sitl_mocks import cli

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "companion": {"sitl_mocks", "ground_tools", "torch", "rerun", "matplotlib", "mavsdk"},
    "sitl_mocks": {"ground_tools", "torch", "rerun", "matplotlib"},
    "ground_tools": set(),
}
ROOMS = [
    "errors",
    "arrays",
    "plugins",
    "address_forms",
    "toml_reader",
    "shipped",
    "geometry",
    "remote_id",
    "events",
    "geofence",
    "radio_sections",
    "laws",
    "config",
    "avoidance",
    "adjustable_parameters",
    "autopilot",
    "ownship",
    "radio",
    "broadcast",
    "traffic",
    "atmc",
    "authority",
    "gate",
    "decider",
    "core",
    "event_record",
    "flight_logs",
    "system",
    "replay",
    "runtime",
    "commands",
    "__main__",
]
"""Rooms of companion, in the order in which they may know each other: each imports only earlier ones."""
ORDERS = {
    "companion": ROOMS,
    "sitl_mocks": [
        "signals",
        "worker_pool",
        "vehicle",
        "remote_id_module",
        "channel",
        "air",
        "examinations",
        "encounters",
        "cli",
        "__main__",
    ],
    "ground_tools": [
        "common",
        "inspect",
        "channel",
        "atmc",
        "campaign",
        "city",
        "paper",
        "results",
        "orca_check",
        "fly",
        "cli",
        "__main__",
    ],
}
"""Rooms of each package, in the order in which they may know each other."""
DECLARED = {"radio_sections": r"companion\.radio\.((\w+\.)?section|registry)\b"}
"""Rooms whose files stand in the folder of a later room: what the configuration knows of each radio, which
its driver uses."""
MOST_LINES, MOST_MODULES = 450, 16
"""Largest file, and most modules in one folder, `__init__.py` not counted."""
SOCKETS_AND_CLOCKS = {"socket", "time", "select", "serial", "threading", "subprocess", "random"}
SHELLS = {
    "companion/runtime",
    "companion/commands",
    "companion/radio/hci/channel.py",
    "companion/radio/wifi/hostapd.py",
    "companion/radio/wifi/packet_socket.py",
    *(kind.driver.partition(":")[0].replace(".", "/") + ".py" for kind in get_args(RadioConfig)),
}
"""A radio backend owns its socket (the Radio contract): its driver, or a file that the driver uses."""


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("package", FORBIDDEN)
def test_direction_of_import(package):
    files = list((ROOT / package).rglob("*.py"))
    assert files
    wrong = {str(f.relative_to(ROOT)): bad for f in files if (bad := imported(f) & FORBIDDEN[package])}
    assert not wrong


def rooms_of(name: str, package: str = "companion") -> str | None:
    """The room of a package that a module belongs to."""
    for room, files in DECLARED.items():
        if package == "companion" and re.match(files, name):
            return room
    parts = name.split(".")
    return parts[1] if parts[0] == package and len(parts) > 1 else None


@pytest.mark.parametrize("package", ORDERS)
def test_rooms_import_in_one_direction(package):
    """A room imports only rooms that stand before it in `ORDERS`."""
    wrong, order = [], ORDERS[package]
    for path in sorted((ROOT / package).rglob("*.py")):
        own = rooms_of(module_name(path), package)
        if own is None:
            continue
        assert own in order, f"{path}: a new room needs its place in ORDERS"
        for name in modules(path):
            other = rooms_of(name, package)
            if other in order and order.index(other) > order.index(own):
                wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert not wrong


@pytest.mark.parametrize("package", ORDERS)
def test_every_room_exists(package):
    held = {p.stem if p.is_file() else p.name for p in (ROOT / package).iterdir()}
    assert set(ORDERS[package]) - DECLARED.keys() <= held


def test_no_circle_inside_a_room():
    """Files and folders of one folder, each folder taken as a whole, import each other in one direction."""
    names = {module_name(path) for package in ORDERS for path in (ROOT / package).rglob("*.py")}
    graphs: dict[str, dict[str, set[str]]] = {}
    for package in ORDERS:
        for path in sorted((ROOT / package).rglob("*.py")):
            own = module_name(path).split(".")
            for name in names & modules(path):
                other = name.split(".")
                level = next((n for n, (a, b) in enumerate(zip(own, other, strict=False)) if a != b), 0)
                if level > 1:  # the first level has the order of rooms
                    graph = graphs.setdefault(".".join(own[:level]), {})
                    graph.setdefault(own[level], set()).add(other[level])
    circles = {folder: found for folder, graph in graphs.items() if (found := in_circles(graph))}
    assert not circles


def in_circles(graph: dict[str, set[str]]) -> set[str]:
    """The nodes of a graph that reach themselves."""
    reached = {node: set(following) for node, following in graph.items()}
    for between in graph:
        for node in graph:
            if between in reached[node]:
                reached[node] |= reached[between]
    return {node for node in graph if node in reached[node]}


def test_circles_are_found():
    assert in_circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == {"a", "b", "c"}
    assert not in_circles({"a": {"b", "c"}, "b": {"c"}})


def test_no_circle_of_files():
    paths = [p for package in FORBIDDEN for p in sorted((ROOT / package).rglob("*.py"))]
    names = {module_name(path): path for path in paths}
    graph = {name: {m for m in modules(path) if m in names and m != name} for name, path in names.items()}
    # A package and the modules that it exports know each other.
    graph = {name: {m for m in found if not name.startswith(f"{m}.")} for name, found in graph.items()}
    while True:
        named = set().union(*graph.values()) & graph.keys()
        done = [name for name, found in graph.items() if name not in named or not found & graph.keys()]
        if not done:
            break
        for name in done:
            del graph[name]
    assert not graph, "each of these imports another one of them"


def test_no_file_and_no_folder_is_too_large():
    """A file has one subject, and a folder can be read as a list."""
    for top in (*FORBIDDEN, "tests", "bench"):
        files = sorted((ROOT / top).rglob("*.py"))
        assert files
        long = {
            str(f.relative_to(ROOT)): n for f in files if (n := len(f.read_text().splitlines())) > MOST_LINES
        }
        assert not long, "split these files"
        modules_in = Counter(str(f.parent.relative_to(ROOT)) for f in files if f.name != "__init__.py")
        full = {folder: n for folder, n in modules_in.items() if n > MOST_MODULES}
        assert not full, "split these folders"


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules(path: Path) -> set[str]:
    """Full names of all that a file imports; of `from a import b` both a and a.b."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, path
            assert node.module
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def test_the_core_is_pure():
    wrong = {}
    for path in (ROOT / "companion").rglob("*.py"):
        name = str(path.relative_to(ROOT))
        if not any(name.startswith(shell) for shell in SHELLS):
            bad = imported(path) & SOCKETS_AND_CLOCKS
            if bad:
                wrong[name] = bad
    assert not wrong


def test_what_a_command_loads_aboard():
    simulates = ", ".join(module for _, module, _ in cli.COMMANDS)
    flies = loaded(f"companion.runtime.flight, companion.commands.check, {simulates}")
    assert not {"torch", "rerun", "matplotlib", "mavsdk", "pyarrow"} & flies
    assert not {"cryptography", "rich"} & loaded("companion.runtime.flight"), "8 MB and more"
    assert "numba" not in loaded("companion.commands.cli, companion.commands.status"), (
        "who only looks needs no compiler"
    )


def loaded(modules):
    code = f"import {modules}, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return {name.split(".")[0] for name in done.stdout.split()}


def test_the_architecture_page_shows_these_rooms():
    from tests.support import rooms

    assert rooms.page_with_diagram(rooms.PAGE.read_text()) == rooms.PAGE.read_text()


def test_every_file_that_the_architecture_page_names_exists():
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = re.findall(r"`((?:companion/)?[a-z_]+/[a-z_/]+(?:\.py|/))`", text)
    assert len(named) > 30
    missing = [name for name in named if not any((ROOT / top / name).exists() for top in ("", "companion"))]
    assert not missing
