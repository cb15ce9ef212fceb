"""Tables and pictures of the radio channel model."""
