"""A name of the standard library without its header: which line is missing is said."""

import pytest

LOBE = "    return exp(q * log1p(-x));\n    // STUDENT END: return 0.0;\n}\n\n// The half-vector lobe"


@pytest.mark.parametrize(
    "line, header, told",
    [
        ('printf("%g", double(q));', "cstdio", "'printf' was not declared in this scope; put"),
        ('std::fprintf(stderr, "%g", double(q));', "cstdio", "'fprintf' is not a member of 'std'; put"),
        ("std::vector<Real> a; a.push_back(q);", "vector", "'vector' is not a member of 'std'; put"),
        ("vector<Real> a; a.push_back(q);", "vector", "it is std::vector; put"),
        ("std::cout << q << std::endl;", "iostream", "'cout' is not a member of 'std'; put"),
        ("cout << q;", "iostream", "it is std::cout; put"),
        ("Real a[] = {q, x}; std::sort(a, a + 2);", "algorithm", "'sort' is not a member of 'std'; put"),
        ("std::deque<Real> a;", "deque", "'deque' is not a member of 'std'; put"),
    ],
)
def test_a_missing_header_is_named(grade, submission, line, header, told):
    folder = submission(cpp={LOBE: f"    {line}\n{LOBE}"})
    build = grade(folder, only="cpp/build")["by_id"]["cpp/build"]
    first = build["message"].splitlines()[0]
    assert first.endswith(f"{told} #include <{header}> at the top of shading.cpp"), build["message"]
    assert "did you mean" not in build["message"] and build["message"].count("#include") == 1 + build["message"].count(
        "\nshading.cpp"
    )
    source = folder / "shading.cpp"
    source.write_text(f"#include <{header}>\n" + source.read_text())
    after = grade(folder, only="cpp/build")["by_id"]["cpp/build"]
    assert after["status"] == "passed" or "it is std::" in told, after["message"]
