"""Which of the declared mistakes a submission makes. Every mistake was evaluated on the inputs that the student's function is
evaluated on; the one that gives the same numbers is named, and none when none clearly does. Only numbers are compared."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shadelab.course.assignment import Function
from shadelab.judge.functions import FunctionJudgement
from shadelab.result import Mistake
from shadelab.truth.expected import Expected, Table
from shadelab.truth.measures import FACTOR, SMALL

# A mistake explains a row when it gives the student's numbers within this relative error (or the function's limit, where that is
# wider): the same mistake written in other words rounds differently.
ALIKE = 1e-3
# It is named when the truth, and every other mistake, leave at least MARGIN times as many rows unexplained, one added to both
# counts: two rows that agree for no other reason are no coincidence, one may be. And when it explains all but a tenth of what
# is wrong; a pair, when that holds of what the two explain together.
MARGIN = 3.0
UNEXPLAINED = 0.1
# Each of a pair explains at least this share of what is wrong, and more than the other does already.
PART = 0.05


@dataclass
class Candidate:
    id: str
    function: str  # where the mistake is made: the judged function or one that it calls
    hint: str
    output: np.ndarray  # (N, results): what the judged function gives then


@dataclass
class Diagnosis:
    mistake: Mistake
    function: str
    other: Candidate | None = None  # a second mistake, where it takes two to explain what came


def candidates(expected: Expected, function: Function, backend: str) -> list[Candidate]:
    """The declared mistakes that reach this function. Its own come first, so that they win a tie."""
    known = []
    for m in expected.facts.mistakes:
        for language in dict.fromkeys((backend, "cpp")):
            if (key := f"{m['id']}/{language}/{function.name}") in expected.mistakes:
                known.append(Candidate(m["id"], m["function"], m["hint"], expected.mistakes[key]))
                break
    return sorted(known, key=lambda c: c.function != function.name)


def diagnose(
    judgement: FunctionJudgement, actual: np.ndarray, limit: float, known: list[Candidate], members: list[slice]
) -> Diagnosis | None:
    """The mistake (or two) that explain what a failed function gave; None when it is none that is declared."""
    if not known:
        return None
    table, wrong = judgement.table, judgement.wrong
    explained = {c.id: explains(c.output, actual, table, limit, members) for c in known}
    left = {id: int((~rows).sum()) for id, rows in explained.items()}
    first, *others = sorted(known, key=lambda c: left[c.id])
    alike = [c for c in others if explains(c.output, first.output, table, limit, members).all()]
    others = [c for c in others if c not in alike]
    of_truth = int(wrong.sum())
    margin = (min([of_truth, *(left[c.id] for c in others)]) + 1) / (left[first.id] + 1)
    if left[first.id] <= UNEXPLAINED * of_truth and margin >= MARGIN:
        hint = " Or: ".join(dict.fromkeys(c.hint for c in [first, *alike]))
        named = Mistake(id=first.id, hint=hint, margin=round(margin, 2), alike=[c.id for c in alike])
        return Diagnosis(named, first.function)
    return _pair(known, explained, wrong, left[first.id], judgement.check.id.split("/")[-1])


def _pair(
    known: list[Candidate], explained: Mapping[str, np.ndarray], wrong: np.ndarray, best: int, judged: str
) -> Diagnosis | None:
    """Two mistakes of which each shows on inputs of its own: a missing gate, say, and another exponent."""
    part = {c.id: int((explained[c.id] & wrong).sum()) for c in known}
    enough = max(2, PART * wrong.sum())
    likely = sorted((c for c in known if part[c.id] >= enough), key=lambda c: -part[c.id])
    pairs = []
    for k, one in enumerate(likely):
        for two in likely[k + 1 :]:
            more = (explained[two.id] & ~explained[one.id] & wrong).sum()
            if more >= enough and (explained[one.id] & ~explained[two.id] & wrong).sum() >= enough:
                pairs.append((int((~explained[one.id] & ~explained[two.id]).sum()), one, two))
    if not pairs:
        return None
    pairs.sort(key=lambda p: p[0])
    left, one, two = pairs[0]
    margin = (min([best, *(p[0] for p in pairs[1:] if {p[1].id, p[2].id} != {one.id, two.id})]) + 1) / (left + 1)
    if left > UNEXPLAINED * wrong.sum() or margin < MARGIN:
        return None
    # The first by data flow: a mistake of a called function comes before one of its caller's.
    one, two = sorted((one, two), key=lambda c: c.function == judged)
    return Diagnosis(Mistake(id=one.id, hint=one.hint, margin=round(margin, 2)), one.function, two)


def explains(output: np.ndarray, actual: np.ndarray, table: Table, limit: float, members: list[slice]) -> np.ndarray:
    """(N,) bool: the rows where `output` is what came."""
    limit = max(ALIKE, limit)
    alike = np.ones(len(actual), bool)
    with np.errstate(all="ignore"):
        for member in members:
            a, c = actual[:, member].astype(np.float64), output[:, member].astype(np.float64)
            size = np.abs(c[np.isfinite(c)])
            scale = np.percentile(size, 95) if len(size) else 1.0
            allowed = limit * (np.abs(c) + SMALL * scale) + FACTOR * table.conditioning[:, member]
            same = (np.abs(a - c) <= allowed) | (a == c) | (np.isnan(a) & np.isnan(c))
            alike &= same.all(axis=1)
    return alike
