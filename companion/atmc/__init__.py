"""ATMC: which transports the own Remote ID goes out on, and how often, chosen by a frozen policy."""
