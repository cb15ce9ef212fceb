"""The dialect passes the kit."""

from dmuca.testing import FirmwareConformance


class TestHeron(FirmwareConformance):
    name = "heron"
