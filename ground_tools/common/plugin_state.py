"""A digest of a plug-in, so that kept results depend on the plug-in's state as on that of our own code."""

from __future__ import annotations

import hashlib
import inspect
from pathlib import Path

from companion.plugins import Plugin


def state_of(plugin: Plugin) -> str:
    """Digest of the name and version of a plug-in's distribution, and of the file that defines its object.

    Other files of the distribution are not read; its version represents them.
    """
    file = inspect.getsourcefile(plugin.loaded)
    code = b"" if file is None else Path(file).read_bytes()
    return hashlib.sha256(str(plugin).encode() + code).hexdigest()[:12]
