"""Single-token mistakes, bred from a body: what is changed, and what is left alone."""

import re

import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.bodies import tokens
from shadelab.course.mistakes import load_changes, regions
from shadelab.course.mutants import Scope, mutants

BODY = """\
    // Clamped: a - b * 2.0, as max(a, b) says.
    if (dot(n, l) <= 0.0) return 0.0;
    Real c = max(dot(n, v), 0.5);
    return -pow(c, q) + 2.0 * c; // 3.0 - c
"""


def bred(body=BODY, function="f"):
    return {mutant.id: mutant.body for mutant in mutants(function, body)}


def changed(id):
    return bred()[id]


def test_operators():
    assert "if (dot(n, l) < 0.0)" in changed("f: <= -> < in if (dot(n, l) <= 0.0) return 0.0;")
    assert "if (dot(n, l) > 0.0)" in changed("f: <= -> > in if (dot(n, l) <= 0.0) return 0.0;")
    last = "return -pow(c, q) + 2.0 * c; // 3.0 - c"
    assert "-pow(c, q) - 2.0 * c;" in changed(f"f: + -> - in {last}")
    assert "-pow(c, q) + 2.0 / c;" in changed(f"f: * -> / in {last}")


def test_a_sign_is_dropped_and_not_swapped():
    last = "return -pow(c, q) + 2.0 * c; // 3.0 - c"
    assert "return pow(c, q) + 2.0 * c;" in changed(f"f: - dropped in {last}")
    assert f"f: - -> + in {last}" not in bred()


def test_constants():
    line = "Real c = max(dot(n, v), 0.5);"
    for new in ("1.5", "0.0", "0.55"):
        number = f"{float(new):g}"
        assert f"Real c = max(dot(n, v), {new});" in changed(f"f: 0.5 -> {number} in {line}")
    assert bred("return v[0] + 1;", "g")["g: 1 -> 2 in return v[0] + 1;"] == "return v[0] + 2;"  # an int stays one


def test_calls_and_arguments():
    line = "Real c = max(dot(n, v), 0.5);"
    assert "Real c = (0.5);" in changed(f"f: max(...) -> its argument 2 in {line}")
    assert "Real c = (dot(n, v));" in changed(f"f: max(...) -> its argument 1 in {line}")
    assert "Real c = max((v), 0.5);" in changed(f"f: dot(...) -> its argument 2 in {line}")
    assert "pow(q, c)" in changed("f: arguments 1 and 2 of pow swapped in return -pow(c, q) + 2.0 * c; // 3.0 - c")
    assert not any("of max swapped" in id or "of dot swapped" in id for id in bred())  # they are symmetric
    assert not any("swapped" in id for id in bred("return pow(c, c);"))  # changes nothing
    assert not any("if(...)" in id or "return(...)" in id for id in bred("if (a) return (b);"))


def test_a_gate_is_dropped_with_what_it_returns():
    gate = "if (dot(n, l) <= 0.0) return 0.0;"
    assert gate not in changed(f"f: if dropped in {gate}")
    assert changed(f"f: if dropped in {gate}").count("return") == 1
    assert not any("if dropped" in id for id in bred("if (a > b) { c = d; }"))


def test_comments_are_left_alone():
    comments = re.findall(r"//.*", BODY)
    for id, body in bred().items():
        assert re.findall(r"//.*", body) == comments, id
    assert not mutants("f", "// a - b * max(2.0, c)\n")
    assert [t.text for t in tokens("a // b - c\n<= 1.5e-3")] == ["a", "<=", "1.5e-3"]


def test_every_mutant_is_another_body_under_a_name_of_its_own():
    body = BODY + "    return 0.0;\n    return 0.0;\n"
    one, two = mutants("f", body), mutants("f", body)
    assert one == two  # the same names tomorrow: mistakes.toml refers to them
    names = [m.id for m in one]
    assert len(set(names)) == len(names) and "f: 0.0 -> 1 in return 0.0; (2)" in names
    assert all(m.body != body for m in one) and len({m.body for m in one}) == len(one)


@pytest.mark.parametrize("name", assignment_names())
def test_equivalent_ones_are_mutants_of_either_language_and_have_a_reason(name):
    assignment = load_assignment(ROOT / "solution" / name)
    changes, known = load_changes(assignment), set()
    for file in assignment.files:
        source = assignment.directory / file
        for function, region in regions(source.read_text(), source).items():
            scope = Scope.of(assignment, assignment.function(function), source.read_text())
            known |= {m.id for m in mutants(function, region["body"], scope)}
    for equivalent in changes.equivalent:
        assert equivalent.id in known
        assert len(equivalent.reason) > 10
    assert len({e.id for e in changes.equivalent}) == len(changes.equivalent)
