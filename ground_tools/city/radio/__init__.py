"""The radio of a city: the choice of transports, the reception of messages, and the age of information."""
