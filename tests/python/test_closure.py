"""What expected data is made from is found by reading imports: a module that moves stays in it, and one that is gone is an error."""

import shutil

import pytest

from shadelab.closure import PACKAGE, import_closure
from shadelab.errors import InfrastructureError


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
    found = names(PACKAGE, "shadelab.reference")
    # The last two run in a child that the package starts by name.
    assert {"packet.py", "toml_files.py", "result.py", "sandbox.py", "glclient.py", "glcontext.py"} <= found
    assert not {"cli.py", "bench.py", "report/html.py"} & found, (
        "a change of a report would make all expected data anew"
    )


@pytest.mark.parametrize("old, new", [("tables.py", "moved/inputs.py"), ("glclient.py", "moved/client.py")])
def test_a_module_that_moves_stays_in_it(package, old, new):
    before = names(package, "shadelab.reference")
    move(package, old, new)
    after = names(package, "shadelab.reference")
    assert after == before - {old} | {new, "moved/__init__.py"}


def test_a_module_that_is_gone_is_an_error(package):
    (package / "tables.py").unlink()
    with pytest.raises(InfrastructureError, match="shadelab.tables: there is no such module"):
        import_closure("shadelab.reference", package=package)


def test_a_relative_import_is_an_error(package):
    (package / "tables.py").write_text("from . import paths\n")
    with pytest.raises(InfrastructureError, match="tables.py:1: imports relatively"):
        import_closure("shadelab.reference", package=package)
