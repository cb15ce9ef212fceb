"""The law passes the kit."""

from dmuca.testing import LawConformance


class TestSidestep(LawConformance):
    name = "sidestep"
