"""Results on disk: every file is written whole or not at all."""

from __future__ import annotations

import csv
import errno
import io
import json
import math
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import tomli_w

from pedjax.errors import InputError


def folder(path: str | Path) -> Path:
    """Make the output folder, or say why it cannot be."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another --out") from None
    return path


def atomic(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write beside the target and move into place, so that a reader never sees half a file."""
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o666 & ~_umask())  # mkstemp lets only the owner read
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        remedy = "; free some space and repeat the command" if error.errno == errno.ENOSPC else ""
        raise InputError(f"{path}: cannot be written ({error.strerror}){remedy}") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def plain(value: Any) -> Any:
    """Arrays and numpy scalars as lists and numbers; what is not finite as None (JSON has no NaN)."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def write_json(path: Path, value: Any) -> None:
    """JSON, indented, in the given order."""
    text = json.dumps(plain(value), indent=2, allow_nan=False) + "\n"
    atomic(path, lambda f: f.write(text.encode()))


def write_toml(path: Path, value: dict[str, Any], heading: str = "") -> None:
    """TOML with a comment on top."""
    text = "".join(f"# {line}\n" for line in heading.splitlines()) + tomli_w.dumps(value)
    atomic(path, lambda f: f.write(text.encode()))


def write_table(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """CSV with a header row; numbers to nine digits, text with a comma or a quote in it quoted."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([f"{x:.9g}" if isinstance(x, float | np.floating) else str(x) for x in row])
    atomic(path, lambda f: f.write(text.getvalue().encode()))


def write_figure(path: Path, figure: Any) -> None:
    """PNG of a matplotlib figure."""
    atomic(path, lambda f: figure.savefig(f, format="png", dpi=130))
