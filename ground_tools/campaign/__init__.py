"""Encounters flown by the thousand: what the avoidance law is worth, with intervals."""
