"""How figures are measured: processor time, memory, and targets beside them."""
