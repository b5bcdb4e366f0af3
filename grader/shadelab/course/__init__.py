"""What is declared: assignments, mistakes, hidden scenes."""
