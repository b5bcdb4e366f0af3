"""doctor, editor, test: the machine and the house itself."""

import os
import subprocess
import sys
from typing import Annotated, Optional

import typer

from shadelab.cli.options import AssignmentName, Submission, console, progress_bar
from shadelab.paths import ROOT, shown


def register(app: typer.Typer) -> None:
    app.command()(doctor)
    app.command()(editor)
    if (ROOT / "tests").is_dir():  # a release has none
        app.command()(test)


def doctor() -> None:
    """Say what this machine can do, and how to mend what it can't."""
    from shadelab.inspect.doctor import examine

    output = console()
    findings = examine()
    for finding in findings:
        mark = {"ok": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[red]bad [/]"}[finding.state]
        output.print(f"{mark}  {finding.what}: ", end="")
        output.print(finding.says, markup=False, soft_wrap=True)
        if finding.mend:
            output.print(f"      {finding.mend}", markup=False, soft_wrap=True)
    if any(f.state == "bad" for f in findings):
        raise typer.Exit(3)


def editor(directory: Submission, assignment: AssignmentName = None) -> None:
    """Let an editor check shading.cpp and shading.glsl in DIR while you write.

    Writes DIR/compile_commands.json (clangd, and VS Code's C++) and DIR/.vscode: open DIR in the editor. Where glslangValidator
    is installed, VS Code's GLSL Lint extension and the task "Check shading.glsl" show its messages; DIR/.vscode/glslang prints
    them in a terminal. Run it again after an update of Shadelab.
    """
    from shadelab.course.assignment import find_assignment
    from shadelab.inspect.editor import write_editor_files

    written = write_editor_files(find_assignment(directory, assignment), directory)
    for file in written.files:
        print(f"wrote {shown(file)}")
    for note in written.notes:
        print(f"note: {note}")


def test(
    slow: Annotated[bool, typer.Option("--slow", help="also the tests marked slow and oracle")] = False,
    select: Annotated[
        Optional[str], typer.Option("-k", metavar="WORDS", help="only Python tests whose name matches")
    ] = None,
) -> None:
    """Run all tests: C++ (ctest) and Python (pytest). The output ends with pytest's summary."""
    environment = {**os.environ, "SHADELAB_ROOT": str(ROOT)}
    # Only those who run the tests compile them; set-up builds the renderer alone.
    with progress_bar() as progress:
        progress("building the C++ tests", 0, 1)
        build = subprocess.run(["ninja", "-C", str(ROOT / "build"), "--quiet"], capture_output=True, text=True)
    if build.returncode:
        print(build.stdout[-4000:], build.stderr[-1000:], "the C++ tests do not compile", sep="\n", file=sys.stderr)
        raise typer.Exit(1)
    cpp = subprocess.run(
        ["ctest", "--test-dir", str(ROOT / "build"), "--output-on-failure", "--no-tests=error", "-j2"], env=environment
    ).returncode
    # -I: a submission's numpy.py in the working folder must never be imported by us. -u: each dot is seen when it is printed.
    command = [sys.executable, "-u", "-I", "-m", "pytest", "-q", "--rootdir", str(ROOT), str(ROOT / "tests" / "python")]
    # A file's tests stay together: they share what their fixtures have graded.
    command += ["-n", str(os.cpu_count() or 1), "--dist", "loadfile"]
    command += [] if slow else ["-m", "not slow and not oracle"]
    command += ["-k", select] if select else []
    python = subprocess.run(command, cwd=ROOT, env=environment).returncode
    if cpp:
        print("the C++ tests failed (above)", file=sys.stderr)
    if cpp or python:
        raise typer.Exit(1)
