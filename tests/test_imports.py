"""ground_tools -> sitl_mocks -> companion, never the other way; and what must not load aboard."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "companion": {"sitl_mocks", "ground_tools", "torch", "rerun", "matplotlib", "mavsdk"},
    "sitl_mocks": {"ground_tools", "torch", "rerun", "matplotlib"},
    "ground_tools": set(),
}
SOCKETS_AND_CLOCKS = {"socket", "time", "select", "serial", "threading", "subprocess", "random"}
SHELLS = {
    "companion/runtime",
    "companion/commands/cli.py",
    "companion/radio/ether/ether_radio.py",
    "companion/radio/hci/hci_radio.py",
    "companion/radio/hci/channel.py",
    "companion/radio/wifi/hostapd.py",
    "companion/radio/wifi/packet_socket.py",
}
"""A radio backend owns its socket (the Transport contract)."""


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


@pytest.mark.parametrize(
    ("room", "closed"),
    [
        (
            "companion/avoidance",
            ["companion.authority", "companion.core", "companion.runtime", "companion.radio"],
        ),
        ("companion/authority", ["companion.core", "companion.runtime", "companion.radio"]),
    ],
)
def test_rooms_of_the_heart(room, closed):
    """Who flies knows the law; the law knows nothing of who flies, and neither of them the machine."""
    files = list((ROOT / room).rglob("*.py"))
    assert files
    for path in files:
        names = modules(path)
        wrong = [name for name in names for bad in closed if name == bad or name.startswith(f"{bad}.")]
        assert not wrong, path


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


def test_the_heart_is_pure():
    wrong = {}
    for path in (ROOT / "companion").rglob("*.py"):
        name = str(path.relative_to(ROOT))
        if not any(name.startswith(shell) for shell in SHELLS):
            bad = imported(path) & SOCKETS_AND_CLOCKS
            if bad:
                wrong[name] = bad
    assert not wrong


def test_what_a_command_loads_aboard():
    flies = loaded("companion.runtime.flight, companion.commands.check, sitl_mocks.cli")
    assert not {"torch", "rerun", "matplotlib", "mavsdk", "pyarrow"} & flies
    assert not {"cryptography", "rich"} & loaded("companion.runtime.flight"), "8 MB and more"
    assert "numba" not in loaded("companion.commands.cli, companion.commands.status"), (
        "who only looks needs no compiler"
    )


def loaded(modules):
    code = f"import {modules}, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return {name.split(".")[0] for name in done.stdout.split()}
