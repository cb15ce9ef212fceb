"""Measured figures, printed as tables, with their targets; `measuring.figures` says how."""
