"""Programs beside the benches: larger inputs, single products of a run, figures of long flights."""
