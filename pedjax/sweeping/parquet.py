"""Parquet, which only sweeps need."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pedjax.errors import InputError


def arrow() -> Any:
    """pyarrow with its Parquet part; an `InputError` that says how to get it where it is missing."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "sweeps are kept as Parquet: install pyarrow with pip install 'pedjax[sweep]'"
        ) from None
    return pyarrow


def read_table(path: Path) -> Any:
    """An arrow table from a Parquet file; an `OSError` where it is none."""
    pa = arrow()
    try:
        return pa.parquet.read_table(path)
    except pa.ArrowInvalid as error:
        raise OSError(str(error)) from None
