"""Flight software for a companion computer: hear Remote ID, keep apart, return to the timed path."""

__version__ = "0.1.0"
