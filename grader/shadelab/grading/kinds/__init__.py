"""The kinds of checks, in the order of the data flow: a module each, with

NAME                    as in ids and result.json: cpp/NAME/item
STAGE                   kinds of one stage are asked together; a stage begins when the one before it has its verdicts
TOGETHER                whether the first questions of all checks of a stage are run together
DRAWS                   whether it may draw with the submission: then the loops that the scenes need are compiled
REPLAY                  what replays a worst input: "eval" of the function, "render" of the scene, or "" for nothing
BOTH                    whether it is asked of the two languages together, at the end (named by the last, without
                        points); it asks nothing then, for the numbers are there
items(assignment)       what is checked: (name, points for both languages together, item)
judge(plan, ledger)     a generator: yields Evaluate or Draw, is sent the Output, and returns the Check. Of BOTH kinds
                        `ledger` is one for each language. What it may know of other checks stands in the ledger.

Nothing here runs anything: the scheduler does. A new kind is a module and a line of this list.
"""

from types import ModuleType

from shadelab.grading.kinds import build, custom, function, image, parity, stability
from shadelab.grading.plan import Plan
from shadelab.result import Check

KINDS = [build, function, image, stability, custom, parity]


def kind_of(check: Plan | Check) -> ModuleType:
    """The module of a check's kind."""
    return next(kind for kind in KINDS if kind.NAME == check.kind)
