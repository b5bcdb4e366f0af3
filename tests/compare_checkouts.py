"""Two checkouts beside each other: what a change shall leave alone, has it?

    .shadelab/venv/bin/python tests/compare_checkouts.py OLD NEW [--only GROUP]... [--out DIR]

OLD and NEW are checkouts that have been set up (a git clone of an earlier commit, and one './shadelab doctor' in it). Every
command runs in both at once, from each checkout's own folder and as a user types it. Compared are exit code, stdout, stderr
and every file written: arrays and pictures bit by bit, JSON value by value, reports with their embedded pictures. Left out
are measured times, the digests that name versions of code, and where a checkout lies. What differs is kept in DIR/CASE/old
and DIR/CASE/new.

Exits with 1 when anything differs. All groups take about an hour on two cores.
"""

import argparse
import io
import json
import os
import re
import shutil
import subprocess
import sys
import zlib
from base64 import b64decode
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadelab.course.toml_files import read_toml

ASSIGNMENTS = ("lights", "phong", "microfacet")
SCENE_FOLDERS = (*ASSIGNMENTS, "stress")
SIDES = ("old", "new")
# The command's own folder, below each checkout's out/: relative, as the default of --out is.
WRITTEN = "out/compare"

RENDERINGS = {
    "float": [],
    "double-layers": ["--double", "--layers"],
    "full-layers": ["--full", "--layers"],
    "four-samples": ["--samples", "4"],
    "supersampled": ["--supersample", "2", "--size", "160x120"],
    "glsl-layers": ["--backend", "glsl", "--layers"],
    "glsl-four-samples": ["--backend", "glsl", "--samples", "4"],
    "glsl-full": ["--backend", "glsl", "--full"],
}


@dataclass(frozen=True)
class Case:
    name: str
    arguments: tuple[str, ...]  # of ./shadelab; {out} is WRITTEN/NAME
    expected: str = ""  # instead of a command: the expected data of this assignment


# --- what is asked ---


def images(new: Path, work: Path) -> Iterator[Case]:
    for scene in scenes(new):
        for name, options in RENDERINGS.items():
            yield Case(
                f"image-{scene.parent.name}-{scene.stem}-{name}",
                ("render", str(scene), *options, "-o", "{out}/image.npy"),
            )
    yield Case("image-png", ("render", "scenes/phong/teapot.toml", "--exposure", "0.5", "-o", "{out}/image.png"))
    yield Case("image-exr", ("render", "scenes/phong/teapot.toml", "-o", "{out}/image.exr"))
    for name in ASSIGNMENTS:
        scene = next(s for s in scenes(new) if s.parent.name == name)
        for backend in ("cpp", "glsl"):
            shading = ("--shading", f"starter/{name}", "--backend", backend)
            yield Case(f"image-starter-{name}-{backend}", ("render", str(scene), *shading, "-o", "{out}/image.npy"))


def explanations(new: Path, work: Path) -> Iterator[Case]:
    for scene in scenes(new):
        yield Case(
            f"explain-{scene.parent.name}-{scene.stem}", ("render", str(scene), "--explain", "-o", "{out}/image.npy")
        )


def probes(new: Path, work: Path) -> Iterator[Case]:
    for scene in scenes(new):
        for pixel in ("200,200", "3,5"):
            name = f"probe-{scene.parent.name}-{scene.stem}-{pixel.replace(',', '-')}"
            yield Case(name, ("probe", str(scene), pixel, "--json", "{out}/probe.json"))


def expected(new: Path, work: Path) -> Iterator[Case]:
    for name in ASSIGNMENTS:
        yield Case(f"expected-{name}", ("reference", name), name)


def grades(new: Path, work: Path) -> Iterator[Case]:
    formats = [word for name in ("gradescope", "classroom50", "junit", "markdown") for word in ("--format", name)]
    for name in ASSIGNMENTS:
        yield Case(f"grade-default-{name}", ("grade", f"starter/{name}", "--fail-under", "60"))
        for folder in (f"solution/{name}", f"starter/{name}"):
            case = f"grade-{folder.replace('/', '-')}"
            yield Case(case, ("grade", folder, "--out", "{out}", "--json", "-", "--hidden-details", *formats))
    for folder in broken_submissions(new, work / "submissions"):
        command = ("grade", str(folder), "--assignment", "phong", "--out", "{out}", *formats)
        yield Case(f"grade-broken-{folder.name}", command)


def proofs(new: Path, work: Path) -> Iterator[Case]:
    for name in ASSIGNMENTS:
        yield Case(f"check-{name}", ("check", name))
    yield Case("starter-verify", ("starter", "--verify"))


def inspections(new: Path, work: Path) -> Iterator[Case]:
    for name in ASSIGNMENTS:
        for folder in (f"solution/{name}", f"starter/{name}"):
            case = f"stability-{folder.replace('/', '-')}"
            yield Case(case, ("stability", folder, "--out", "{out}", "--json", "{out}/stability.json"))
        for function, file in inputs_of_functions(new / "solution" / name, work / "inputs"):
            for how, options in {"float": [], "double": ["--double"], "glsl": ["--backend", "glsl"]}.items():
                command = ("eval", f"solution/{name}", function, "--inputs", str(file), *options, "-o", "{out}/out.npz")
                yield Case(f"eval-{name}-{function}-{how}", command)


def errors(new: Path, work: Path) -> Iterator[Case]:
    for file in broken_scenes(new, work / "scenes"):
        yield Case(
            f"error-scene-{file.stem}", ("render", str(file), "--shading", "solution/phong", "-o", "{out}/image.npy")
        )
        yield Case(f"error-probe-{file.stem}", ("probe", str(file), "3,3", "--shading", "solution/phong"))
    teapot = "scenes/phong/teapot.toml"
    commands = {
        "no-scene": ("render", "scenes/none.toml"),
        "no-folder": ("grade", "nowhere"),
        "no-assignment": ("grade", "docs"),
        "unknown-assignment": ("grade", "starter/phong", "--assignment", "none"),
        "only-nothing": ("grade", "starter/phong", "--only", "none/*"),
        "format": ("grade", "starter/phong", "--format", "none"),
        "samples": ("render", teapot, "--samples", "3"),
        "glsl-samples": ("render", teapot, "--samples", "16", "--backend", "glsl"),
        "glsl-double": ("render", teapot, "--double", "--backend", "glsl"),
        "size": ("render", teapot, "--size", "0x4"),
        "size-word": ("render", teapot, "--size", "large"),
        "image-format": ("render", teapot, "-o", "{out}/image.gif"),
        "shading": ("render", teapot, "--shading", "docs"),
        "pixel": ("probe", teapot, "9999,1"),
        "pixel-word": ("probe", teapot, "here"),
        "eval-function": ("eval", "solution/phong", "none", "--inputs", "none.npz"),
        "eval-inputs": ("eval", "solution/phong", "phong_lobe", "--inputs", "none.npz"),
        "study": ("study", "none"),
        "reference": ("reference", "none"),
        "check": ("check", "none"),
        "release": ("release", "none", "--out", "{out}"),
        "new": ("new", "Not-A-Name"),
        "option": ("render", teapot, "--none"),
        "command": ("none",),
    }
    for name, command in commands.items():
        yield Case(f"error-{name}", command)


GROUPS = {f.__name__: f for f in (errors, expected, grades, inspections, images, probes, explanations, proofs)}


def scenes(new: Path) -> list[Path]:
    return [
        file.relative_to(new) for folder in SCENE_FOLDERS for file in sorted((new / "scenes" / folder).glob("*.toml"))
    ]


def inputs_of_functions(solution: Path, folder: Path) -> Iterator[tuple[str, Path]]:
    """100 rows for each declared function: directions, colours and numbers by the names of the types."""
    random = np.random.default_rng(1)
    declared = read_toml(solution / "assignment.toml")
    structs = {s["name"]: s["members"] for s in declared.get("struct", [])}
    folder.mkdir(parents=True, exist_ok=True)

    def columns(name: str, domain: object) -> Iterator[tuple[str, np.ndarray]]:
        if isinstance(domain, str) and domain in structs:
            for member in structs[domain]:
                [(inner, its_domain)] = member.items()
                yield from columns(f"{name}.{inner}", its_domain)
        elif isinstance(domain, str) and (domain == "unit" or domain.startswith("upper")):
            vectors = random.normal(size=(100, 3))
            yield name, vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        elif domain in ("position", "rgb"):
            yield name, random.uniform(0, 1, (100, 3))
        elif domain in ("Light", "Incident"):
            return
        else:
            yield name, random.uniform(0, 1, 100)

    for function in declared["function"]:
        arguments = [item for argument in function["arguments"] for item in argument.items()]
        if not any(domain in ("Light", "Incident") for _, domain in arguments if isinstance(domain, str)):
            file = folder / f"{solution.name}-{function['name']}.npz"
            np.savez(file, **{k: v for name, domain in arguments for k, v in columns(name, domain)})
            yield function["name"], file


def broken_submissions(new: Path, folder: Path) -> Iterator[Path]:
    cpp, glsl = ((new / "solution/phong" / f"shading.{end}").read_text() for end in ("cpp", "glsl"))
    head = "vec3 half_vector(vec3 l, vec3 v) {"
    assert head in cpp and head in glsl
    wrong = {
        "does-not-compile": (f"{head} this is no code;", f"{head} this is no code;"),
        "never-ends": (f"{head} for (volatile int k = 0;; k = k) {{}}", f"{head} for (int k = 0; k < 2; k += 0) {{}}"),
        "crashes": (f"{head} *(volatile int*)0 = 1;", head),
        "leaves": ("#include <cstdlib>\n" + f"{head} std::exit(0);", head),
        "not-finite": (
            f"{head} if (l.x > 0) return vec3(0.0 / (l.x - l.x));",
            f"{head} if (l.x > 0.0) return vec3(l.y / (l.x - l.x));",
        ),
        "prints": (f'#include <cstdio>\n{head} static int k; if (k++ < 3) std::printf("[red]<b>{{}}\\n");', head),
        "wrong": (f"{head} return l + v;", f"{head} return l + v;"),
    }
    for name, codes in wrong.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        for source, end, code in zip((cpp, glsl), ("cpp", "glsl"), codes):
            # What must stand before the function stands at the top, after the framework's own header.
            include, _, body = code.rpartition("\n")
            text = source.replace(head, body, 1)
            (folder / name / f"shading.{end}").write_text(f"{include}\n{text}" if include else text)
        yield folder / name
    for name, files in {
        "one-file": {"shading.cpp": cpp},
        "empty": {},
        "no-text": {"shading.cpp": "\0\0", "shading.glsl": ""},
    }.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (folder / name / file).write_text(text)
        yield folder / name


def broken_scenes(new: Path, folder: Path) -> Iterator[Path]:
    good = (new / "scenes/phong/teapot.toml").read_text().replace("../meshes/", "")
    changes = {
        "unknown-key": ("fov_y = 40", "fov_x = 40"),
        "range": ("fov_y = 40", "fov_y = 400"),
        "type": ("width = 512", 'width = "wide"'),
        "not-toml": ("[camera]", "[camera"),
        "kind": ('kind = "point"', 'kind = "laser"'),
        "vector": ("eye = [0.4, 1.6, 3.4]", "eye = [0.4, 1.6]"),
        "not-finite": ("q = 60", "q = nan"),
        "member": ("q = 60", "gloss = 60"),
        "missing-member": ("q = 60", ""),
        "model": ('model = "phong"', 'model = "none"'),
        "material": ('material = "glaze"', 'material = "clay"'),
        "mesh": ("teapot.obj", "none.obj"),
        "near": ("near = 0.1", "near = 200"),
        "target": ("target = [0.1, 0.45, 0]", "target = [0.4, 1.6, 3.4]"),
        "huge": ("width = 512", "width = 100000"),
        "no-light-kind": ('kind = "point"\n', ""),
        "not-utf8": ("glaze", "\udcff"),
    }
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(new / "scenes/meshes/teapot.obj", folder)
    for name, (old, changed) in changes.items():
        assert old in good, old
        (folder / f"{name}.toml").write_bytes(good.replace(old, changed).encode(errors="surrogateescape"))
        yield folder / f"{name}.toml"


# --- what came ---


def run(case: Case, checkout: Path) -> dict[str, object]:
    """By name, what is compared: exit code, words, and the files that were written."""
    out = checkout / WRITTEN / case.name
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    arguments = [word.replace("{out}", f"{WRITTEN}/{case.name}") for word in case.arguments]
    default = checkout / "out" / case.arguments[1].split("/")[-1] if case.name.startswith("grade-default") else None
    if default:
        shutil.rmtree(default, ignore_errors=True)
    done = subprocess.run(
        ["./shadelab", *arguments], cwd=checkout, stdin=subprocess.DEVNULL, capture_output=True,
        env={**os.environ, "COLUMNS": "120"},
    )  # fmt: skip
    found: dict[str, object] = {"exit code": done.returncode}
    for name, text in {"stdout": done.stdout, "stderr": done.stderr}.items():
        text = text.decode(errors="replace")
        found[name] = timeless(json.loads(text), checkout) if text.startswith("{") else words(text, checkout)
    folder = default or out
    if case.expected:
        entries = (checkout / ".shadelab/expected" / case.expected).glob("*/")
        folder = max(entries, key=lambda entry: entry.stat().st_mtime)
    for file in sorted(f for f in folder.rglob("*") if f.is_file()):
        name = str(file.relative_to(folder))
        # The pictures that a grade keeps are hundreds of MiB; report.html shows what they hold.
        if not name.startswith("evidence/"):
            found.update(contents(name, file, checkout))
    return found


def contents(name: str, file: Path, checkout: Path) -> dict[str, object]:
    if file.suffix == ".npy":
        return {name: array(np.load(file))}
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            return {f"{name}:{key}": array(arrays[key]) for key in arrays.files}
    if file.suffix == ".json":
        return {name: timeless(json.loads(file.read_text()), checkout)}
    if file.suffix == ".html":
        return dict(page(name, file.read_text(), checkout))
    if file.suffix in (".png", ".exr", ".packet"):
        return {name: file.read_bytes()}
    return {name: words(file.read_text(errors="replace"), checkout)}


def array(values: np.ndarray) -> tuple:
    return values.dtype.str, values.shape, values.tobytes()


def words(text: str, checkout: Path) -> str:
    """Without what differs from one run to the next: times and shares of time, digests, folders."""
    text = text.replace(str(checkout), "CHECKOUT")
    text = re.sub(r"(?m)^.* \(\d+ of \d+\)\n", "", text)  # progress, which stands there when a command takes long
    text = re.sub(r"\b[0-9a-f]{12,64}\b", "DIGEST", text)
    text = re.sub(r"'sha256-[A-Za-z0-9+/=]+'", "DIGEST", text)  # of a report's script, comments included
    text = re.sub(r"\b[0-9][0-9.]*(e-?[0-9]+)?\s?(ns|us|µs|ms|s|seconds|%)(?![\w])", r"TIME", text)
    text = re.sub(r"(saves|costs) (-?[0-9.]+ of|nothing that shows in)", r"\1 PART of", text)
    text = re.sub(r"<td>[^<]*\([^<]+ to [^<]+\)</td>", "<td>TIME</td>", text)
    text = re.sub(r'(time|seconds|timestamp)="[^"]*"', r'\1=""', text)
    return re.sub(r"[ \t]+(?=\n)|[\u2500-\u257f]", "", re.sub(r"[ \t]+", " ", text))


def timeless(value: object, checkout: Path) -> object:
    times = (
        "seconds",
        "least",
        "most",
        "median",
        "min",
        "max",
        "execution_time",
        "duration",
        "version",
        "expected",
        "sandbox",
        "digest",
        "spread",
    )
    if isinstance(value, dict):
        kept = (k for k, v in value.items() if k not in times or not isinstance(v, (int, float, str)))
        return {k: timeless(value[k], checkout) for k in kept}
    if isinstance(value, list):
        return [timeless(v, checkout) for v in value]
    return words(value, checkout) if isinstance(value, str) else value


def page(name: str, text: str, checkout: Path) -> Iterator[tuple[str, object]]:
    """A report's words, and each picture and array that it carries; not the plots of time."""
    for k, (kind, data) in enumerate(re.findall(r"data:([\w/+-]+);base64,([A-Za-z0-9+/=]+)", text)):
        yield f"{name}:picture {k}", (kind, unpacked(b64decode(data)))
    text = re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
    text = re.sub(r'<figure class="plot.*?</figure>', "", text, flags=re.DOTALL)
    text = re.sub(r"<style.*?</style>|<script.*?</script>|<svg.*?</svg>", "", text, flags=re.DOTALL)
    yield name, words(text, checkout)


def unpacked(data: bytes) -> bytes:
    if data.startswith(b"\x93NUMPY"):
        return np.load(io.BytesIO(data)).tobytes()
    try:
        return zlib.decompress(data)
    except zlib.error:
        return data


# --- the comparison ---


def compare(case: Case, checkouts: dict[str, Path], work: Path) -> list[str]:
    """What differs, by name."""
    with ThreadPoolExecutor(len(SIDES)) as pool:
        futures = {side: pool.submit(run, case, checkouts[side]) for side in SIDES}
        found = {side: future.result() for side, future in futures.items()}
    names = sorted({*found["old"], *found["new"]})
    missing = object()
    differing = [n for n in names if found["old"].get(n, missing) != found["new"].get(n, missing)]
    shutil.rmtree(work / case.name, ignore_errors=True)
    for side in SIDES if differing else ():
        (work / case.name).mkdir(parents=True, exist_ok=True)
        file = work / case.name / side
        lines = (f"=== {name}\n{shown(found[side].get(name, 'MISSING'))}\n" for name in differing)
        file.write_text("".join(lines))
    for side in SIDES:
        shutil.rmtree(checkouts[side] / WRITTEN / case.name, ignore_errors=True)
    return differing


def shown(value: object) -> str:
    if isinstance(value, tuple) and isinstance(value[-1], bytes):
        return f"{value[:-1]}, {len(value[-1])} bytes with CRC {zlib.crc32(value[-1]):08x}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes with CRC {zlib.crc32(value):08x}"
    return value if isinstance(value, str) else json.dumps(value, indent=1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument(
        "--only", action="append", choices=GROUPS, help="a group of cases; may be repeated (default: all)"
    )
    parser.add_argument("--match", default="", metavar="WORD", help="only cases whose name holds this")
    parser.add_argument("--out", type=Path, default=Path("out/compare-checkouts"), help="where differences are kept")
    given = parser.parse_args()
    checkouts = {side: getattr(given, side).resolve() for side in SIDES}
    for checkout in checkouts.values():
        if not (checkout / "build/.stamp").exists():
            parser.error(f"{checkout}: is no checkout that has been set up; run ./shadelab doctor there")
    work = given.out.resolve()
    work.mkdir(parents=True, exist_ok=True)
    cases = [
        case
        for group in given.only or GROUPS
        for case in GROUPS[group](checkouts["new"], work)
        if given.match in case.name
    ]
    different = 0
    for k, case in enumerate(cases, 1):
        differing = compare(case, checkouts, work)
        different += bool(differing)
        print(
            f"{k}/{len(cases)} {case.name}: {'DIFFERENT: ' + ', '.join(differing) if differing else 'equal'}",
            flush=True,
        )
    print(f"{len(cases) - different} of {len(cases)} equal" + (f"; what differs is in {work}" if different else ""))
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
