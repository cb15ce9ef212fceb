"""The flights over a city: demand drawn from a seed, and flights from files of other projects."""
