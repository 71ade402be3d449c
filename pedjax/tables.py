"""TOML files, and dataclasses out of their tables, with messages that name the key."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from pedjax.errors import InputError, suggest


def loaded(path: Path, missing: str) -> dict[str, Any]:
    """The TOML file as a dict; where there is none, `missing` says so."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(missing) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and rights") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not valid TOML ({error}); repair that line") from None


def filled(cls: type, given: Mapping[str, Any], where: str, section: str = "") -> Any:
    """A dataclass from a table: each key known and of the kind of its default; lists become tuples. `section`
    precedes the key in messages, as in 'tune.'."""
    known = {f.name: f for f in fields(cls)}
    clean: dict[str, Any] = {}
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{where}: key '{section}{key}' is unknown{suggest(key, known)}")
        default, value = known[key].default, _as_tuples(value)
        if str(known[key].type).startswith("float"):  # perhaps with None for a default
            value = float(value) if type(value) is int else value
            if type(value) is not float:
                raise InputError(f"{where}: {section}{key} = {value!r} must be a number")
        # true is an int to Python
        elif isinstance(default, bool | int | str | tuple) and type(value) is not type(default):
            raise InputError(f"{where}: {section}{key} = {value!r} must be of the kind of {default!r}")
        clean[key] = value
    return cls(**clean)


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value
