"""The radio of a plug-in (`dmuca.radios`), behind a guard that checks everything it returns."""
