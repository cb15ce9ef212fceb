"""Which source files a result depends on, and a digest of the code of each.

A result depends on the modules that compute it and on all modules of this project that they import, directly
or through others. The digest of a module is that of its code without comments, docstrings and blank lines, so
that a reworded comment does not make a result look old.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
_PACKAGES: Final = ("companion", "ground_tools", "sitl_mocks")
_DIGITS: Final = 12
_BOUNDARIES: Final = frozenset({"companion.config.sections", "companion.atmc.senses"})
"""Modules of which results use definitions and constants only. Their imports are not followed."""

_STRING_OR_COMMENT: Final = re.compile(
    r"""(?P<string>\"{3}(?:\\.|[^\\])*?\"{3}|'{3}(?:\\.|[^\\])*?'{3}"""
    r"""|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|#[^\n]*""",
    re.DOTALL,
)
"""The Python tokens that may contain a number sign. `tokenize` would take a second for this project."""


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
    return {name: _read(_path(name, root)).digest for name in sorted(names)}


def digest(roots: Iterable[str]) -> str:
    """One digest of all modules on which a result depends."""
    return hashlib.sha256(repr(digests(roots)).encode()).hexdigest()[:_DIGITS]


def _path(name: str, root: Path) -> Path:
    base = root.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    raise ValueError(f"there is no module {name} in {root}")


@dataclass(frozen=True, slots=True)
class _Module:
    """Digest and imports of one module."""

    digest: str
    """Digest of its code."""
    modules: tuple[str, ...]
    """Modules imported as `import module`, also inside functions, but not for type checkers."""
    names: tuple[tuple[str, str], ...]
    """Module and name of each `from module import name`, with the same exceptions."""
    passed_on: tuple[tuple[str, str, str], ...]
    """Alias, module and name of each `from module import name as alias` at the top of the module."""


@cache
def _read(path: Path) -> _Module:
    source = path.read_text()
    tree = ast.parse(source)
    running = list(_running(tree.body))
    code = _code(source, tree)
    return _Module(
        digest=hashlib.sha256(code.encode()).hexdigest()[:_DIGITS],
        modules=tuple(a.name for node in running if isinstance(node, ast.Import) for a in node.names),
        names=tuple((module, alias.name) for module, alias in _from(running)),
        passed_on=tuple((a.asname or a.name, module, a.name) for module, a in _from(tree.body)),
    )


def _from(statements: Iterable[ast.stmt]) -> Iterator[tuple[str, ast.alias]]:
    for node in statements:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                yield node.module, alias


@cache
def _imports(path: Path, root: Path) -> tuple[str, ...]:
    """Modules of this project that a module imports, also inside functions, but not for type checkers."""
    read = _read(path)
    found = {name for name in read.modules if _ours(name, root)}
    found |= {_home(module, name, root) for module, name in read.names if _ours(module, root)}
    return tuple(sorted(found))


@cache
def _ours(name: str, root: Path) -> bool:
    base = root.joinpath(*name.split("."))
    known = base.with_suffix(".py").is_file() or (base / "__init__.py").is_file()
    return known and name.split(".")[0] in _PACKAGES


def _home(module: str, name: str, root: Path) -> str:
    """The module in which a name is defined. Packages re-export names of the modules inside them."""
    if _ours(f"{module}.{name}", root):
        return f"{module}.{name}"
    path = _path(module, root)
    if path.name == "__init__.py":
        for alias, source, original in _read(path).passed_on:
            if alias == name and _ours(source, root):
                return _home(source, original, root)
    return module


def _statements(body: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """All statements, also those inside of others."""
    for node in body:
        yield node
        yield from _statements(_inside(node))


def _running(body: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """All statements except those below `if TYPE_CHECKING:`."""
    for node in body:
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            yield from _running(node.orelse)
            continue
        yield node
        yield from _running(_inside(node))


def _inside(node: ast.stmt) -> list[ast.stmt]:
    """The statements directly inside a statement. Expressions hold none, so they are not searched."""
    found: list[ast.stmt] = []
    for part in ("body", "orelse", "finalbody"):
        found += getattr(node, part, [])
    for part in ("handlers", "cases"):
        found += [inner for branch in getattr(node, part, []) for inner in branch.body]
    return found


def code_of(source: str) -> str:
    """A module's code without comments, docstrings and blank lines."""
    return _code(source, ast.parse(source))


def _code(source: str, tree: ast.Module) -> str:
    # A comment ends with its line, so removing comments does not change line numbers.
    lines = _STRING_OR_COMMENT.sub(lambda found: found["string"] or "", source).splitlines()
    for node in _statements(tree.body):
        match node:
            # A string that is a separate statement documents the definition above it or around it. One that
            # shares its line with code, as in `class A: "words"`, stays.
            case ast.Expr(value=ast.Constant(value=str())):
                if not lines[node.lineno - 1][: node.col_offset].strip():
                    for row in range(node.lineno - 1, node.end_lineno or node.lineno):
                        lines[row] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip())
