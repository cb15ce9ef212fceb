"""The paper's published figures, computed anew and set beside what it says of them."""
