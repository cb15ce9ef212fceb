"""Bounds on what unproven traffic may do to the aircraft: how far (`containment`), how long (`allowance`)."""
