"""Measured figures, printed as tables, with their targets; `figures` says how they are measured."""
