"""The TOML that describes a file: loading it, and taking keys out of it with messages that name them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from pedjax.errors import InputError, suggest
from pedjax.readers._file import load

_KINDS: dict[str, type | tuple[type, ...]] = {
    "text": str,
    "a number": (int, float),
    "a whole number": int,
    "true or false": bool,
    "a list": list,
    "a table": dict,
}


@dataclass(frozen=True)
class Table:
    """A TOML table; `where` names file and table in messages, `folder` is the file's folder."""

    where: str
    values: Mapping[str, Any]
    folder: Path

    def only(self, *known: str) -> None:
        """Raise for a key that is not known."""
        for key in self.values:
            if key not in known:
                raise InputError(f"{self.where}: key '{key}' is unknown{suggest(key, known)}")

    def get(self, key: str, kind: str, default: Any = None) -> Any:
        """The value of that key, of the kind in words, or the default."""
        if key not in self.values:
            return default
        value = self.values[key]
        # true is an int to Python
        if not isinstance(value, _KINDS[kind]) or (isinstance(value, bool) and kind != "true or false"):
            raise InputError(f"{self.where}: '{key}' is {value!r} where {kind} is needed")
        return value

    def need(self, key: str, kind: str) -> Any:
        """The value of that key, which must be there."""
        if key not in self.values:
            raise InputError(f"{self.where}: key '{key}' is missing; give {kind}")
        return self.get(key, kind)

    def table(self, key: str) -> Table:
        """The table of that key, empty where it is missing."""
        where = f"{self.where[:-1]}.{key}]" if self.where.endswith("]") else f"{self.where} [{key}]"
        return Table(where, self.get(key, "a table", {}), self.folder)

    def tables(self, key: str) -> list[Table]:
        """The tables of an array of tables."""
        entries: list[Table] = []
        for number, entry in enumerate(self.get(key, "a list", [])):
            if not isinstance(entry, dict):
                raise InputError(f"{self.where}: '{key}' entry {number} is {entry!r} where a table is needed")
            entries.append(Table(f"{self.where} [[{key}]] {number}", entry, self.folder))
        return entries

    def choice(self, key: str, known: Iterable[str], default: str) -> str:
        """The text of that key, one of the known ones."""
        value = str(self.get(key, "text", default))
        if value not in set(known):
            raise InputError(f"{self.where}: {key} = '{value}' is unknown{suggest(value, known)}")
        return value


def settings(path: str | PathLike[str]) -> Table:
    """The TOML file as its top table."""
    file = load(path)
    try:
        return Table(file.name, tomllib.loads(file.data.decode("utf-8")), file.path.parent)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{file.name}: it is not valid TOML ({error}); correct it there") from error


def sidecar(path: Path) -> Path | None:
    """The description beside a data file: its whole name and `.toml`; `.gz` may be left out."""
    names = [path.name + ".toml", path.name.removesuffix(".gz") + ".toml"]
    return next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)
