"""What a wrong function does, from its numbers alone. First the declared mistakes: each was evaluated on the inputs that the
student's function is evaluated on. Then a search: what happens to the result (relations.py), the reference with one thing changed
and the reference on changed arguments (the hypotheses of the expected data), for all of the result or member by member, and
several at once. Last, where it is wrong (places.py). What is told explains clearly better than the truth and than the rest."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from shadelab.course.assignment import Function
from shadelab.judge.functions import FunctionJudgement
from shadelab.judge.places import Condition, part_of, place_of, telling
from shadelab.judge.relations import (
    FACTOR_OF,
    MARGIN,
    UNEXPLAINED,
    Candidate,
    Compared,
    Explanation,
    of_curve,
    of_directions,
    of_factors,
    of_inner,
    of_members,
    of_pairs,
    of_quantities,
    of_result,
    of_results,
    of_sums,
)
from shadelab.result import Mistake
from shadelab.truth.expected import Expected
from shadelab.truth.measures import function_members

# Each of several explains at least this share of what is wrong, and more than the others do already.
PART = 0.05
SEVERAL = 3
UNDECLARED = "undeclared"  # id of a mistake that was found by searching
ALL = 100.0
NOT_ALL = 0.02  # a declared mistake that leaves more of what is wrong may be another one
VAGUE = 5  # how plain an explanation is not: see Explanation
SKETCH = 96  # rows on which what happens to the results of all hypotheses is tried first
MOSTLY = (
    0.8  # of the rows on which a hypothesis differs from the truth, the share that it must explain to be one of several
)
HALF = 0.5  # where more is wrong than that, a condition alone explains nothing
SAMPLE = 300  # rows of each kind on which relations are looked for
FEWEST = 8  # wrong rows among those of which everything is known


@dataclass
class Diagnosis:
    mistake: Mistake
    function: str
    said: str = ""  # for the message, beside the hint: what the search found
    others: list[str] = field(default_factory=list)  # further mistakes in the same function, as hints
    plain: int = 0  # how far from plain: see Explanation
    unexplained: float = 0.0  # the share of what is wrong that it leaves

    @property
    def vague(self) -> bool:
        """A curve, or a place alone: something plainer is told before it."""
        return self.plain >= VAGUE


def candidates(expected: Expected, function: Function, backend: str) -> list[Candidate]:
    """The declared mistakes that reach this function. Its own come first, so that they win a tie."""
    known = []
    for m in expected.facts.mistakes:
        for language in dict.fromkeys((backend, "cpp")):
            if (key := f"{m['id']}/{language}/{function.name}") in expected.mistakes:
                known.append(Candidate(m["id"], m["function"], m["hint"], expected.mistakes[key]))
                break
    return sorted(known, key=lambda c: c.function != function.name)


def hypotheses(expected: Expected, function: Function) -> list[Candidate]:
    """What was evaluated beside them: the reference with one thing changed."""
    return [
        Candidate("", h.function, "", h.values, h.rows, h.words, h.everywhere) for h in expected.hypotheses(function)
    ]


@dataclass
class Patient:
    """A function that failed, and all that may explain it."""

    function: Function
    judgement: FunctionJudgement
    actual: np.ndarray  # (N, results)
    declared: list[Candidate]
    changed: list[Candidate]  # hypotheses; none with follow-through, where the reference is another
    inner: dict[str, np.ndarray]  # quantities that the reference computes on its way, likewise
    right: frozenset[str] = (
        frozenset()
    )  # functions whose own check passed: they explain nothing, but what does over again what they do

    @property
    def limit(self) -> float:
        return self.judgement.check.error.limit

    @property
    def members(self) -> list[slice]:
        return function_members(self.function)

    @property
    def written(self) -> bool:
        """One that always gives the same is not written yet; its message says what it gives."""
        return len(np.unique(self.actual, axis=0)) > 1


def diagnose_declared(patient: Patient) -> Diagnosis | None:
    """The declared mistake that it makes."""
    found = _declared(patient, [c for c in patient.declared if c.function not in patient.right])
    if found is None:
        return None
    search = _Search(patient)
    if found.unexplained > NOT_ALL:  # much like it, and perhaps something else
        other = search.whole()
        if other is not None and MARGIN * max(other.unexplained, NOT_ALL / MARGIN) < found.unexplained:
            return other
    if found.function == patient.function.name:
        found.said = search.equal_to(found.mistake.id)
    return found


def diagnose_by_search(patient: Patient) -> Diagnosis | None:
    """What it does, where no declared mistake says it."""
    if not patient.written:
        return None
    search, own = _Search(patient), [c for c in patient.declared if c.function not in patient.right]
    whole = search.whole()
    if whole is not None and whole.vague and (parts := search.several()) and not parts.vague:
        return parts
    members = search.by_members() if whole is None or whole.plain else None
    if whole is not None and members is not None and members.plain < whole.plain:
        return members
    return (
        whole
        or members
        or _declared(patient, own, pairs=True)
        or search.several()
        # This one does by itself, and wrongly, what a function that is right is there for.
        or _declared(patient, patient.declared, pairs=True)
    )


def _declared(patient: Patient, known: list[Candidate], pairs: bool = False) -> Diagnosis | None:
    """The one declared mistake that explains what came; with `pairs`, two, each on inputs of its own."""
    if not known:
        return None
    wrong, everything = patient.judgement.wrong, np.arange(len(patient.actual))
    compared = Compared(
        patient.function, patient.judgement.table, patient.actual, patient.members, patient.limit, everything
    )
    explained = {c.id: compared.explained(c.output) for c in known}
    left = {id: int((~rows).sum()) for id, rows in explained.items()}
    first, *others = sorted(known, key=lambda c: left[c.id])
    alike = [c for c in others if _same(compared, c.output, first.output)]
    others = [c for c in others if c not in alike]
    of_truth = int(wrong.sum())
    margin = (min([of_truth, *(left[c.id] for c in others)]) + 1) / (left[first.id] + 1)
    if left[first.id] <= UNEXPLAINED * of_truth and margin >= MARGIN:
        hint = " Or: ".join(dict.fromkeys(c.hint for c in [first, *alike]))
        named = Mistake(id=first.id, hint=hint, margin=round(margin, 2), alike=[c.id for c in alike])
        return Diagnosis(named, first.function, unexplained=left[first.id] / max(of_truth, 1))
    return _pair(known, explained, wrong, left[first.id], patient.function.name) if pairs else None


def _same(compared: Compared, one: np.ndarray, other: np.ndarray) -> bool:
    return bool(compared.as_if(other).explained(one).all())


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
    return Diagnosis(Mistake(id=one.id, hint=one.hint, margin=round(margin, 2)), one.function, others=[two.hint])


# ---------------------------------------------------------------------------------------------------------- search


class _Search:
    def __init__(self, patient: Patient) -> None:
        self.function, self.judgement, self.actual = patient.function, patient.judgement, patient.actual
        self.limit, self.members, self.declared = patient.limit, patient.members, patient.declared
        self.wrong, self.inner, self.right = patient.judgement.wrong, patient.inner, patient.right
        # A function that is right is not blamed; what the judged one does over again in its place may be wrong all the same.
        self.changed = sorted(
            patient.changed, key=lambda c: (c.function != patient.function.name, c.function in patient.right)
        )
        self.everything = np.arange(len(patient.actual))
        self.some = next((c.rows for c in self.changed if not c.everywhere), self.everything)

    # --- what is told ---

    def whole(self) -> Diagnosis | None:
        found = self._best(self.members, self.wrong)
        return self._told("values are", [found]) if found else None

    def by_members(self) -> Diagnosis | None:
        """Each wrong member by itself; the others may be right."""
        parts = []
        for member in self.members if len(self.members) > 1 else ():
            wrong = self._compared([member], self.everything).wrong & self.wrong
            if wrong.any():
                found = self._best([member], wrong)
                several = [found] if found else self._several([member], wrong)
                if not several:
                    return None
                name = self.function.outputs[member.start].path.removeprefix("result.")
                parts += [(f"{name} is", part) for part in several]
        if not parts:
            return None
        told = [self._told(subject, [part]) for subject, part in parts]
        told[0].others, told[0].plain = [d.mistake.hint for d in told[1:]], max(d.plain for d in told)
        return told[0]

    def several(self) -> Diagnosis | None:
        parts = self._several(self.members, self.wrong)
        return self._told("values are", parts) if parts else None

    def equal_to(self, id: str) -> str:
        """What else gives the numbers of a declared mistake, in the search's words."""
        one = next(c for c in self.declared if c.id == id)
        compared = self._compared(self.members, self.everything).as_if(one.output)
        for c in self.changed:
            if c.everywhere and compared.explained(self._values(c, self.everything)).all():
                return f"your values are those of the reference {c.words}"
        compared = self._compared(self.members, self.some).as_if(one.output[self.some])
        for c in self.changed:
            if not c.everywhere and compared.explained(c.output).all():
                return f"your values are those of the reference {c.words}"
        return ""

    def _told(self, subject: str, parts: list[Explanation]) -> Diagnosis:
        first, *others = parts
        where = next((p.candidate.function for p in parts if p.candidate), self.function.name)
        mistake = Mistake(
            id=UNDECLARED, hint=_sentence(subject, first.words), margin=round(min(p.margin for p in parts), 2)
        )
        further = [_sentence(subject, p.words) for p in others]
        return Diagnosis(mistake, where, "", further, max(p.plain for p in parts), max(p.share for p in parts))

    # --- how it is found ---

    def _best(self, members: list[slice], wrong: np.ndarray) -> Explanation | None:
        """The plainest of those that explain it; None when none does, or when it could be anything."""
        everywhere = self._compared(members, self.everything)
        found = _accepted(self._same_there(everywhere, wrong), everywhere)
        sample = self._compared(members, self._sample(wrong))
        found += _accepted(self._of_truth(sample), sample)
        if self.changed:
            narrow = [c for c in self.changed if c.everywhere and len(c.rows) > 0.5 * wrong.sum()]
            values = [self._values(c, sample.rows) for c in narrow]
            for likely in _accepted(_as_they_are(sample, narrow, values), sample):
                whole = self._values(likely.candidate, self.everything)
                found += _accepted(_as_they_are(everywhere, [likely.candidate], [whole]), everywhere)
            compared = self._compared(members, self.some)
            if compared.wrong.sum() >= FEWEST:
                values = [self._values(c, self.some) for c in self.changed]
                here = _accepted(_as_they_are(compared, self.changed, values), compared)
                if not here and not found:
                    here = _accepted(_with_something(compared, self.changed, values), compared)
                    here = here or _accepted(_both(compared, self.changed, values), compared)
                found += here
        for e in found:
            if e.candidate is not None and e.candidate.function in self.right:
                e.plain += 1  # a function that is right is not at fault: what it does may be done over again
        return _plainest(found)

    def _sample(self, wrong: np.ndarray) -> np.ndarray:
        """Rows that stand for all: of the wrong ones and of the right ones at most SAMPLE each."""
        rng = np.random.default_rng(len(wrong))
        bad, good = rng.permutation(np.flatnonzero(wrong)), rng.permutation(np.flatnonzero(~wrong))
        return np.sort(np.concatenate([bad[:SAMPLE], good[:SAMPLE]]))

    def _same_there(self, compared: Compared, wrong: np.ndarray) -> Iterator[Explanation]:
        """One and the same on a condition: what a gate gives that should not be there."""
        columns = [k for m in compared.members for k in range(m.start, m.stop)]
        came = np.unique(self.actual[wrong][:, columns], axis=0)
        if len(came) == 1:
            place, values = self._place(wrong, compared.members), compared.truth.copy()
            values[np.ix_(place.rows if place else wrong, columns)] = came[0]
            where = f"where {place}" if place else "wherever they are wrong"
            yield _explanation(compared, f"{_vector(came[0])} {where}", values, 0 if place else 2)

    def _of_truth(self, compared: Compared) -> Iterator[Explanation]:
        if not compared.wrong.any():
            return
        for words, values, plain in of_result(compared, compared.truth, plain=True):
            yield _explanation(compared, f"{words} {_times(words)}what is expected", values, plain)
        for words, values, plain in of_members(self.function, compared.members, compared.truth):
            yield _explanation(compared, f"those of the reference with {words}", values, plain)
        for words, values, plain in of_directions(compared):
            yield _explanation(compared, words, values, plain)
        for words, values, plain in of_quantities(compared):
            said = words.removeprefix("ONLY ") if words.startswith("ONLY ") else f"what is expected {words}"
            yield _explanation(compared, said.replace(" ,", ","), values, plain)
        for words, values, plain in of_inner(compared):
            yield _explanation(compared, words, values, plain)
        for words, values, plain in of_sums(compared):
            yield _explanation(compared, words, values, plain)
        for words, values, plain in of_curve(compared) if len(compared.members) == 1 else ():
            yield _explanation(compared, words, values, plain)
        columns = [k for m in compared.members for k in range(m.start, m.stop)]
        came = compared.actual[:, columns]
        if len(values := np.unique(came[np.isfinite(came).all(axis=1)], axis=0)) == 1:
            constant = np.zeros_like(compared.truth)
            constant[:, columns] = values[0]
            yield _explanation(compared, f"always {_vector(values[0])}", constant, 0)

    def _several(self, members: list[slice], wrong: np.ndarray) -> list[Explanation]:
        """Up to three, one after the other, each of what the earlier ones leave; none where that leaves more than a tenth."""
        left, parts = wrong.copy(), []
        while left.sum() > UNEXPLAINED * wrong.sum() and len(parts) < SEVERAL:
            found = self._largest_part(members, left, wrong)
            if found is None:
                return []
            parts.append(found)
            left &= ~found.explained
        return parts if left.sum() <= UNEXPLAINED * wrong.sum() else []

    def _largest_part(self, members: list[slice], left: np.ndarray, wrong: np.ndarray) -> Explanation | None:
        """What explains most of what is left, on rows that one condition describes; or that condition alone."""
        enough = max(3, PART * wrong.sum())
        rows, everywhere = np.flatnonzero(left), self._compared(members, self.everything)
        offers = []
        for c in self.changed:
            if c.everywhere and len(c.rows) >= enough and "constant" not in c.words:
                at = c.rows.astype(int)  # where it differs from the truth
                here = everywhere.on(at)
                rows_explained = here.explained(c.output.astype(np.float64))
                # Else the student is right where this is not; and nothing and nothing are alike for any reason.
                something = here.shows()
                if min(rows_explained.mean(), rows_explained[something].mean() if something.any() else 1.0) > MOSTLY:
                    explained = np.zeros(len(self.actual), bool)
                    explained[at] = rows_explained
                    offers.append(Explanation(f"those of the reference {c.words}", explained & left, 0, c))
        place = self._place(left, members)
        if place is not None and left.sum() >= enough:
            inside = self._compared(members, np.flatnonzero(left & place.rows)[:SAMPLE])
            for e in self._of_truth(inside):
                if e.explained.mean() > 1 - UNEXPLAINED:
                    offers.append(Explanation(f"{e.words}, where {place}", left & place.rows, 0, plain=e.plain))
        for e in self._of_truth(self._compared(members, rows[:SAMPLE])) if place is None else ():
            if e.explained.mean() > 0.3 and e.plain < VAGUE:
                explained = np.zeros(len(self.actual), bool)
                explained[rows[:SAMPLE]] = e.explained
                table = self.judgement.table
                if e.explained.mean() > 0.95:
                    offers.append(Explanation(f"{e.words}, where it is wrong", left.copy(), 0, plain=e.plain))
                elif own := place_of(self.function, table.rows, table.truth, explained, explained | ~left):
                    offers.append(Explanation(f"{e.words}, where {own}", left & own.rows, 0, plain=e.plain))
        offers = [e for e in offers if (e.explained & left).sum() >= enough]
        if offers:
            most = max((e.explained & left).sum() for e in offers)
            best = min((e for e in offers if (e.explained & left).sum() > 0.9 * most), key=lambda e: e.plain)
            best.margin = float((best.explained & left).sum())
            return best
        if place and left.mean() < HALF:
            said = f"wrong where {place}{self._inside(members, place, left)}"
            return Explanation(said, left & place.rows, 0, None, 0 if place.plain else VAGUE, margin=float(left.sum()))
        table = self.judgement.table
        part = part_of(self.function, table.rows, table.truth, left, self._tells(left, members))
        if part and left.mean() < HALF and (left & part.rows).sum() >= 0.2 * wrong.sum():
            said = f"wrong where {part}{self._inside(members, part, left)}"
            return Explanation(said, left & part.rows, 0, plain=VAGUE, margin=float((left & part.rows).sum()))
        return None

    def _inside(self, members: list[slice], place: Condition, wrong: np.ndarray) -> str:
        """What came there."""
        columns = [k for m in members for k in range(m.start, m.stop)]
        rows = place.rows & wrong
        came, truth = self.actual[rows][:, columns], self.judgement.table.truth[rows][:, columns]
        if not np.isfinite(came).all(axis=1).any():
            return ", and not finite there"
        return ", and not 0 there" if (truth == 0).all() else ""

    def _place(self, wrong: np.ndarray, members: list[slice]) -> Condition | None:
        """Beside the rows that are right."""
        table = self.judgement.table
        return place_of(self.function, table.rows, table.truth, wrong, self._tells(wrong, members))

    def _tells(self, wrong: np.ndarray, members: list[slice]) -> np.ndarray:
        columns = [k for m in members for k in range(m.start, m.stop)]
        return telling(self.judgement.table.truth[:, columns], wrong, self.wrong)

    def _compared(self, members: list[slice], rows: np.ndarray) -> Compared:
        return Compared(self.function, self.judgement.table, self.actual, members, self.limit, rows, self.inner)

    def _values(self, c: Candidate, rows: np.ndarray) -> np.ndarray:
        """What a hypothesis gives on `rows` of the table: all, or `some`."""
        if not c.everywhere:
            return c.output.astype(np.float64)
        whole = self.judgement.table.truth.copy()
        whole[c.rows] = c.output
        return whole[rows]


def _explanation(
    compared: Compared, words: str, values: np.ndarray, plain: int, candidate: Candidate | None = None
) -> Explanation:
    explained = compared.explained(values)
    return Explanation(words, explained, int((~explained).sum()), candidate, plain)


def _as_they_are(compared: Compared, known: list[Candidate], values: list[np.ndarray]) -> Iterator[Explanation]:
    if not known:
        return
    explained = compared.explained(np.array(values))
    for c, rows in zip(known, explained):
        plain = 3 if "throughout" in c.words else 2
        yield Explanation(f"those of the reference {c.words}", rows, int((~rows).sum()), c, plain)


def _with_something(compared: Compared, known: list[Candidate], values: list[np.ndarray]) -> Iterator[Explanation]:
    """What happens to the result, too; of all at once on a few rows first."""
    order = np.argsort(~compared.wrong, kind="stable")[:SKETCH]
    sketch = compared.on(order)
    for words, changed in of_results(sketch, np.array(values)[:, order]):
        for k in np.flatnonzero(sketch.explained(changed).mean(axis=1) > 0.8):
            for whole_words, whole, plain in of_result(compared, values[k], plain=False):
                if whole_words == words or words == FACTOR_OF:
                    said = f"{whole_words} {_times(whole_words)}those of the reference {known[k].words}"
                    yield _explanation(compared, said, whole, 3 + plain, known[k])
    for changed, of in of_factors(sketch, np.array(values)[:, order]):
        for k in np.flatnonzero(sketch.explained(changed).mean(axis=1) > 0.8):
            for words, whole, plain in of(compared)(values[k]):
                said = f"{words} those of the reference {known[k].words}"
                yield _explanation(compared, said, whole, 3 + plain, known[k])


def _both(compared: Compared, known: list[Candidate], values: list[np.ndarray]) -> Iterator[Explanation]:
    """Two factors changed at once."""
    for i, j in of_pairs(compared, np.array(values)):
        with np.errstate(all="ignore"):
            both = np.where(compared.truth == 0, 0.0, values[i] * (values[j] / compared.truth))
        said = f"those of the reference {known[i].words}, and {known[j].words}"
        yield _explanation(compared, said, both, 4, known[i])


def _accepted(offers: Iterator[Explanation], compared: Compared) -> list[Explanation]:
    """Those that explain all but a tenth, much better than the truth does; each with its margin over the truth."""
    wrong, out = int(compared.wrong.sum()), []
    for e in offers:
        # On many rows and on few what explains all but one in ALL is as good.
        e.margin, e.share = min((wrong + 1) / (e.left + 1), ALL), e.left / max(wrong, 1)
        if e.left <= UNEXPLAINED * wrong and e.margin >= MARGIN:
            out.append(e)
    return out


def _plainest(found: list[Explanation]) -> Explanation | None:
    """Of the best ones the plainest; another that is as plain and as good is told, too."""
    if not found:
        return None
    least = max(e.margin for e in found)
    near = [e for e in found if e.margin * MARGIN > least]
    first, *others = sorted(near, key=lambda e: (e.plain, -e.margin))
    other = next(
        (e for e in others if e.plain == first.plain and not _says_the_same(e, first) and e.left <= first.left), None
    )
    if other is not None:
        first.words = f"{first.words}, or {other.words}"
    worse = [e.margin for e in found if e.margin * MARGIN <= least]
    first.margin = min([first.margin, *(first.margin / m for m in worse)])
    return first


def _says_the_same(one: Explanation, other: Explanation) -> bool:
    return one.words in other.words or other.words in one.words


def _times(words: str) -> str:
    return (
        "times " if re.fullmatch(r"-?[\d.e/()+-]*( ?pi)?( squared|/[\d.]+|\))?|sqrt\(.*\)|.*/sqrt\(.*\)", words) else ""
    )


def _sentence(subject: str, words: str) -> str:
    """`subject` is "values are" or a member's "diffuse is"."""
    if subject != "values are":
        words = words.replace("those of the reference", "that of the reference")
    return f"Your {subject} {words}."


def _vector(values: np.ndarray) -> str:
    return f"{values[0]:.4g}" if len(set(values.tolist())) == 1 else "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
