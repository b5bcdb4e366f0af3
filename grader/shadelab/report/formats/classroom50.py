"""Classroom 50's result, schema "classroom50/result/v1" (its wiki: Advanced Autograding).

Scores are integers there: hundredths of points, each rounded by itself, and the totals are the sums of what was
rounded. A test may carry further fields: `status` tells a skipped check from a failed one, and `message` that an error
is ours.
"""

import json
import os
import re
from collections.abc import Mapping
from typing import Any

from shadelab.report.formats import short
from shadelab.report.wording import OUR_FAULT, STATUS, in_order
from shadelab.result import Check, Result

SCHEMA = "classroom50/result/v1"

# submit/2026-06-01T14-32-05Z-a1b2c3d
_tag = re.compile(r"^submit/(\d{4}-\d\d-\d\d)T([01]\d|2[0-3])-([0-5]\d)-([0-5]\d)Z")


def classroom50(result: Result, environment: Mapping[str, str] | None = None) -> str:
    """Who submitted what, and when, is in the variables of Classroom 50's runner: CLASSROOM, ASSIGNMENT,
    SUBMISSION_TAG, COMMIT_URL, RELEASE_URL, REVIEW_URL. It adds the owner and the assignment's type itself.

    The moment is the submission's, as its tag has it, and not that of grading: grading again changes nothing.
    """
    given = os.environ if environment is None else environment
    submission = given.get("SUBMISSION_TAG") or "submit/local"
    commit = given.get("COMMIT_URL") or result.submission or "local"
    found = _tag.match(submission)
    tests = [_test(check) for check in in_order(result, *STATUS)]
    if not result.complete:
        unseen = max(0, _hundredths(result.max_score) - sum(t["max-score"] for t in tests))
        tests.append({
            "test-name": "grading was cut off before its end", "passed": False, "score": 0, "max-score": unseen,
            "status": "skipped", "message": "This is what was earned until then: run it again.",
        })  # fmt: skip
    whole = {
        "schema": SCHEMA,
        "classroom": given.get("CLASSROOM") or "local",
        "assignment": given.get("ASSIGNMENT") or result.assignment,
        "submission": submission,
        "commit": commit,
        "release": given.get("RELEASE_URL") or commit,
        "review": given.get("REVIEW_URL") or commit,
        "datetime": f"{found[1]}T{found[2]}:{found[3]}:{found[4]}Z" if found else "1970-01-01T00:00:00Z",
        "score": sum(t["score"] for t in tests),
        "max-score": sum(t["max-score"] for t in tests),
        "tests": tests,
    }
    return json.dumps(whole, indent=1) + "\n"


def _test(check: Check) -> dict[str, Any]:
    most = _hundredths(check.max_score)
    return {
        "test-name": short.name(check),
        "passed": check.status == "passed",
        "score": min(_hundredths(check.score), most),
        "max-score": most,
        "status": check.status,
        **({"message": OUR_FAULT} if check.status == "error" else {}),
    }


def _hundredths(points: float) -> int:
    return max(0, round(100 * points))
