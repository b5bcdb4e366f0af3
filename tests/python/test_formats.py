"""The reports that other programs read keep to their published forms, whatever is printed, and leak nothing hidden."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from shadelab.errors import UserError
from shadelab.report.formats import markdown, short
from shadelab.report.formats.annotations import MOST, annotations
from shadelab.report.formats.classroom50 import classroom50
from shadelab.report.formats.gradescope import results
from shadelab.report.formats.junit import junit
from shadelab.report.formats.markdown import LIMIT, summary
from shadelab.report.formats.registry import FORMATS, write_format
from shadelab.report.wording import OUR_FAULT
from shadelab.result import Check, Error, Mistake, Result, Worst
from shadelab.words import plain

HOSTILE = (
    "</testcase>]]></failure><script>alert(1)</script> \x00\x08\x1b[2J\x9b31m\ufffe\uffff\ud800 \u202e ![x](http://x) [y](z)\r\n"
    "```\n~~~~\n````````\n</details>\n# heading\n| a | b |\n::error file=x::y\n::stop-commands::z\n%0A <img src=x onerror=y> & `"
)
SECRET = "secret-of-the-hidden-scene"
RUNNER = {
    "CLASSROOM": "graphics",
    "ASSIGNMENT": "phong-2026",
    "SUBMISSION_TAG": "submit/2026-06-01T14-32-05Z-a1b2c3d",
    "COMMIT_URL": "https://example.org/commit/1",
    "RELEASE_URL": "https://example.org/release/1",
    "REVIEW_URL": "https://example.org/compare/0...1",
}


def check(name: str, status: str, score: float, most: float, **rest: object) -> Check:
    backend, kind, *_ = name.split("/")
    return Check(id=name, kind=kind, backend=backend, status=status, score=score, max_score=most, seconds=0.25, **rest)


def make(*checks: Check, most: float | None = None, complete: bool = True, **environment: str) -> Result:
    most = sum(c.max_score for c in checks) if most is None else most
    result = Result(assignment="phong", submission="sha256:" + "0" * 64, max_score=most, complete=complete)
    for c in checks:
        result.add(c)
    result.environment = {"version": "1.2", "seed_digest": "0123456789abcdef", "cpu": "some", **environment}
    return result


def wrong(text: str) -> dict[str, object]:
    """Everything that a failed check may say."""
    worst = Worst(inputs={"n": [0.0, 0.0, 1.0], "odd": [None, text]}, expected=[0.5, 1.0, 2.0], actual=[0.5, None, 3.0])
    worst.replay = f"./shadelab eval submission half_vector --inputs '{text}'"
    return {
        "message": text + "\nsecond line",
        "printed": text,
        "mistake": Mistake(id=text, hint="What is its length? " + text, margin=3),
        "error": Error(name="scaled", value=0.25, limit=1e-3, floor=1.6e-4),
        "worst": worst,
    }


def ordinary() -> Result:
    return make(
        check("cpp/build", "passed", 0, 0),
        check("cpp/function/half_vector", "failed", 0, 2.5, **wrong("is not of unit length")),
        check("cpp/image/teapot", "failed", 10 / 3, 8, message="some pixels are off"),
        check("glsl/build", "passed", 0, 0),
        check("glsl/function/half_vector", "passed", 2.5, 2.5, error=Error(name="scaled", value=1e-5, limit=1e-2)),
        check("glsl/image/teapot", "passed", 8, 8, printed="hello"),
    )


def hostile() -> Result:
    result = make(
        check("cpp/build", "failed", 0, 0, message=HOSTILE),
        check("cpp/function/" + HOSTILE, "failed", 0, 2.5, **wrong(HOSTILE)),
        check("cpp/function/waiting", "skipped", 0, 2.5, needs=["cpp/build", HOSTILE]),
        check("glsl/function/half_vector", "error", 0, 3, message=HOSTILE),
        version=HOSTILE,
        seed_digest=HOSTILE,
    )
    result.assignment, result.submission = HOSTILE, HOSTILE
    return result


def huge() -> Result:
    noise = "`\x1b\x00<" * (5 << 18)  # 5 MB
    return make(*(check(f"cpp/function/f{k}", "failed", 0, 1, message=noise, printed=noise) for k in range(4)))


def cut_off() -> Result:
    return make(check("cpp/build", "passed", 0, 0), check("cpp/function/f", "passed", 2, 2), most=10, complete=False)


def build_failure() -> Result:
    message = "shading.cpp:12:5: 'foo' was not declared\n   12 |     foo(x);\n      |     ^~~\nshading.cpp:14: expected ';', not 100%"
    return make(
        check("cpp/build", "failed", 0, 0, message=message),
        check("cpp/function/f", "skipped", 0, 2, needs=["cpp/build"]),
        check("glsl/build", "passed", 0, 0),
        check("glsl/function/f", "passed", 2, 2),
        check("glsl/image/bunny", "skipped", 0, 0, message="the mesh bunny.ply is not on this machine"),
    )


def grader_error() -> Result:
    return make(check("cpp/build", "error", 0, 0, message="no space"), check("cpp/function/f", "error", 0, 2))


def with_hidden(status: str = "failed", score: float = 0.0) -> Result:
    return make(
        check("cpp/build", "passed", 0, 0),
        check("cpp/image/teapot", "passed", 8, 8),
        check("cpp/image/hidden-moved", status, score, 4, hidden=True, needs=["cpp/build", SECRET], **wrong(SECRET)),
        check("cpp/image/hidden-skipped", "skipped", 0, 4, hidden=True, needs=[SECRET], message=SECRET),
        check("cpp/image/hidden-error", "error", 0, 4, hidden=True, message=SECRET, printed=SECRET),
    )


def nothing_yet() -> Result:
    return make(most=100, complete=False)


MADE = [ordinary, hostile, huge, cut_off, build_failure, grader_error, with_hidden, nothing_yet]


@pytest.fixture(scope="module", params=MADE, ids=lambda f: f.__name__)
def result(request) -> Result:
    return request.param()


# --- Each form, strictly ---


def number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9


def string(value: object) -> bool:
    return isinstance(value, str)


def load(text: str):
    def refuse(what):
        raise AssertionError(f"{what} is not JSON")

    return json.loads(text, parse_constant=refuse)


VISIBILITY = {"hidden", "after_due_date", "after_published", "visible"}
OUTPUT_FORMATS = {"text", "html", "simple_format", "md", "ansi"}


def validate_gradescope(text: str) -> dict:
    """docs/specs.md: the fields that it names, with their types."""
    whole = load(text)
    rules = {
        "score": lambda v: number(v) and v >= 0, "execution_time": lambda v: number(v) and v >= 0, "output": string,
        "output_format": OUTPUT_FORMATS.__contains__, "stdout_visibility": VISIBILITY.__contains__,
        "extra_data": lambda v: isinstance(v, dict), "tests": lambda v: isinstance(v, list),
    }  # fmt: skip
    of_test = {
        "score": lambda v: number(v) and v >= 0, "max_score": lambda v: number(v) and v >= 0,
        "status": {"passed", "failed"}.__contains__, "name": lambda v: string(v) and v and "\n" not in v,
        "number": lambda v: string(v) and re.fullmatch(r"\d+\.\d+", v), "output": string,
        "output_format": OUTPUT_FORMATS.__contains__, "visibility": VISIBILITY.__contains__,
        "tags": lambda v: isinstance(v, list) and all(map(string, v)),
    }  # fmt: skip
    for thing, expected in [(whole, rules), *((test, of_test) for test in whole["tests"])]:
        assert set(thing) == set(expected)
        for key, rule in expected.items():
            assert rule(thing[key]), (key, thing[key])
    for test in whole["tests"]:
        assert test["score"] <= test["max_score"]
    assert len({test["number"] for test in whole["tests"]}) == len(whole["tests"])
    assert abs(whole["score"] - sum(test["score"] for test in whole["tests"])) < 1e-4
    return whole


def validate_classroom50(text: str) -> dict:
    """schemas/result-v1.schema.json, and the rules between fields that its runner checks."""
    whole = load(text)
    strings = ["classroom", "assignment", "submission", "commit", "release", "review", "datetime"]
    # owner and assignment_type are the runner's to add.
    assert set(whole) == {"schema", *strings, "score", "max-score", "tests"}
    assert whole["schema"] == "classroom50/result/v1"
    assert all(isinstance(whole[key], str) and whole[key] for key in strings)
    assert whole["submission"].startswith("submit/")
    assert re.fullmatch(r"\d{4}-\d{2}-\d{2}T([01]\d|2[0-3]):[0-5]\d:[0-5]\dZ", whole["datetime"])
    for thing in [whole, *whole["tests"]]:
        assert type(thing["score"]) is int and type(thing["max-score"]) is int
        assert 0 <= thing["score"] <= thing["max-score"]
    for test in whole["tests"]:
        assert isinstance(test["test-name"], str) and test["test-name"] and "\n" not in test["test-name"]
        assert type(test["passed"]) is bool
    for key in ("score", "max-score"):
        assert whole[key] == sum(test[key] for test in whole["tests"])
    return whole


# Of Jenkins' junit-10.xsd and Ant's JUnit.xsd what both allow. Element: attributes, those that must be there, children.
JUNIT = {
    "testsuites": ({"name", "time", "tests", "failures", "errors"}, {"tests", "failures", "errors"}, {"testsuite"}),
    "testsuite": (
        {"name", "tests", "failures", "errors", "skipped", "time"},
        {"name", "tests", "failures", "errors"},
        {"testcase"},
    ),
    "testcase": (
        {"name", "classname", "time"},
        {"name", "classname", "time"},
        {"failure", "error", "skipped", "system-out"},
    ),
    "failure": ({"type", "message"}, {"type"}, set()),
    "error": ({"type", "message"}, {"type"}, set()),
    "skipped": ({"type", "message"}, set(), set()),
    "system-out": (set(), set(), set()),
}


def validate_junit(text: str) -> ET.Element:
    root = ET.fromstring(text.encode())
    assert root.tag == "testsuites"
    for element in root.iter():
        allowed, needed, children = JUNIT[element.tag]
        assert needed <= set(element.attrib) <= allowed
        assert {child.tag for child in element} <= children
        if element.tag in ("testsuites", "testsuite", "testcase"):
            assert re.fullmatch(r"\d*\.\d{3}", element.get("time"))
            assert not (element.text or "").strip()
        if element.tag == "testcase":
            tags = [child.tag for child in element]
            assert len(tags) <= 2 and tags[1:] in ([], ["system-out"])
    for suite in root:
        counts = {"tests": "testcase", "failures": "testcase/failure", "errors": "testcase/error", "skipped": "testcase/skipped"}  # fmt: skip
        for key, path in counts.items():
            assert int(suite.get(key)) == len(suite.findall(path))
    for key in ("tests", "failures", "errors"):
        assert int(root.get(key)) == sum(int(suite.get(key)) for suite in root)
    return root


def validate_markdown(text: str) -> list:
    """Renders to nothing but what we write ourselves: no HTML, no links, no pictures; headings and rows are ours."""
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e\ud800-\udfff]", text)
    tokens = MarkdownIt("commonmark", {"html": True}).enable("table").parse(text)
    flat = tokens + [child for token in tokens for child in token.children or []]
    kinds = {token.type for token in flat}
    assert not kinds & {"html_block", "html_inline", "image", "link_open", "hr", "code_block", "blockquote_open"}, kinds
    for token in tokens:
        if token.type == "fence":
            assert not token.info and token.markup[0] == "`" and token.markup not in token.content
    return tokens


def test_gradescope_is_valid(result):
    whole = validate_gradescope(results(result))
    assert len(whole["tests"]) == len(result.checks)
    for output in [whole["output"], *(test["output"] for test in whole["tests"])]:
        validate_markdown(output)
        assert len(output) < 40_000


def test_classroom50_is_valid(result):
    for environment in ({}, RUNNER):
        whole = validate_classroom50(classroom50(result, environment))
        assert whole["max-score"] == round(100 * result.max_score)


def test_junit_is_valid(result):
    root = validate_junit(junit(result))
    assert len(list(root.iter("testcase"))) == len(result.checks) + (not result.complete)
    assert len(list(root.iter("failure"))) == sum(c.status == "failed" for c in result.checks)


def test_markdown_is_valid(result):
    text = summary(result)
    tokens = validate_markdown(text)
    assert len(text.encode()) <= LIMIT < 1 << 20
    headings = [t for t in tokens if t.type == "heading_open"]
    shown = sum(c.status in ("failed", "error") and not c.hidden for c in result.checks)
    assert len(headings) == 1 + (shown + 1 if shown else 0)


def test_same_result_same_text(result, monkeypatch):
    for name in RUNNER:
        monkeypatch.delenv(name, raising=False)
    again = Result.model_validate(result.model_dump())
    for made in FORMATS.values():
        assert made.text(result) == made.text(again)


# --- What they say ---


def by_name(whole: dict) -> dict:
    return {test["name"]: test for test in whole["tests"]}


def test_a_wrong_function_is_explained():
    wanted = ["is not of unit length", "What is its length?", "n = (0, 0, 1)", "expected (0.5, 1, 2)", "yours (0.5, not finite, 3)",
              "./shadelab eval submission half_vector", "Error (scaled): 0.25, limit 0.001 (rounding alone gives 0.00016)"]  # fmt: skip
    result = ordinary()
    test = by_name(validate_gradescope(results(result)))["half_vector (C++)"]
    assert (test["status"], test["score"], test["max_score"]) == ("failed", 0, 2.5)
    assert test["tags"] == ["cpp", "function"] and test["number"] == "2.1"
    failure = ET.fromstring(junit(result)).find(".//testcase[@name='half_vector']/failure")
    for text in (test["output"], summary(result), failure.text):
        assert [w for w in wanted if w not in text] == []


def test_points_are_shown_everywhere():
    result = ordinary()
    assert "| `half_vector` | ✗ 0 / 2.5 | ✓ 2.5 / 2.5 |" in summary(result)
    assert "| image `teapot` | ✗ 3.33 / 8 | ✓ 8 / 8 |" in summary(result)
    assert "# phong: 13.83 of 21 points" in summary(result)
    whole = validate_gradescope(results(result))
    assert whole["score"] == result.score and "13.83 of 21 points" in whole["output"]
    assert whole["execution_time"] == 1.5
    assert whole["extra_data"] == {"schema": "shadelab/result/1", "version": "1.2", "seed_digest": "0123456789abcdef"}
    names = {t["test-name"]: t["score"] for t in validate_classroom50(classroom50(result, RUNNER))["tests"]}
    assert names["image teapot (C++)"] == 333 and names["half_vector (GLSL)"] == 250
    assert "2.5 of 2.5 points" in junit(result)


def test_classroom50_takes_the_runners_variables(monkeypatch):
    whole = validate_classroom50(classroom50(ordinary(), RUNNER))
    assert (whole["classroom"], whole["assignment"]) == ("graphics", "phong-2026")
    assert whole["datetime"] == "2026-06-01T14:32:05Z"
    assert whole["review"] == RUNNER["REVIEW_URL"]
    for name, value in RUNNER.items():
        monkeypatch.setenv(name, value)
    assert load(classroom50(ordinary())) == whole
    alone = validate_classroom50(classroom50(ordinary(), {}))
    assert (alone["classroom"], alone["assignment"], alone["submission"]) == ("local", "phong", "submit/local")


@pytest.mark.parametrize("thirds", [1, 2, 3, 7, 100])
def test_classroom50_rounds_consistently(thirds):
    checks = [check(f"cpp/function/f{k}", "failed", 1 / 3, 1 / 3 + 1e-9 * k) for k in range(thirds)]
    whole = validate_classroom50(classroom50(make(*checks), {}))
    assert whole["score"] == whole["max-score"] == 33 * thirds


def test_a_cut_off_run_says_so():
    result = cut_off()
    whole = validate_gradescope(results(result))
    assert "cut off" in whole["output"] and whole["score"] == 2
    assert "cut off" in summary(result)
    root = validate_junit(junit(result))
    assert root.get("errors") == "1" and "cut off" in root.find(".//error").get("message")
    last = validate_classroom50(classroom50(result, {}))["tests"][-1]
    assert (last["passed"], last["score"], last["max-score"]) == (False, 0, 800) and "cut off" in last["test-name"]
    for made in FORMATS.values():
        assert "cut off" not in made.text(ordinary())


def test_a_build_failure_is_one_failure():
    result = build_failure()
    tests = by_name(validate_gradescope(results(result)))
    assert tests["build (C++)"]["status"] == "failed" and "not declared" in tests["build (C++)"]["output"]
    assert "Waits for `cpp/build`" in tests["f (C++): skipped"]["output"]
    assert tests["f (C++): skipped"]["status"] == "failed"
    assert tests["image bunny (GLSL): skipped"]["status"] == "passed", "costs nothing"
    root = validate_junit(junit(result))
    assert [s.get("failures") + s.get("skipped") for s in root] == ["11", "01"]
    skipped = root.find(".//testcase[@name='f']/skipped")
    assert skipped.get("message") == "waits for cpp/build"
    assert "Make shading.cpp compile first" in summary(result)


def test_a_grader_error_is_not_the_students():
    result = grader_error()
    whole = validate_gradescope(results(result))
    assert OUR_FAULT in whole["output"] and "Grader errors: 2" in whole["output"]
    assert all(OUR_FAULT in test["output"] and "grader error" in test["name"] for test in whole["tests"])
    assert summary(result).count(OUR_FAULT) == 3
    root = validate_junit(junit(result))
    assert (root.get("errors"), root.get("failures")) == ("2", "0")
    assert all(error.get("message") == OUR_FAULT for error in root.iter("error"))
    for test in validate_classroom50(classroom50(result, {}))["tests"]:
        assert test["status"] == "error" and test["message"] == OUR_FAULT


# --- What they don't say ---


@pytest.mark.parametrize("make_text", [summary, junit, lambda r: classroom50(r, {})], ids=["markdown", "junit", "classroom50"])  # fmt: skip
def test_of_hidden_checks_only_name_status_and_points(make_text):
    text = make_text(with_hidden())
    assert SECRET not in text and "What is its length" not in text and "rounding alone" not in text
    assert "hidden-moved" in text
    # Nor does anything else than status and points depend on what is hidden.
    bare = with_hidden()
    for c in bare.checks:
        if c.hidden:
            c.message, c.printed, c.worst, c.mistake, c.error, c.needs = "", "", None, None, None, []
    assert make_text(bare) == text


def test_gradescope_conceals_hidden_checks_until_the_due_date():
    whole = validate_gradescope(results(with_hidden()))
    hidden = [t for t in whole["tests"] if t["visibility"] == "after_due_date"]
    assert {t["name"].split(":")[0] for t in hidden} == {
        f"image hidden-{x} (C++)" for x in ("moved", "skipped", "error")
    }
    assert all(SECRET in t["output"] for t in hidden)
    public = [t for t in whole["tests"] if t["visibility"] == "visible"]
    assert len(public) == 2 and SECRET not in json.dumps([public, whole["output"]])
    assert whole["stdout_visibility"] == "hidden"
    # What is shown at once is the same whatever came of the hidden checks: not even their points.
    other = validate_gradescope(results(with_hidden("passed", 4)))
    assert other["output"] == whole["output"] and "8 of 8 points" in whole["output"]
    assert [t for t in other["tests"] if t["visibility"] == "visible"] == public


def test_a_failed_hidden_check_is_not_called_a_pass():
    for text in (results(with_hidden()), summary(with_hidden())):
        assert "every check passes" not in text


def test_a_public_check_does_not_name_the_hidden_one_that_it_waits_for():
    result = make(
        check("cpp/image/hidden-x", "failed", 0, 1, hidden=True),
        check("cpp/image/teapot", "skipped", 0, 1, needs=["cpp/image/hidden-x", "cpp/build"]),
    )
    public = by_name(validate_gradescope(results(result)))["image teapot (C++): skipped"]
    assert "Waits for `cpp/build`." in public["output"]


# --- Lengths ---


def test_much_output_is_cut():
    result = huge()
    whole = validate_gradescope(results(result))
    for test in whole["tests"]:
        assert f"… {len(result.checks[0].printed) - short.PRINTED} more characters" in test["output"]
    assert len(junit(result)) < 200_000 and len(summary(result)) < 100_000


def test_a_long_summary_is_cut_between_blocks(monkeypatch):
    noise = "`" * 4000 + "ü" * 5000
    result = make(*(check(f"cpp/function/f{k}", "failed", 0, 1, message=noise, printed=noise) for k in range(70)))
    text = summary(result)
    validate_markdown(text)
    assert LIMIT - 60_000 < len(text.encode()) <= LIMIT
    assert text.endswith(markdown.CUT)
    monkeypatch.setattr(markdown, "LIMIT", 5000)
    rows = summary(make(*(check(f"cpp/function/f{k}", "passed", 1, 1) for k in range(400))))
    assert rows.endswith("| ✓ 1 / 1 |\n" + markdown.CUT) and len(rows.encode()) <= 5000


@pytest.mark.parametrize("text", ["", "`", "``a```", "a`b|c", "````\n```", "\\", HOSTILE])
def test_code_and_fences_hold_what_they_are_given(text):
    text = plain(text)
    fence, end = MarkdownIt().parse(markdown.fenced(text) + "\n\nend")[0], markdown.fenced(text)
    assert fence.type == "fence" and fence.content.rstrip("\n") == text.rstrip("\n") and end.count("\n") >= 2
    inside = MarkdownIt().parse(f"x {markdown.code(text)} y")[1].children
    assert [t.type for t in inside] == ["text", "code_inline", "text"]


# --- Annotations ---


def test_annotations_name_file_and_line():
    assert annotations(build_failure(), "work/phong/") == [
        "::error file=work/phong/shading.cpp,line=12,col=5,title=C++ does not compile::'foo' was not declared",
        "::error file=work/phong/shading.cpp,line=14,title=C++ does not compile::expected ';', not 100%25",
    ]
    alone = make(check("glsl/build", "failed", 0, 0, message="shading.glsl: the function f is missing"))
    assert annotations(alone) == [
        "::error file=shading.glsl,title=GLSL does not compile::the function f is missing"
    ]  # fmt: skip
    assert annotations(ordinary()) == annotations(grader_error()) == []


def test_annotations_are_few_and_escaped():
    errors = "\n".join(f"shading.cpp:{k}:1: {HOSTILE}" for k in range(1, 30))
    lines = annotations(make(check("cpp/build", "failed", 0, 0, message=errors)), "a,b:c%\nd")
    assert len(lines) == MOST
    for k, text in enumerate(lines, 1):
        assert text.startswith(f"::error file=a%2Cb%3Ac%25%0Ad/shading.cpp,line={k},col=1,title=C++ does not compile::</testcase>")  # fmt: skip
        assert "\n" not in text and "\r" not in text and "\x1b" not in text


# --- Files ---


def test_write_replaces_the_whole_file(tmp_path: Path):
    names = {"gradescope": "results.json", "classroom50": "classroom50.json", "junit": "junit.xml", "markdown": "summary.md"}  # fmt: skip
    assert names.items() <= {name: made.file for name, made in FORMATS.items()}.items()
    for name, file in names.items():
        for result in (cut_off(), hostile()):
            assert write_format(name, result, tmp_path) == tmp_path / file
            assert (tmp_path / file).read_text(encoding="utf-8") == FORMATS[name].text(result)
    assert {f.name for f in tmp_path.iterdir()} == set(names.values())


def test_a_report_that_fails_leaves_the_last_one(tmp_path: Path):
    file = write_format("gradescope", ordinary(), tmp_path)
    before = file.read_text()
    broken = ordinary()
    broken.score = float("nan")
    with pytest.raises(ValueError):
        write_format("gradescope", broken, tmp_path)
    assert file.read_text() == before


def test_an_unknown_format_is_named(tmp_path: Path):
    with pytest.raises(UserError, match="pdf.*gradescope, classroom50, junit, markdown"):
        write_format("pdf", ordinary(), tmp_path)
