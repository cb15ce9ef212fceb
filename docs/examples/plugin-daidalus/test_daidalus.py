"""The law passes the kit, where the library has been built."""

import pytest

from companion.errors import ConfigError
from dmuca.testing import LawConformance

try:
    from dmuca_daidalus import library

    library()
except ConfigError as error:
    pytest.skip(str(error), allow_module_level=True)


class TestDaidalus(LawConformance):
    name = "daidalus"
