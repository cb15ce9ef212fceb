"""Every kind of radio in the registry is whole."""

from __future__ import annotations

import pkgutil
from typing import get_args

import pytest

from companion.radio.registry import RadioConfig
from companion.radio.section import RadioSection


@pytest.mark.parametrize("kind", get_args(RadioConfig), ids=lambda kind: kind.__name__)
def test_the_driver_stands_in_the_folder_of_its_section(kind):
    assert issubclass(kind, RadioSection)
    assert kind.driver.startswith(f"{kind.__module__.removesuffix('.section')}.")
    assert callable(pkgutil.resolve_name(kind.driver))


def test_no_two_kinds_have_one_name():
    tags = [kind.__struct_config__.tag for kind in get_args(RadioConfig)]
    assert len(set(tags)) == len(tags)
