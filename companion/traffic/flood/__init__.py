"""Bounds the cost of a flood of received frames."""
