"""TOML files that people write: a mistake in one becomes one line that names the file and the key."""

import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from shadelab.errors import UserError
from shadelab.paths import shown

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class Declared(BaseModel):
    """A table of such a file: keys that nobody knows are errors."""

    model_config = ConfigDict(extra="forbid")


def read_toml(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text())
    except FileNotFoundError:
        raise UserError(f"{shown(file)}: cannot be read; does the file exist?") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{shown(file)}: not valid TOML: {error}") from None


def validated(model: type[BaseModel], file: Path) -> Any:
    """The file as `model`. A mistake becomes one line that names the file and the key."""
    try:
        return model.model_validate(read_toml(file))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise UserError(f"{shown(file)}: {where}: {first['msg'].lower()}") from None
