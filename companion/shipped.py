"""Finds the files that come with the software: profiles, policies, channel tables, scenarios, kept results.

In a checkout they are the folders `config` and `results` at its top, where a user edits them. In an installed
copy the same two folders are data of the package `dmuca`.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Final

_TOP: Final = Path(__file__).parents[1]
CHECKOUT: Final = _TOP if (_TOP / "pyproject.toml").is_file() else None
"""Top folder of the checkout that this code runs from; None for an installed copy."""
FOLDERS: Final = ("config", "results")
"""Folders that come with the software."""


def shipped(name: str) -> Path:
    """The file or folder that comes with the software, whether it exists or not.

    Args:
        name: its path in a checkout, such as `config/regions/us.toml`.
    """
    return Path(str(resources.files("dmuca") / name)) if CHECKOUT is None else CHECKOUT / name


def given(text: str, kind: str | None = None) -> Path:
    """The file that a command-line argument names. Use this function as the `type` of such an option.

    If the current folder has no `config/...` or `results/...` of that name, the argument means the file that
    comes with the software, so that the commands of the documentation work in any folder.

    Args:
        kind: folder of TOML files in `config` that may be named without folder and ending, such as `head_on`
            of `scenarios`.
    """
    path = Path(text)
    if kind is not None and text in names(kind, ".toml"):
        return path if path.exists() else shipped(f"config/{kind}/{text}.toml")
    if path.is_absolute() or not path.parts or path.parts[0] not in FOLDERS or ".." in path.parts:
        return path
    ours = shipped(text)
    return ours if not path.exists() and ours.exists() else path


def named(text: str, kind: str, suffix: str, beside: Path) -> Path:
    """The file that a key of a configuration or scenario names.

    Args:
        text: a path relative to the file with the key, or the bare name of a shipped file, such as `us`.
        kind: folder of such files in `config`.
        suffix: ending of their names.
        beside: folder of the file with the key.
    """
    path = beside / text
    ours = shipped(f"config/{kind}/{text}{suffix}")
    return ours if text in names(kind, suffix) and not path.is_file() else path


def names(kind: str, suffix: str) -> list[str]:
    """Bare names of the shipped files of one kind, sorted: `names("regions", ".toml")`."""
    return sorted(path.name.removesuffix(suffix) for path in shipped(f"config/{kind}").glob(f"*{suffix}"))


def how_to_install(package: str, extra: str) -> str:
    """Text that says that a package is missing, and by which command the extra that holds it is installed."""
    if CHECKOUT is None:
        return f"{package} is not installed; to install it, run: pip install 'dmuca[{extra}]'"
    return f"{package} is not installed; to install it, run in the checkout: pip install -e '.[{extra}]'"
