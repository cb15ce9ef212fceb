"""What is known of one sender: its radio address, what it says of itself, and how well it is received."""
