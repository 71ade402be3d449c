"""Rows of numbers in a text file, read fast; a bad cell is named by line and column."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pedjax.errors import InputError, suggest


def cells(line: str, delimiter: str | None) -> list[str]:
    """The stripped cells of a line; `delimiter` None means any white space."""
    return [cell.strip() for cell in line.split(delimiter)]


def numbers(
    where: str,
    rows: Sequence[str],
    line: int,
    names: Sequence[str],
    use: Sequence[int],
    *,
    delimiter: str | None = ",",
    empty_as_nan: bool = False,
) -> np.ndarray:
    """Columns `use` of the rows as float64 `(N, len(use))`.

    `line` is the file's line number (from 1) of the first row, `names` the names of all columns. An empty
    cell is NaN where `empty_as_nan`, otherwise an error like every other cell that is no number.
    """
    if not any(row.strip() for row in rows):
        raise InputError(f"{where}: below the header there are no rows of numbers; the file is cut off")
    width = len(names)
    even = all(len(row.split(delimiter)) == width for row in rows if row.strip())
    if even:
        try:
            return np.loadtxt(rows, delimiter=delimiter, usecols=use, ndmin=2, comments=None)
        except ValueError:
            pass  # the slow way finds the cell, or fills the empty ones
    values = []
    for number, row in enumerate(rows, start=line):
        if row.strip():
            values.append(_row(f"{where}: line {number}", row, names, use, delimiter, empty_as_nan))
    return np.array(values)


def _row(
    where: str,
    row: str,
    names: Sequence[str],
    use: Sequence[int],
    delimiter: str | None,
    empty_as_nan: bool,
) -> list[float]:
    found = cells(row, delimiter)
    if len(found) != len(names):
        raise InputError(
            f"{where} has {len(found)} columns where the header has {len(names)}; "
            "delete or repair that row (a last row may be cut off)"
        )
    values = []
    for index in use:
        if empty_as_nan and not found[index]:
            values.append(np.nan)
            continue
        try:
            values.append(float(found[index]))
        except ValueError:
            what = f"holds '{found[index][:40]}'" if found[index] else "is empty"
            raise InputError(
                f"{where}, column '{names[index]}' {what} where a number is needed; repair that cell or "
                "delete the row"
            ) from None
    return values


def column(where: str, names: Sequence[str], name: str) -> int:
    """The index of a column by its name."""
    if name in names:
        return list(names).index(name)
    raise InputError(f"{where}: there is no column '{name}'{suggest(name, names)}")
