"""Time and error: standing programs, the benchmark, visibility."""
