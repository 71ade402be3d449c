"""Where a long sweep lives: a folder that is whole after every part, whatever happens in between.

    manifest.json            what is swept, and how its runs are numbered
    design-0.parquet         the parameter sets of each round, one row a run
    table/part-000000.parquet    one row for each run and recording, in order

A part appears in one move, complete or not at all. A sweep that was stopped goes on with the parts that are
missing and ends with the same table.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from pedjax.errors import InputError
from pedjax.output import atomic, folder, plain, write_json
from pedjax.sweeping.designs import Axis, Design
from pedjax.sweeping.parquet import arrow, read_table

FORMAT = 1


class Store(NamedTuple):
    """A sweep's folder and its manifest."""

    path: Path
    manifest: dict[str, Any]

    @property
    def table(self) -> Path:
        """Folder of the parts."""
        return self.path / "table"

    @property
    def identity(self) -> str:
        """Names what is swept: equal for equal sweeps."""
        return str(self.manifest["identity"])


def identity_of(manifest: Mapping[str, Any]) -> str:
    """A short name for all that decides the numbers of a sweep."""
    text = json.dumps(plain(dict(manifest)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def open_store(path: str | Path, manifest: Mapping[str, Any]) -> Store:
    """Make the folder, or go on in it; one that holds another sweep is an `InputError`."""
    arrow()
    place = folder(path)
    wanted = {**plain(dict(manifest)), "identity": identity_of(manifest)}
    target = place / "manifest.json"
    if target.exists():
        found = _manifest(place)
        if found["identity"] != wanted["identity"]:
            changed = _changed(found, wanted)
            raise InputError(
                f"{place}: holds another sweep (different: {', '.join(changed)}); choose another --out, or "
                "delete the folder"
            )
    elif list(place.glob("table/part-*.parquet")):
        raise InputError(f"{place}: holds parts of a sweep but no manifest.json; choose another --out")
    else:
        write_json(target, wanted)
    folder(place / "table")
    return Store(place, wanted)


def _changed(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """What differs between two manifests: their keys, and of recordings that go by the same names what has
    changed in them."""
    keys = sorted(k for k in {*found, *wanted} - {"identity"} if found.get(k) != wanted.get(k))
    pairs = list(zip(found.get("recordings", []), wanted["recordings"], strict=False))
    if "recordings" not in keys or [a["name"] for a, _ in pairs] != [b["name"] for _, b in pairs]:
        return keys
    parts = []
    for old, new in pairs:
        own = [{**entry.get("streams", {}), "what it is scored at": entry["scored"]} for entry in (old, new)]
        differ = [k for k in dict.fromkeys([*own[0], *own[1]]) if own[0].get(k) != own[1].get(k)]
        parts += [f"{new['name']} {k}" for k in differ]
    return [f"recordings, namely {'; '.join(parts)}" if k == "recordings" and parts else k for k in keys]


def tidy(store: Store) -> None:
    """Remove what processes that were killed left behind; only while nobody writes."""
    for leftover in (*store.path.glob(".*.tmp"), *store.table.glob(".*.tmp")):
        leftover.unlink(missing_ok=True)
    for claims in store.path.glob(".claims-*"):
        shutil.rmtree(claims, ignore_errors=True)


@contextmanager
def locked(path: str | Path) -> Iterator[None]:
    """Nobody else may write to the folder meanwhile; the lock ends with the process, however it ends."""
    place = folder(path)
    with open(place / ".lock", "w") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass  # no such locks on this system
        except BlockingIOError:
            raise InputError(
                f"{place}: another sweep is writing there; wait for it, or choose another --out"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield


def design_path(store: Store, number: int) -> Path:
    """File of a round's parameter sets."""
    return store.path / f"design-{number}.parquet"


def write_design(store: Store, number: int, design: Design, first_run: int) -> None:
    """The parameter sets of one round."""
    columns: dict[str, Any] = {"run": np.arange(first_run, first_run + design.count)}
    columns |= {**design.settings, **design.values}
    about = {"axes": [axis._asdict() for axis in design.axes], "settings": list(design.settings)}
    _write(store, design_path(store, number), columns, about)


def read_design(store: Store, number: int) -> Design | None:
    """The parameter sets of one round, None where it has not begun."""
    path = design_path(store, number)
    if not path.exists():
        return None
    table = read_table(path)
    about = json.loads(table.schema.metadata[b"pedjax"])
    axes = tuple(Axis(**{**axis, "points": tuple(axis["points"])}) for axis in about["axes"])
    settings = {name: table[name].to_pylist() for name in about["settings"]}
    rest = [n for n in table.column_names if n != "run" and n not in settings]
    return Design(axes, {name: table[name].to_numpy() for name in rest}, settings)


def part_path(store: Store, number: int) -> Path:
    """File of a part."""
    return store.table / f"part-{number:06d}.parquet"


def write_part(store: Store, number: int, columns: Mapping[str, Any]) -> None:
    """One part, in one move."""
    _write(store, part_path(store, number), columns, {})


def _write(store: Store, path: Path, columns: Mapping[str, Any], about: Mapping[str, Any]) -> None:
    pa = arrow()
    arrays = {}
    for name, values in columns.items():
        made = pa.array(values)
        if pa.types.is_floating(made.type):  # what diverged has no score: null, not a number to be averaged
            made = pa.array(np.asarray(values), from_pandas=True)
        arrays[name] = made.dictionary_encode() if pa.types.is_string(made.type) else made
    metadata = {"sweep": store.identity, "pedjax_version": store.manifest["pedjax_version"], **about}
    table = pa.table(arrays).replace_schema_metadata({"pedjax": json.dumps(metadata)})

    def write(file: IO[bytes]) -> None:
        pa.parquet.write_table(table, file, compression="zstd")

    atomic(path, write)


def is_whole(store: Store, number: int, rows: int) -> bool:
    """Whether a part is there and complete."""
    path = part_path(store, number)
    if not path.exists():
        return False
    pa = arrow()
    try:
        return int(pa.parquet.read_metadata(path).num_rows) == rows
    except (OSError, pa.ArrowInvalid):
        return False


def read_store(path: str | Path) -> tuple[Store, dict[str, np.ndarray]]:
    """The manifest and the whole table so far, as columns; an `InputError` where there is none."""
    place = Path(path)
    store = Store(place, _manifest(place))
    parts = sorted(store.table.glob("part-*.parquet"))
    if not parts:
        raise InputError(f"{place}: the sweep has no finished part yet; run it first")
    pa = arrow()
    try:
        table = pa.concat_tables([read_table(part) for part in parts]).unify_dictionaries()
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(
            f"{place}: a part cannot be read ({error}); delete it and run the sweep again"
        ) from None
    columns = {}
    for name in table.column_names:
        column = table[name].combine_chunks()
        if pa.types.is_dictionary(column.type):
            labels = np.array(column.dictionary.to_pylist(), object)
            columns[name] = labels[column.indices.to_numpy(zero_copy_only=False)]
        else:
            columns[name] = column.to_numpy(zero_copy_only=False)
    return store, columns


def _manifest(place: Path) -> dict[str, Any]:
    try:
        found = json.loads((place / "manifest.json").read_text())
    except FileNotFoundError:
        raise InputError(
            f"{place}: is not a sweep (it has no manifest.json); name the --out of a sweep"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{place}/manifest.json: cannot be read ({error})") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"{place}/manifest.json: is not of a sweep that this version can read")
    return found


def missing(store: Store, parts: Sequence[tuple[int, int]], first: int, recordings: int) -> list[int]:
    """Numbers of the parts of a round, whose first is `first`, that are still to be computed."""
    return [
        n
        for n, (start, stop) in enumerate(parts, first)
        if not is_whole(store, n, (stop - start) * recordings)
    ]
