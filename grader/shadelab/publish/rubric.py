"""How an assignment is graded, in Markdown, for its handout: from the manifest and from the numbers that it is graded by."""

from textwrap import fill

from shadelab.course.assignment import Assignment
from shadelab.judge.credit import LITTLE, MISTAKE, NO_MARKS, credit
from shadelab.judge.images import EDGE_CAP
from shadelab.judge.stability import FLOORS
from shadelab.truth.measures import FACTOR, FULL_MARKS
from shadelab.truth.tables import ROWS
from shadelab.words import points

MARK = "<!-- rubric -->"

_STABILITY = [
    "**Stability.** A function that is right is also asked at the ends of its domain: exponents of a million, roughness of 1/10,000, "
    f"directions a millionth apart. There it may be {FLOORS} times as far off as the rounding of its inputs alone makes; the slide's "
    "formula to the letter often is not good enough. `./shadelab stability DIR` shows it, and replays the first input that fails.",
    "",
]


def rubric(assignment: Assignment) -> str:
    """Replaces MARK in a handout."""
    graded = [f for f in assignment.functions if f.graded]
    functions, images = sum(f.points for f in graded), assignment.points - sum(f.points for f in graded)
    custom = sum(c.points for c in assignment.custom)
    stable = [s for s in assignment.stability.values() if s.points]
    stability = sum(s.points for s in stable)
    images -= custom + stability
    hidden = hidden_points(assignment)
    lines = [
        f"**Functions.** Each is evaluated over {ROWS:,} inputs drawn from its domain, many of them close to where it changes quickly and "
        "some exactly on the edge cases, and over inputs that the framework gave it while it drew the scenes. The reference computes "
        f"in double precision. How far correct programs are from it has been measured; yours may be {FACTOR} times as far, and as "
        f"much more as {FACTOR} times the rounding of the inputs alone makes.",
        "",
        "A function that calls another of yours is also right when it does the right thing with what that one gives: one mistake "
        "costs its points once, and those of the pictures that show it.",
        "",
        f"**Scenes.** Each is rendered with your functions. Inside of objects, {_percent(FULL_MARKS)} of the pixels may be off by "
        f"more than {FACTOR} times what correct programs and a shift of 1/16 pixel make. A pixel that is not a finite number costs at "
        f"least half, and so do edges of which more than {_percent(EDGE_CAP)} is off.",
        "",
        *(_STABILITY if stable else []),
        f"**Points** are for both languages, half each. What is wrong loses at least {_percent(MISTAKE)}; the rest falls with the "
        f"logarithm of the share of inputs or pixels that are wrong: {_percent(credit(LITTLE))} is left up to {_percent(LITTLE)}, "
        f"{_percent(credit(0.01))} at 1 %, nothing from {_percent(NO_MARKS)} on. What is off by little keeps as much by its size as by "
        "its share, whichever is more: an error of 1 % everywhere counts like one of any size at 1 % of the inputs. Run time is not graded.",
        "",
        "| check | points |",
        "|---|---:|",
        *(f"| `{f.name}`: {f.summary} | {points(f.points)} |" for f in graded),
        *(f"| scene `{s.name}` | {points(s.points)} |" for s in assignment.public_scenes),
        *(f"| `{c.name}`: a check of its own | {points(c.points)} |" for c in assignment.custom),
        *(f"| stability of `{s.name}` | {points(s.points)} |" for s in stable),
        *([f"| scenes that you do not see | {points(hidden)} |"] if hidden else []),
        f"| **all**: functions {points(functions)}, scenes {points(images)}"
        + (f", stability {points(stability)}" if stability else "")
        + (f", further checks {points(custom)}" if custom else "")
        + f" | **{points(assignment.points)}** |",
    ]
    if hidden:
        lines += ["", "The hidden scenes are like those above, with other lights and materials, the same for everyone."]
    most = points(assignment.points - hidden)
    lines += [
        "",
        f"**A release**, the folder that a course hands out, holds neither the solution nor hidden scenes. Its checks give up to {most} "
        f"of the {points(assignment.points)} points, and it judges each function by itself: one that is right given what a wrong one of "
        "yours gives loses its points there and keeps them in the course's autograder, and so do pictures that are wrong through it alone. "
        "Your score there may so be higher; and lower where your code asks a question of its own that its tables do not, and answers "
        "it wrongly.",
    ]
    return "\n".join(line if line.startswith("|") else fill(line, 120) for line in lines)


def hidden_points(assignment: Assignment) -> float:
    return sum(f.points * f.scenes for f in assignment.hidden.family)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
