"""The radio of a plug-in (`dmuca.radios`), behind a guard that trusts nothing of it."""
