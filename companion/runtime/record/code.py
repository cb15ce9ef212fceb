"""Names the code that runs: the version alone does not, because a checkout changes without it."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

import companion


@functools.cache
def code_sha256() -> str:
    """SHA-256 of the names and contents of all Python files of this package."""
    root = Path(companion.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
