"""Every law in the registry is complete."""

from __future__ import annotations

import pkgutil

from companion.avoidance.law import Law
from companion.laws import LAWS, PLUGIN


def test_each_name_has_a_law():
    for kind in (*LAWS.values(), PLUGIN):
        assert issubclass(pkgutil.resolve_name(kind.made_by), Law)
