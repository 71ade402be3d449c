"""Where to look: parameter sets on each parameter's own scale."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pedjax import parameters
from pedjax.errors import InputError, suggest
from pedjax.evaluation.scores import is_score
from pedjax.sweeping.parquet import read_table

DESIGNS = ("sobol", "latin", "grid", "random")


class Axis(NamedTuple):
    """A swept parameter: its dotted `path`, `unit`, whether its scale is `log`, and the range swept.

    `points` are the only values it takes, where given; `steps` is its number of grid steps, where chosen.
    """

    path: str
    unit: str
    log: bool
    low: float
    high: float
    points: tuple[float, ...] = ()
    steps: int = 0

    def forward(self, values: np.ndarray) -> np.ndarray:
        """Values on the axis' own scale: natural logarithms where it is `log`."""
        values = np.asarray(values, float)
        if self.log and not (values > 0).all():
            raise InputError(f"{self.path} is swept on a log scale but holds {values.min():g} {self.unit}")
        return np.log(values) if self.log else values

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Values at places in [0, 1] along the axis."""
        if self.points:
            place = np.minimum(np.floor(unit * len(self.points)).astype(int), len(self.points) - 1)
            return np.array(self.points)[place]
        low, high = self.forward(np.array([self.low, self.high]))
        inner = low + unit * (high - low)
        return np.clip(np.exp(inner) if self.log else inner, self.low, self.high)

    def zoomed(self, centre: float, shrink: float) -> Axis:
        """The same axis `shrink` times as long around a value, inside its range."""
        if self.points:
            return self
        low, high = self.forward(np.array([self.low, self.high]))
        middle, half = float(self.forward(np.array(centre))), 0.5 * shrink * (high - low)
        ends = np.clip([middle - half, middle + half], low, high)
        first, last = np.clip(np.exp(ends) if self.log else ends, self.low, self.high)
        return self._replace(low=float(first), high=float(last))


@dataclass(frozen=True)
class Design:
    """N parameter sets: `values[path] (N,)` of each number, `settings[path]`, N of each setting."""

    axes: tuple[Axis, ...]
    values: dict[str, np.ndarray]
    settings: dict[str, list[Any]]

    @property
    def count(self) -> int:
        """Parameter sets, N."""
        return len(next(iter(self.values.values())))

    def groups(self) -> list[tuple[dict[str, Any], int, int]]:
        """Stretches of sets with the same settings: `(settings, first, one past the last)`."""
        paths = list(self.settings)
        rows = list(zip(*self.settings.values(), strict=True)) or [()] * self.count
        found, start = [], 0
        for row, members in itertools.groupby(rows):
            stop = start + len(list(members))
            found.append((dict(zip(paths, row, strict=True)), start, stop))
            start = stop
        return found


def axes_of(
    params: Any,
    ranges: Mapping[str, Any],
    values: Mapping[str, Sequence[float]] | None = None,
    origin: str = "sweep",
) -> tuple[Axis, ...]:
    """Axes from `ranges`, path to `[low, high]`, `[low, high, steps]`, a table of `low`, `high`, `steps` and
    `scale` (log or linear), or nothing (the parameter's bounds); and from `values`, path to a list."""
    specs = parameters.specs(params)
    axes = []
    both = sorted(set(ranges) & set(values or {}))
    if both:
        raise InputError(f"{origin}.ranges and {origin}.values both hold '{both[0]}'; keep one")
    for section, given in (("ranges", ranges), ("values", values or {})):
        where = f"{origin}.{section}"
        for path, what in given.items():
            if path not in specs:
                parameters.get(params, path)  # raises with a suggestion where the path is unknown
                raise InputError(f"{where}: '{path}' is a setting; list its values in {origin}.settings")
            spec = specs[path]
            plain = Axis(path, spec.unit, spec.scale == "log", spec.low, spec.high)
            axis = _ranged(plain, what, where) if section == "ranges" else _listed(plain, what, where)
            for end in (axis.low, axis.high):
                parameters.replace(params, {path: end}, where)
            axis.forward(np.array([axis.low, axis.high]))
            axes.append(axis)
    return tuple(axes)


def _ranged(axis: Axis, given: Any, where: str) -> Axis:
    if isinstance(given, Mapping):
        for key in given:
            if key not in ("low", "high", "steps", "scale"):
                known = suggest(key, ("low", "high", "steps", "scale"))
                raise InputError(f"{where}.{axis.path}: key '{key}' is unknown{known}")
        if given.get("scale", "log") not in ("log", "linear"):
            raise InputError(f"{where}.{axis.path}.scale = {given['scale']!r} must be 'log' or 'linear'")
        log = axis.log if "scale" not in given else given["scale"] == "log"
        parts = [given.get("low", axis.low), given.get("high", axis.high), given.get("steps", 0)]
        axis = axis._replace(log=log)
    elif isinstance(given, Sequence) and not isinstance(given, str) and len(given) in (0, 2, 3):
        parts = [*given, *([axis.low, axis.high, 0][len(given) :])]
    else:
        raise InputError(f"{where}.{axis.path} must be [low, high] or [low, high, steps]")
    if not all(isinstance(x, int | float) and not isinstance(x, bool) for x in parts):
        raise InputError(f"{where}.{axis.path} = {given!r} must hold numbers")
    low, high, steps = parts
    if not low <= high:
        raise InputError(f"the range of {axis.path} runs from {low:g} down to {high:g}")
    if not math.isfinite(steps) or steps != int(steps) or steps < 0:
        raise InputError(f"{where}.{axis.path}: {steps!r} steps must be a whole number")
    return axis._replace(low=float(low), high=float(high), steps=int(steps))


def _listed(axis: Axis, given: Any, where: str) -> Axis:
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise InputError(f"{where}.{axis.path} must be a list of numbers")
    if not all(isinstance(x, int | float) and not isinstance(x, bool) for x in given):
        raise InputError(f"{where}.{axis.path} = {given!r} must hold numbers")
    if not all(math.isfinite(x) for x in given):
        raise InputError(f"{where}.{axis.path} = {given!r} must hold finite numbers (nan and inf are none)")
    points = tuple(sorted({float(x) for x in given}))
    return axis._replace(low=points[0], high=points[-1], points=points)


def lay_out(axes: Sequence[Axis], count: int, kind: str = "sobol", seed: int = 0) -> dict[str, np.ndarray]:
    """Values `(N,)` along each axis.

    `grid` has the steps of each axis, and for those that name none the same number of steps, the most that
    `count` allows; `sobol`, `latin` (hypercube) and `random` have exactly `count` sets, scrambled by the
    seed.
    """
    if kind not in DESIGNS:
        raise InputError(f"design '{kind}' is unknown{suggest(kind, DESIGNS)}")
    if count < 1 or not axes:
        raise InputError("a sweep needs at least one parameter and one set")
    from scipy.stats import qmc  # here: it takes a fifth of pedjax's start

    rng = np.random.default_rng(seed)
    if kind == "grid":
        unit = _grid(axes, count)
    elif kind == "sobol":
        power = max(math.ceil(math.log2(count)), 0)
        unit = qmc.Sobol(len(axes), rng=rng).random_base2(power)[:count]
    elif kind == "latin":
        unit = qmc.LatinHypercube(len(axes), rng=rng).random(count)
    else:
        unit = rng.random((count, len(axes)))
    return {axis.path: axis.at(column) for axis, column in zip(axes, unit.T, strict=True)}


def _grid(axes: Sequence[Axis], count: int) -> np.ndarray:
    """Every combination of the axes' steps, as places in [0, 1]."""
    own = [len(axis.points) or axis.steps for axis in axes]
    free = own.count(0)
    share = count / math.prod(n for n in own if n)
    even = max(math.floor(share ** (1 / free) + 1e-9), 1) if free else 0
    sides = []
    for axis, n in zip(axes, own, strict=True):
        steps = n or even
        if axis.points:
            sides.append((np.arange(steps) + 0.5) / steps)
        else:
            sides.append(np.linspace(0.0, 1.0, steps) if steps > 1 else np.array([0.5]))
    return np.stack([a.ravel() for a in np.meshgrid(*sides, indexing="ij")], axis=1)


def design(
    params: Any, ranges: Mapping[str, Any], count: int, kind: str = "sobol", seed: int = 0
) -> dict[str, np.ndarray]:
    """Values `(N,)` of each path of `ranges`: `[low, high]` in the parameter's unit, on its own scale."""
    return lay_out(axes_of(params, ranges), count, kind, seed)


def with_settings(
    axes: Sequence[Axis], values: Mapping[str, np.ndarray], settings: Mapping[str, Sequence[Any]]
) -> Design:
    """The sets once for each combination of settings, which come one after the other: each compiles anew."""
    count = len(next(iter(values.values())))
    combinations = list(itertools.product(*settings.values()))
    repeated = {path: np.tile(np.asarray(v, float), len(combinations)) for path, v in values.items()}
    columns = zip(*combinations, strict=True) if settings else ()
    listed = {
        path: [x for x in column for _ in range(count)]
        for path, column in zip(settings, columns, strict=True)
    }
    return Design(tuple(axes), repeated, listed)


_RESULTS = ("run", "round", "recording", "healthy", "status", "fingerprint")


def listed_sets(path: Path, params: Any) -> dict[str, np.ndarray]:
    """Parameter sets from a csv or Parquet file with one column for each path; columns that a sweep's own
    tables add (`run`, scores in m) are passed over."""
    try:
        if path.suffix == ".parquet":
            table = read_table(path)
            columns = {name: table[name].to_pylist() for name in table.column_names}
        else:
            with path.open(newline="") as file:
                rows = [row for row in csv.reader(file) if row]
            head = rows[0] if rows else []
            if len(set(head)) < len(head) or any(len(row) > len(head) for row in rows[1:]):
                raise InputError(f"{path}: a column has no name of its own, or a row more values than names")
            columns = {n: [row[i] for row in rows[1:]] for i, n in enumerate(head)}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    except IndexError:
        raise InputError(f"{path}: a row has fewer values than the header has names") from None
    specs = parameters.specs(params)
    found = {}
    for name, column in columns.items():
        if name in _RESULTS or name.endswith("_fraction") or is_score(name):
            continue
        if name not in specs:
            parameters.get(params, name)
            raise InputError(f"{path}: column '{name}' is a setting; only numbers can be listed")
        try:
            numbers = np.array([float(x) for x in column])
        except (TypeError, ValueError):
            raise InputError(f"{path}: column '{name}' must hold numbers") from None
        for end in (numbers.min(), numbers.max()) if len(numbers) else ():
            parameters.replace(params, {name: float(end)}, str(path))
        if not np.isfinite(numbers).all():
            raise InputError(f"{path}: column '{name}' holds a number that is not finite")
        found[name] = numbers
    if not found or not len(next(iter(found.values()))):
        raise InputError(f"{path}: holds no parameter set; give a column for each path, one row for each set")
    return found


def axes_around(params: Any, values: Mapping[str, np.ndarray]) -> tuple[Axis, ...]:
    """Axes that span listed sets."""
    specs = parameters.specs(params)
    return tuple(
        Axis(path, specs[path].unit, specs[path].scale == "log", float(v.min()), float(v.max()))
        for path, v in values.items()
    )
