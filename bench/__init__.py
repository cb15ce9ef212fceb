"""Measured figures, printed as tables; ratios are what to trust on a shared machine."""
