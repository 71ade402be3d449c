"""What one walk tells the next of its sensor: the gyroscope's bias, and the hard iron of what hangs beside
it.

A run's last estimates are a file that the next run starts from (`pedjax run --prior FILE`), or the start of a
second pass over the same walk, which is not causal and nearly as good as knowing the bias beforehand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pedjax import parameters
from pedjax.errors import InputError
from pedjax.output import write_toml
from pedjax.tables import filled, loaded

DRIFT = math.radians(0.3)
"""rad/s by which a phone's bias may differ from that of an earlier walk; for a better unit, what the run
allowed for without knowing anything."""

IRON_DRIFT = 5.0
"""µT by which hard iron may, likewise."""

PASS_BIAS, PASS_IRON = 2e-3, 2.0
"""rad/s and µT: how far the second pass trusts the first, which has seen the same readings."""

_AXES = "xyz"
_HEADING = """What a walk told of its sensor, for `pedjax run --prior`: the gyroscope's bias in rad/s and,
where it was estimated, the hard iron in microtesla, by body axis, with their standard deviations. `drift` is
by how much each may differ at the next walk: what your sensor does is worth more than the number here."""


@dataclass(frozen=True)
class Known:
    """Three numbers by body axis with their standard deviation (the largest of the three), and by how much
    they may differ at the next walk."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    sigma: float = 0.0
    drift: float = 0.0

    def __post_init__(self) -> None:
        for name in ("sigma", "drift"):
            if not getattr(self, name) >= 0:
                raise InputError(f"prior: {name} = {getattr(self, name)!r} must not be negative")

    @property
    def spread(self) -> float:
        """Standard deviation of the prior that it is: the larger of both, so that it neither grows nor
        shrinks from walk to walk."""
        return max(self.sigma, self.drift)


@dataclass(frozen=True)
class Prior:
    """The `gyroscope_bias`, rad/s, and the `hard_iron`, µT, None where it was not estimated."""

    gyroscope_bias: Known
    hard_iron: Known | None = None


def prior_of(track: Any) -> Prior:
    """Of the last estimates of a run."""
    if "gyroscope_bias" not in track.estimate:
        raise InputError(f"{track.name}: the system '{track.system}' estimates no gyroscope bias")
    iron = None
    if "hard_iron" in track.more and "hard_iron_sigma" in track.more:
        iron = _last(track.more["hard_iron"], track.more["hard_iron_sigma"], IRON_DRIFT)
    return Prior(_last(track.estimate["gyroscope_bias"], track.sigma["gyroscope_bias"], DRIFT), iron)


def _last(values: np.ndarray, sigmas: np.ndarray, most: float) -> Known:
    return _known(values[-1], sigmas[-1], min(most, float(np.max(sigmas[0]))))


def _known(values: np.ndarray, sigmas: np.ndarray, drift: float) -> Known:
    x, y, z = (float(value) for value in values)
    return Known(x, y, z, float(np.max(sigmas)), drift)


def with_prior(params: Any, prior: Prior, origin: str = "prior") -> Any:
    """The parameters of a system that starts from it; hard iron only where the system estimates it."""
    return parameters.replace(params, changes(params, prior, origin), origin)


def changes(params: Any, prior: Prior, origin: str = "prior") -> dict[str, Any]:
    """The parameters that a prior sets, by dotted path."""
    paths = parameters.values(params)
    if "initial.prior.x" not in paths:
        raise InputError(f"{origin}: this system cannot be given a first bias of the gyroscope")
    bias = prior.gyroscope_bias
    new: dict[str, Any] = {
        "initial.bias": "given" if paths["initial.bias"] == "zero" else paths["initial.bias"]
    }
    new |= {f"initial.prior.{a}": getattr(bias, a) for a in _AXES}
    new["initial.gyroscope_bias"] = bias.spread
    if prior.hard_iron is not None and paths.get("reference.state.iron"):
        new |= {f"reference.state.iron_prior.{a}": getattr(prior.hard_iron, a) for a in _AXES}
        new["reference.state.iron_sigma"] = prior.hard_iron.spread
    return new


def second_pass(params: Any, track: Any) -> Any:
    """The parameters with which a run over the same walk starts from what the first one ended with: bias,
    hard iron, and the size and dip of the field; the yaw is free."""
    first = prior_of(track)
    bias = _known(track.estimate["gyroscope_bias"][-1], np.zeros(3), PASS_BIAS)
    iron = None
    if first.hard_iron is not None:
        iron = _known(track.more["hard_iron"][-1], np.zeros(3), PASS_IRON)
    new = changes(params, Prior(bias, iron))
    if parameters.values(params).get("reference.state.start") == "expected":
        field = track.more["reference_field"][-1]
        new["reference.state.level"] = float(np.hypot(field[0], field[1]))
        new["reference.state.down"] = float(-field[2])
    numbers = {path: value for path, value in new.items() if isinstance(value, float)}
    return parameters.replace(params, {**new, **parameters.within(params, numbers)})


def write(path: Path, prior: Prior) -> None:
    """As a TOML file."""
    table = {"gyroscope_bias": vars(prior.gyroscope_bias)}
    if prior.hard_iron is not None:
        table["hard_iron"] = vars(prior.hard_iron)
    write_toml(path, table, _HEADING)


def read(path: str | Path) -> Prior:
    """From a file that `pedjax run` wrote."""
    raw = loaded(Path(path), f"{path}: there is no such file; pedjax run writes one as NAME_prior.toml")
    unknown = set(raw) - {"gyroscope_bias", "hard_iron"}
    if unknown or not isinstance(raw.get("gyroscope_bias"), dict):
        raise InputError(f"{path}: is no prior; it needs a table [gyroscope_bias], and may have [hard_iron]")
    iron = raw.get("hard_iron")
    return Prior(
        filled(Known, raw["gyroscope_bias"], f"{path}: gyroscope_bias"),
        None if iron is None else filled(Known, iron, f"{path}: hard_iron"),
    )
