"""What runs: the renderer, the sandbox, the compiler."""
