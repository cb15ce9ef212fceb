"""The last word on every byte that leaves for the vehicle. It believes nobody above it."""
