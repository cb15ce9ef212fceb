"""Helpers of the benchmarks: processor time, memory, and the output of targets."""
