"""The language that students write in: shading.hpp, shading.glsl and math.hpp.

One text means the same in GLSL and in both C++ builds (tests/expressions.toml), loops over it vectorise, and the math
below it is as accurate as its header says and the same on every machine.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if shutil.which("g++") is None:
    pytest.skip("no g++ on PATH", allow_module_level=True)

ROOT = Path(__file__).parents[2]
INCLUDE = ROOT / "framework" / "include"
EXPRESSIONS = tomllib.loads((ROOT / "tests" / "expressions.toml").read_text(encoding="utf-8"))["expressions"]
COMPONENTS = {"Real": 1, "vec2": 2, "vec3": 3, "vec4": 4}

# The flags of a student's plugin.
COMMON_FLAGS = ["-std=c++20", "-O3", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off"]
FLAGS = {
    "float": [*COMMON_FLAGS, "-fsingle-precision-constant"],
    "double": [*COMMON_FLAGS, "-DSHADELAB_REAL=double"],
}

# a, b, x, y: one line an input. Dyadic fractions, so that the three builds start from the same numbers. Negative
# components, dot(a, b) of both signs, and nothing within 1e-3 of a place where one of the expressions jumps.
INPUTS = np.array(
    [
        [0.40625, 0.71875, 0.59375, -0.28125, 0.84375, 0.46875, 0.34375, 0.78125],
        [-0.53125, 0.21875, 0.84375, 0.65625, -0.71875, 0.34375, 0.65625, 0.40625],
        [1.28125, -0.34375, 0.15625, 0.59375, 0.90625, -1.15625, 0.15625, 0.53125],
        [0.28125, 0.96875, -0.21875, 0.84375, 0.15625, 1.40625, 0.90625, 0.09375],
        [-0.65625, -0.78125, -0.40625, -0.53125, -0.34375, -0.90625, 0.46875, 0.96875],
    ],
    dtype=np.float32,
)

# float32 rounding alone is 1e-7 an operation; a driver's own pow, exp and sin are good to about 2e-5 (llvmpipe), and
# subtractions in the expressions magnify that a few times. The absolute part is for results near zero.
RELATIVE, ABSOLUTE = 1e-4, 1e-5


def build(folder: Path, name: str, source: str, flags: list[str]) -> Path:
    """Compiles a program and returns its path; fails with the compiler's own words."""
    program, text = folder / name, folder / f"{name}.cpp"
    text.write_text(source, encoding="utf-8")
    command = ["g++", *flags, f"-I{INCLUDE}", text, "-o", program]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.fail(f"{name} does not compile:\n{done.stderr}", pytrace=False)
    return program


def run(program: Path) -> str:
    return subprocess.run([program], capture_output=True, text=True, check=True).stdout


def functions() -> str:
    """Each expression as a function on one line; a compiler's message names `expression_12`."""
    return "\n".join(
        f"{e['type']} expression_{i}(vec3 a, vec3 b, Real x, Real y) {{ {e['code']} }}"
        for i, e in enumerate(EXPRESSIONS)
    )


# ---- one text, three languages ----------------------------------------------------------------------------------


def values_of_cpp(folder: Path, real: str) -> np.ndarray:
    """What the C++ build with that Real returns: [expression, input, component], unused components 0."""
    inputs = ",\n".join("{" + ", ".join(repr(float(v)) for v in row) + "}" for row in INPUTS)
    calls = "\n".join(
        f"        print(expression_{i}(vec3(r[0], r[1], r[2]), vec3(r[3], r[4], r[5]), r[6], r[7]));"
        for i in range(len(EXPRESSIONS))
    )
    source = f"""
#include <shadelab/shading.hpp>
#include <cstdio>
{functions()}

template <typename T> void print(const T& value) {{
    double out[4] = {{0, 0, 0, 0}};
    if constexpr (std::is_same_v<T, Real>) {{
        out[0] = value;
    }} else {{
        for (int i = 0; i < T::length(); ++i) out[i] = value[i];
    }}
    std::printf("%.17g %.17g %.17g %.17g\\n", out[0], out[1], out[2], out[3]);
}}

const Real inputs[][8] = {{{inputs}}};

int main() {{
    for (const Real (&r)[8] : inputs) {{
{calls}
    }}
}}
"""
    lines = run(build(folder, real, source, FLAGS[real])).split()
    return np.array(lines, dtype=float).reshape(len(INPUTS), len(EXPRESSIONS), 4).swapaxes(0, 1)


@pytest.fixture(scope="module")
def cpp(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    folder = tmp_path_factory.mktemp("expressions")
    return {real: values_of_cpp(folder, real) for real in FLAGS}


@pytest.fixture(scope="module")
def glsl() -> np.ndarray:
    """What GLSL returns: a pixel for each expression (row) and input (column) of a float framebuffer."""
    context = pytest.importorskip("shadelab.gl.context").create_context()
    pad = {"Real": "vec4({}, 0, 0, 0)", "vec2": "vec4({}, 0, 0)", "vec3": "vec4({}, 0)", "vec4": "{}"}
    cases = "\n".join(
        f"    if (row == {i}) result = " + pad[e["type"]].format(f"expression_{i}(a[k], b[k], xy[k].x, xy[k].y)") + ";"
        for i, e in enumerate(EXPRESSIONS)
    )
    # Uniforms, because the compiler would fold constants with arithmetic of its own. No `switch`: Mesa 22.3 loses the
    # `break` behind a call of a function with a loop, and falls through.
    fragment = f"""#version 330
{(ROOT / "framework" / "glsl" / "prelude.glsl").read_text(encoding="utf-8")}
uniform vec3 a[{len(INPUTS)}];
uniform vec3 b[{len(INPUTS)}];
uniform vec2 xy[{len(INPUTS)}];
out vec4 result;
{functions()}
void main() {{
    int k = int(gl_FragCoord.x), row = int(gl_FragCoord.y);
{cases}
}}
"""
    vertex = """#version 330
void main() {
    gl_Position = vec4(4 * (gl_VertexID % 2) - 1, 4 * (gl_VertexID / 2) - 1, 0, 1); // one triangle over everything
}
"""
    program = context.program(vertex_shader=vertex, fragment_shader=fragment)
    program["a"].write(np.ascontiguousarray(INPUTS[:, 0:3]).tobytes())
    program["b"].write(np.ascontiguousarray(INPUTS[:, 3:6]).tobytes())
    program["xy"].write(np.ascontiguousarray(INPUTS[:, 6:8]).tobytes())
    size = (len(INPUTS), len(EXPRESSIONS))
    target = context.framebuffer([context.renderbuffer(size, components=4, dtype="f4")])
    target.use()
    context.vertex_array(program, []).render(mode=context.TRIANGLES, vertices=3)
    pixels = np.frombuffer(target.read(components=4, dtype="f4"), dtype=np.float32)
    values = pixels.reshape(len(EXPRESSIONS), len(INPUTS), 4).astype(float)
    context.release()
    return values


def assert_agree(index: int, one: np.ndarray, other: np.ndarray) -> None:
    count = COMPONENTS[EXPRESSIONS[index]["type"]]
    one, other = one[index, :, :count], other[index, :, :count]
    assert np.isfinite(other).all(), EXPRESSIONS[index]["code"]
    np.testing.assert_allclose(one, other, RELATIVE, ABSOLUTE, err_msg=EXPRESSIONS[index]["code"])


@pytest.mark.parametrize("index", range(len(EXPRESSIONS)))
def test_float_and_double_agree(index: int, cpp: dict[str, np.ndarray]) -> None:
    assert_agree(index, cpp["float"], cpp["double"])


@pytest.mark.parametrize("index", range(len(EXPRESSIONS)))
def test_glsl_and_cpp_agree(index: int, glsl: np.ndarray, cpp: dict[str, np.ndarray]) -> None:
    assert_agree(index, glsl, cpp["double"])


# ---- what a student may put around it ---------------------------------------------------------------------------

EVERYDAY = """
Real lobe(vec3 n, vec3 l, vec3 v, Real q) {
    Real e = 5;
    return pow(max(dot(reflect(-l, n), v), 0.0), q) + pow(e, 5) + exp(-e) + sqrt(e) + abs(-e) + min(1, e)
        + clamp(e, 0, 1) + distance(n, l) + floor(e) + round(e) + log(e) + acos(0.5) + atan(e, 2)
        + mix(e, q, 0.5) + max(e, q)
        + dot(max(n, 0), 2.0 * l) + (isnan(e) ? 1 : 0) + fract(e) + step(0.5, e) + mod(e, 2) + log1p(e) + length(n);
}
"""
OURS = "#include <shadelab/shading.hpp>\n"
HEADERS = "#include <math.h>\n#include <cmath>\n#include <iostream>\n#include <algorithm>\n"
HELPERS = """
vec3 reflect(vec3 i, vec3 n) { return i - 2 * dot(n, i) * n; }
Real saturate(Real x) { return clamp(x, 0, 1); }
template <typename T> T square(T x) { return x * x; }
Real mix(Real a, Real b, Real t) { return a + t * (b - a); }
Real max(Real a, Real b) { return a > b ? a : b; }
vec3 mirror(vec3 l, vec3 n) { return reflect(-l, n) * square(saturate(dot(n, l))) * max(n.x, l.x); }
"""
FREE_NAMES = """
namespace math { inline Real two() { return 2; } }
namespace detail { inline Real one() { return math::two() / 2; } }
using vec = vec3;
struct Scene { vec mat; };
vec lit(Scene s) { return s.mat * detail::one(); }
"""
AROUND = {
    "headers before": HEADERS + OURS + EVERYDAY,
    "headers after": OURS + HEADERS + EVERYDAY,
    "using std": OURS + HEADERS + "using namespace std;\n" + EVERYDAY,
    "glm itself": "#include <glm/glm.hpp>\n" + OURS + "#include <glm/glm.hpp>\n" + EVERYDAY,
    "own helpers": OURS + HELPERS + EVERYDAY,
    "names of ours that stay free": OURS + FREE_NAMES + EVERYDAY,
}


@pytest.mark.parametrize("real", FLAGS)
@pytest.mark.parametrize("around", AROUND)
def test_students_may_add(around: str, real: str, tmp_path: Path) -> None:
    build(tmp_path, "student", AROUND[around], [*FLAGS[real], "-fsyntax-only", "-Wall", "-Wextra", "-Werror"])


def test_a_students_helper_wins(tmp_path: Path) -> None:
    source = OURS + "#include <cstdio>\nvec3 reflect(vec3 i, vec3 n) { return vec3(7); }\n"
    source += 'int main() { std::printf("%g", double(reflect(vec3(1), vec3(1)).x)); }\n'
    assert run(build(tmp_path, "helper", source, FLAGS["float"])) == "7"


# ---- speed: a batch loop over a student's function vectorises ---------------------------------------------------

# A student's function as students write it: a gate that returns early, a literal 2.0, a pow; and the shape of the loop
# that the framework generates around it. GCC 12 does not take a `const Terms t` in that loop apart into its members,
# and the whole loop stays scalar.
STUDENT = {
    "early return": """
    Terms t = Terms{m.ka, vec3(0), vec3(0)};
    Real nl = dot(n, l);
    if (nl <= 0.0) return t;
    t.diffuse = m.kd * nl;
    vec3 r = 2.0 * nl * n - l;
    t.specular = m.ks * pow(max(dot(r, v), 0.0), m.q);
    return t;""",
    "conditional operator": """
    Real nl = max(dot(n, l), 0);
    Real s = nl > 0 ? pow(max(dot(reflect(-l, n), v), 0.0), m.q) : 0.0;
    return Terms{m.ka, m.kd * nl, m.ks * s};""",
    "stable form behind two gates": """
    Terms t = Terms{m.ka, vec3(0), vec3(0)};
    if (dot(n, l) <= 0.0 || dot(n, v) <= 0.0) return t;
    vec3 d = n - normalize(l + v);
    Real s = dot(d, d);
    t.diffuse = m.kd * dot(n, l);
    t.specular = m.ks * (s < 2.0 ? exp(m.q * log1p(-s / 2.0)) : 0.0) * pow(vec3(0.5, x, 1), vec3(2));
    return t;""",
}


def batch_kernel(body: str) -> str:
    return f"""
#include <shadelab/shading.hpp>
struct Phong {{ vec3 ka, kd, ks; Real q; }};
struct Terms {{ vec3 ambient, diffuse, specular; }};
Terms shade(Phong m, vec3 n, vec3 l, vec3 v) {{
    const Real x = 0.25;
    (void)x;
{body}
}}
using In = const Real* __restrict;
using Out = Real* __restrict;
__attribute__((noinline, flatten)) void kernel(int count, In nx, In ny, In nz, In px, In py, In pz, In vx, In vy, In vz,
                                               Out r, Out g, Out b, const Phong& material, vec3 light, vec3 power) {{
    const Phong m = material;
    for (int i = 0; i < count; ++i) {{ // THE LOOP
        const vec3 d = light - vec3(px[i], py[i], pz[i]);
        const Real d2 = dot(d, d);
        Terms t = shade(m, vec3(nx[i], ny[i], nz[i]), d / std::sqrt(d2), vec3(vx[i], vy[i], vz[i]));
        const vec3 c = t.ambient + (t.diffuse + t.specular) * power / d2;
        r[i] += c.x;
        g[i] += c.y;
        b[i] += c.z;
    }}
}}
"""


@pytest.mark.parametrize("form", STUDENT)
def test_a_batch_loop_vectorises(form: str, tmp_path: Path) -> None:
    source = batch_kernel(STUDENT[form])
    loop = 1 + next(i for i, line in enumerate(source.splitlines()) if "THE LOOP" in line)
    text, assembly = tmp_path / "kernel.cpp", tmp_path / "kernel.s"
    text.write_text(source, encoding="utf-8")
    flags = [*FLAGS["float"], "-march=x86-64-v3", "-fopt-info-vec-optimized", "-S"]
    command = ["g++", *flags, f"-I{INCLUDE}", text, "-o", assembly]
    report = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    assert re.search(rf"kernel\.cpp:{loop}:\d+: optimized: loop vectorized using 32 byte vectors", report), report
    calls = re.findall(r"^\s*(?:call|jmp)\s+([A-Za-z_]\w*)", assembly.read_text(encoding="utf-8"), re.MULTILINE)
    assert calls == []  # neither powf nor a function of ours that was not inlined


# ---- math.hpp ---------------------------------------------------------------------------------------------------

# As its header documents them.
BOUNDS = {
    "exp": 1e-7,
    "exp2": 1e-7,
    "log": 1e-7,
    "expm1": 2e-7,
    "log2": 2.5e-7,
    "log1p": 2.5e-7,
    "pow": 2e-6,
    "pow_far": 2.5e-5,
}

ACCURACY = r"""
#include <shadelab/math.hpp>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
namespace ours = shadelab::math;

// The largest relative error over floats of either sign, `stride` units in the last place apart, |x| in [low, high].
template <typename F, typename G>
void sweep(const char* name, F f, G exact, float low, float high, bool negative, bool positive) {
    constexpr std::uint32_t stride = 1013;
    double worst = 0;
    for (std::uint32_t i = std::bit_cast<std::uint32_t>(low); i <= std::bit_cast<std::uint32_t>(high); i += stride) {
        const float x = std::bit_cast<float>(i);
        for (float argument : {x, -x}) {
            if (argument < 0 ? !negative : !positive) continue;
            const double truth = exact(double(argument));
            if (truth != 0) worst = std::max(worst, std::fabs(f(argument) - truth) / std::fabs(truth));
        }
    }
    std::printf("%s %.9g\n", name, worst);
}

// pow(x, y) for x so that the result runs over [2^low, 2^high].
double sweep_pow(double y, double low, double high) {
    double worst = 0;
    for (int i = 0; i < 100000; ++i) {
        const float x = float(std::exp2((low + (high - low) * (i + 0.5) / 100000) / y));
        const double truth = std::pow(double(x), y);
        worst = std::max(worst, std::fabs(ours::pow(x, float(y)) - truth) / truth);
    }
    return worst;
}

#define SWEEP(NAME, ...) \
    sweep(#NAME, [](float x) { return ours::NAME(x); }, [](double x) { return std::NAME(x); }, __VA_ARGS__)

int main() {
    const float tiny = 1.2e-38f, huge = 3.4e38f;
    SWEEP(exp, tiny, 87.3365f, true, true);
    SWEEP(exp2, tiny, 125.999f, true, true);
    SWEEP(expm1, 1e-37f, 88.7228f, true, true);
    SWEEP(log, tiny, huge, false, true);
    SWEEP(log2, tiny, huge, false, true);
    SWEEP(log1p, tiny, 0.99999994f, true, true);
    SWEEP(log1p, 1.0f, huge, false, true);
    double worst = 0, far = 0;
    for (double y : {0.5, 1.0, 2.0, 5.0, 20.0, 128.0, 1e3, 1e4, 1e5, 1e6}) {
        worst = std::max(worst, sweep_pow(y, std::log2(1e-3), 0));
        far = std::max(far, sweep_pow(y, std::max(-125.9, -125 * y), std::min(127.9, 127 * y)));
    }
    std::printf("pow %.9g\npow_far %.9g\n", worst, far);
}
"""


def test_math_is_as_accurate_as_documented(tmp_path: Path) -> None:
    output = run(build(tmp_path, "accuracy", ACCURACY, FLAGS["double"]))
    errors = [(name, float(value)) for name, value in (line.split() for line in output.splitlines())]
    assert {name for name, _ in errors} == set(BOUNDS)
    assert [(name, value) for name, value in errors if not value <= BOUNDS[name]] == []


SPECIALS = r"""
#include <shadelab/math.hpp>
#include <cmath>
#include <cstdio>
#include <limits>
namespace ours = shadelab::math;
constexpr float inf = std::numeric_limits<float>::infinity(), nan_ = std::numeric_limits<float>::quiet_NaN();
volatile float table[][3] = {  // x, y, pow(x, y)
    {0, 0, 1},       {0, 2, 0},      {0, -1, inf},      {-0.0f, 1, 0},    {inf, 0, 1},        {inf, 0.5f, inf},
    {inf, -1, 0},    {1, 1e30f, 1},  {1, -1e30f, 1},    {1, 0, 1},        {0.5f, inf, 0},     {2, inf, inf},
    {0.5f, -inf, inf}, {2, -inf, 0}, {2, 128, inf},     {2, -127, 0},     {0.5f, 1e6f, 0},    {1.5f, 1e6f, inf},
    {-1, 2, nan_},   {-2, 0.5f, nan_}, {nan_, 0, nan_}, {nan_, 2, nan_},  {2, nan_, nan_},    {-inf, 1, nan_},
    {3e38f, 0, 1},   {1e-45f, 0, 1}, {1e-40f, 0.5f, 0}, {4, 0.5f, 2},     {2, 10, 1024},      {0.5f, 3, 0.125f},
};
volatile float one[][7] = {  // x, exp, exp2, expm1, log, log2, log1p
    {0, 1, 1, 0, -inf, -inf, 0},      {inf, inf, inf, inf, inf, inf, inf}, {-inf, 0, 0, -1, nan_, nan_, nan_},
    {nan_, nan_, nan_, nan_, nan_, nan_, nan_}, {-2000, 0, 0, -1, nan_, nan_, nan_},
};
int failures = 0;
void expect(const char* what, float x, float y, float value, float truth) {
    if (value == truth || (value != value && truth != truth)) return;
    std::printf("%s(%g, %g) is %g, not %g\n", what, x, y, value, truth);
    ++failures;
}
int main() {
    for (auto& r : table) expect("pow", r[0], r[1], ours::pow(r[0], r[1]), r[2]);
    for (auto& r : one) {
        expect("exp", r[0], 0, ours::exp(r[0]), r[1]);
        expect("exp2", r[0], 0, ours::exp2(r[0]), r[2]);
        expect("expm1", r[0], 0, ours::expm1(r[0]), r[3]);
        expect("log", r[0], 0, ours::log(r[0]), r[4]);
        expect("log2", r[0], 0, ours::log2(r[0]), r[5]);
        expect("log1p", r[0], 0, ours::log1p(r[0]), r[6]);
    }
    volatile float over = 88.73f, under = -87.34f, minus_one = -1, below = -1.5f;
    expect("exp", over, 0, ours::exp(over), inf);
    expect("exp", under, 0, ours::exp(under), 0);
    expect("log1p", minus_one, 0, ours::log1p(minus_one), -inf);
    expect("log1p", below, 0, ours::log1p(below), nan_);
    static_assert(ours::pow(1.0f, 123.0f) == 1.0f && ours::exp(0.0f) == 1.0f && ours::log(1.0f) == 0.0f);
}
"""


def test_math_at_special_values(tmp_path: Path) -> None:
    assert run(build(tmp_path, "specials", SPECIALS, FLAGS["float"])) == ""


# Prints a digest of the bits that every function makes of many arguments, in a loop that the compiler may vectorise.
DIGEST = r"""
#include <shadelab/math.hpp>
#include <bit>
#include <cstdint>
#include <cstdio>
#include <initializer_list>
namespace ours = shadelab::math;
constexpr int count = 1 << 16;
float x[count], y[count], out[count];
#define EACH(NAME, VALUE)                                                                                 \
    __attribute__((noinline)) void NAME(int n, const float* __restrict x, const float* __restrict y,      \
                                        float* __restrict out) {                                          \
        for (int i = 0; i < n; ++i) out[i] = VALUE + 0 * y[i];                                            \
    }
EACH(f_exp, ours::exp(x[i]))
EACH(f_exp2, ours::exp2(x[i]))
EACH(f_expm1, ours::expm1(x[i]))
EACH(f_log, ours::log(x[i]))
EACH(f_log2, ours::log2(x[i]))
EACH(f_log1p, ours::log1p(x[i]))
EACH(f_pow, ours::pow(x[i], y[i]))
int main() {
    std::uint32_t state = 1;
    const auto random = [&] { return state = state * 1664525u + 1013904223u, float(state >> 8) / 16777216.0f; };
    for (int i = 0; i < count; ++i) {
        x[i] = i % 2 ? random() : 100 * (random() - 0.5f);
        y[i] = i % 3 ? 100 * random() : 1e6f * random();
    }
    for (auto f : {f_exp, f_exp2, f_expm1, f_log, f_log2, f_log1p, f_pow}) {
        std::uint64_t digest = 14695981039346656037u;
        f(count, x, y, out);
        // a NaN is a NaN: its sign and payload follow the order of operands, which the compiler may choose
        for (float v : out) {
            digest ^= v != v ? 0x7fc00000u : std::bit_cast<std::uint32_t>(v);
            digest *= 1099511628211u;
        }
        std::printf("%016llx\n", static_cast<unsigned long long>(digest));
    }
}
"""


def supported_levels() -> list[str]:
    cpu = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").exists() else ""
    needs = {"x86-64": "", "x86-64-v2": "sse4_2", "x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}
    return [level for level, flag in needs.items() if flag in cpu]


def test_math_is_the_same_on_every_machine(tmp_path: Path) -> None:
    digests = {
        (level, optimise): run(build(tmp_path, "digest", DIGEST, [*FLAGS["float"], optimise, f"-march={level}"]))
        for level in supported_levels()
        for optimise in ("-O1", "-O3")
    }
    assert len(set(digests.values())) == 1, digests


def test_header_holds_what_the_script_makes() -> None:
    pytest.importorskip("mpmath")
    subprocess.run([sys.executable, ROOT / "framework" / "tools" / "fit_math.py", "--check"], check=True)
