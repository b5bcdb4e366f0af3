"""What can go wrong, by whose fault it is. The command line turns these into one line and an exit code."""


class UserError(Exception):
    """Bad usage or bad input: one line that says file, line, what is wrong and what to do. Exit code 2."""


class InfrastructureError(Exception):
    """The machine's fault or ours (no OpenGL, disk full, a broken build). Exit code 3."""
