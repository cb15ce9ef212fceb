"""ATMC on the desk: the environment, the paper's learners and ours, what they are measured by, and the
freezing."""
