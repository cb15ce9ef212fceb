"""Benchmarks, which print measured figures as tables beside their targets. `measuring.figures` explains the
method."""
