"""Which source files a result depends on, and a digest of the code of each.

A result depends on the modules that compute it and on all modules of this project that they import, directly
or through others. The digest of a module is that of its code without comments, docstrings and blank lines, so
that a reworded comment does not make a result look old.
"""

from __future__ import annotations

import ast
import hashlib
import io
import tokenize
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
_PACKAGES: Final = ("companion", "ground_tools", "sitl_mocks")
_DIGITS: Final = 12
_BOUNDARIES: Final = frozenset({"companion.config.sections", "companion.atmc.senses"})
"""Modules of which results use definitions and constants only. What they import is not followed."""


def digests(roots: Iterable[str], root: Path = ROOT) -> dict[str, str]:
    """Digest of the code of every module on which a result depends, by the module's name, sorted.

    Args:
        roots: names of the modules that compute the result.
        root: folder that holds the packages.

    Raises:
        ValueError: there is no such module.
    """
    names: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in names:
            names.add(name)
            if name not in _BOUNDARIES:
                waiting += _imports(_path(name, root), root)
    return {name: _digest(_path(name, root)) for name in sorted(names)}


def digest(roots: Iterable[str]) -> str:
    """One digest of all modules on which a result depends."""
    return hashlib.sha256(repr(digests(roots)).encode()).hexdigest()[:_DIGITS]


def _path(name: str, root: Path) -> Path:
    base = root.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    raise ValueError(f"there is no module {name} in {root}")


@cache
def _imports(path: Path, root: Path) -> tuple[str, ...]:
    """Modules of this project that a module imports, also inside functions, but not for type checkers."""
    found: set[str] = set()
    for node in _running(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if _ours(alias.name, root)}
        elif isinstance(node, ast.ImportFrom) and node.module is not None and _ours(node.module, root):
            found |= {_home(node.module, alias.name, root) for alias in node.names}
    return tuple(sorted(found))


def _ours(name: str, root: Path) -> bool:
    base = root.joinpath(*name.split("."))
    known = base.with_suffix(".py").is_file() or (base / "__init__.py").is_file()
    return known and name.split(".")[0] in _PACKAGES


def _home(module: str, name: str, root: Path) -> str:
    """The module that a name is defined in: packages pass on names of the modules inside them."""
    if _ours(f"{module}.{name}", root):
        return f"{module}.{name}"
    path = _path(module, root)
    if path.name == "__init__.py":
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ImportFrom) and node.module is not None and _ours(node.module, root):
                for alias in node.names:
                    if (alias.asname or alias.name) == name:
                        return _home(node.module, alias.name, root)
    return module


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those below `if TYPE_CHECKING:`."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            for other in node.orelse:
                yield from _running(other)
            continue
        yield node
        yield from _running(node)


@cache
def _digest(path: Path) -> str:
    return hashlib.sha256(code_of(path.read_text()).encode()).hexdigest()[:_DIGITS]


def code_of(source: str) -> str:
    """A module's code without comments, docstrings and blank lines."""
    lines = source.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(source)):
        match node:
            # A string that is a statement of its own describes the definition above it or around it. One that
            # shares its line with code, as in `class A: "words"`, stays.
            case ast.Expr(value=ast.Constant(value=str())):
                if not lines[node.lineno - 1][: node.col_offset].strip():
                    for row in range(node.lineno - 1, node.end_lineno or node.lineno):
                        lines[row] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip())
