"""Programs beside the benchmarks: they make large logs, single products of a run, and figures of many
flights."""
