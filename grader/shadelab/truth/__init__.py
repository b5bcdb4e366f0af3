"""What is right: expected data and its making, input tables, 50-digit arithmetic, error measures."""
