"""The policy passes the kit."""

from dmuca.testing import PolicyConformance


class TestQuiet(PolicyConformance):
    name = "quiet"
