"""Calibrations on disk, in readable TOML."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np

from pedjax.calibration.fitting import Fit
from pedjax.calibration.magnetometer import AXES, Calibration, uncalibrated
from pedjax.errors import InputError, suggest
from pedjax.output import plain, write_toml
from pedjax.tables import loaded

_SHAPES = {"hard_iron": (3,), "matrix": (3, 3), "level_offset": (2,), "level_matrix": (2, 2)}
_AHEAD = "level_ahead"
_TOLD = ("method", "reason", "source", "sensor", "recorded", "field_ut", "warnings", "diagnostics")

_HEADING = """magnetometer calibration, in microtesla
body axes: m = matrix (raw - hard_iron)
levelled:  m = level_matrix (m - level_offset), of the horizontal field in stance; its x is the level
           direction of the body axis level_ahead"""


def write(
    path: str | PathLike[str], fit: Fit, source: str, sensor: str = "", recorded: str | None = None
) -> None:
    """Write a fit. `source` names the data's file, `recorded` its day; nothing of the run is in it, so that
    the same data give the same bytes."""
    told: dict[str, Any] = {
        name: np.asarray(getattr(fit.calibration, name), float).tolist() for name in _SHAPES
    }
    told |= {_AHEAD: AXES[fit.calibration.level_ahead]}
    told |= {"field_ut": fit.strength, "method": fit.method, "reason": fit.reason, "source": source}
    told |= {key: value for key, value in (("sensor", sensor), ("recorded", recorded)) if value}
    if fit.warnings:
        told["warnings"] = list(fit.warnings)
    told["diagnostics"] = {k: v for k, v in plain(fit.diagnostics).items() if v is not None}
    write_toml(Path(path), told, _HEADING)


def read(path: str | PathLike[str]) -> Calibration:
    """The calibration of such a file; a part that it leaves out is the identity."""
    path = Path(path)
    raw = loaded(path, f"{path}: there is no such calibration file; make one with pedjax calibrate")
    for key in raw:
        if key not in (*_SHAPES, _AHEAD, *_TOLD):
            raise InputError(f"{path}: key '{key}' is unknown{suggest(key, (*_SHAPES, _AHEAD, *_TOLD))}")
    if not set(raw) & set(_SHAPES):
        raise InputError(
            f"{path}: it holds no calibration; hard_iron and matrix are needed, or the level ones"
        )
    start = uncalibrated()._asdict()
    values = {n: _array(path, n, raw[n]) if n in raw else np.asarray(start[n], float) for n in _SHAPES}
    ahead = raw.get(_AHEAD, "x")
    if ahead not in tuple(AXES):
        raise InputError(f"{path}: {_AHEAD} must be x, y or z, a body axis; it is {ahead!r}")
    return Calibration(**cast(Any, values), level_ahead=AXES.index(ahead))


def _array(path: Path, name: str, value: Any) -> np.ndarray:
    shape = _SHAPES[name]
    try:
        found = np.asarray(value, float)
    except (TypeError, ValueError):
        raise InputError(f"{path}: {name} must hold numbers; it holds {value!r}") from None
    if found.shape != shape:
        raise InputError(f"{path}: {name} has shape {found.shape} where {shape} is needed")
    if not np.isfinite(found).all():
        raise InputError(f"{path}: {name} holds a number that is not finite; calibrate again")
    if len(shape) == 2 and not np.linalg.cond(found) < 1e6:
        raise InputError(f"{path}: {name} is singular, so that it loses the field; calibrate again")
    return found
