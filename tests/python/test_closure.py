"""What expected data is made from is found by reading imports: a module that moves stays in it, and one that is gone is an
error."""

import ast
import gc
import shutil
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from shadelab.errors import InfrastructureError
from shadelab.paths import PACKAGE
from shadelab.sources import syntax_of
from shadelab.truth.closure import import_closure
from shadelab.truth.digest import MAKER


@pytest.fixture
def package(tmp_path):
    """A copy of our package."""
    return shutil.copytree(PACKAGE, tmp_path / "shadelab", ignore=shutil.ignore_patterns("__pycache__"))


def names(package, *roots):
    return {str(file.relative_to(package)) for file in import_closure(*roots, package=package)}


def move(package, old, new):
    """Moves a module and mends whatever names it, as an editor would."""
    (package / new).parent.mkdir(exist_ok=True)
    (package / new).parent.joinpath("__init__.py").touch()
    (package / old).rename(package / new)
    dotted = [f"shadelab.{path.removesuffix('.py').replace('/', '.')}" for path in (old, new)]
    for file in package.rglob("*.py"):
        file.write_text(file.read_text().replace(*dotted))


def test_all_that_the_numbers_rest_on_is_there():
    found = names(PACKAGE, "shadelab.truth.making")
    # The last two run in a child that the package starts by name.
    assert {
        "gl/packet.py",
        "course/toml_files.py",
        "result.py",
        "machine/sandbox.py",
        "gl/client.py",
        "gl/context.py",
    } <= found
    assert not {"cli/app.py", "measure/bench.py", "report/html/page.py"} & found, (
        "a change of a report would make all expected data anew"
    )


@pytest.mark.parametrize("old, new", [("truth/tables.py", "moved/inputs.py"), ("gl/client.py", "moved/client.py")])
def test_a_module_that_moves_stays_in_it(package, old, new):
    before = names(package, "shadelab.truth.making")
    move(package, old, new)
    after = names(package, "shadelab.truth.making")
    assert after == before - {old} | {new, "moved/__init__.py"}


def test_a_module_that_is_gone_is_an_error(package):
    (package / "truth" / "tables.py").unlink()
    with pytest.raises(InfrastructureError, match="shadelab.truth.tables: there is no such module"):
        import_closure("shadelab.truth.making", package=package)


def test_a_relative_import_is_an_error(package):
    (package / "truth" / "tables.py").write_text("from . import paths\n")
    with pytest.raises(InfrastructureError, match="tables.py:1: imports relatively"):
        import_closure("shadelab.truth.making", package=package)


def test_several_gradings_of_one_process_read_sources_at_once():
    """Python 3.11.2 raises a SystemError when two threads make syntax trees at the same time."""
    usual, thresholds = sys.getswitchinterval(), gc.get_threshold()
    files = import_closure(MAKER)[:6]

    def other_threads_turn(*_) -> None:
        """In the middle of a tree, where the collector runs Python code."""
        time.sleep(0)

    gc.callbacks.append(other_threads_turn)
    gc.set_threshold(200)
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda _: [ast.dump(syntax_of(file)) for file in files], range(24)))
    finally:
        sys.setswitchinterval(usual)
        gc.set_threshold(*thresholds)
        gc.callbacks.remove(other_threads_turn)
    assert all(trees == found[0] for trees in found)
