"""The radio of a city: who chooses which transports, what comes through, and how old information is."""
