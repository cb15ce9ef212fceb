"""Every law in the registry is complete."""

from __future__ import annotations

import pkgutil
from typing import get_args

from companion.avoidance.law import Law
from companion.laws import LAWS, LawName


def test_each_name_has_a_law():
    assert get_args(LawName) == tuple(LAWS)
    for kind in LAWS.values():
        assert issubclass(pkgutil.resolve_name(kind.made_by), Law)
