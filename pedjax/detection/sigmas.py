"""The sigmas of a field detector from recordings: how much the field changes from look to look where it is
quasi-static.

Nobody says which windows of a recording are quasi-static. They are found together with the sigmas: a window
counts while the squares of its changes, each over its sigma, add up to less than a quantile of χ²; sigmas
are the root mean squares of the changes in the windows that count, corrected for what the quantile cuts off;
and so on until nothing changes. It starts from the calmest windows and so finds the narrowest distribution
that holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.special import chdtr, chdtri

from pedjax import parameters, rotations
from pedjax.detection.field import STRAIGHT, Windows, field_walk, looks_at_field, seen_windows
from pedjax.detectors.field import Aiez, FieldParameters, azimuth, inclination, strength
from pedjax.errors import InputError
from pedjax.recording import Clock, Recording
from pedjax.simulation.truth import SensorTruth
from pedjax.system import System

FEWEST = 20
"""Windows that must count as quasi-static, at least."""

KEEP = 0.9
"""Part of the quasi-static windows that the quantile keeps. More of it uses more windows, and where the field
changes by all amounts it takes disturbed ones for quasi-static (kit choice)."""

_CALMEST = 0.25  # part of all windows that the search starts from
_MEDIAN = 0.6744897501960817  # of the size of a standard normal
_ROUNDS = 500
_WIDE, _VAGUE = 0.99, 1.4  # with so much kept, a clear quasi-static part has 1.1 times the windows of KEEP
_SAME_FIELD, _SAME_HEADING = 3.0, np.radians(5.0)  # µT, rad: what a quasi-static field may change in a step


class Fit(NamedTuple):
    """The `sigma` of each channel by its name, the windows `used (K,)` that count as quasi-static, and
    whether the search `settled`."""

    sigma: dict[str, float]
    used: np.ndarray
    settled: bool


class FieldSigmas(NamedTuple):
    """What recordings say of a detector's sigmas.

    `params` are the system's with the detector and its new sigmas; `changes` holds `(n, K)` for each sigma's
    name, the n changes of every window, in the sigma's unit; `windows` and `used` count the windows of each
    recording. Where the truth of all recordings is known, `label (K,)` says which windows are quasi-static
    (and straight, for iqsf), and `by_truth` holds their sigmas (empty where they are fewer than `FEWEST`).
    """

    params: Any
    detector: str
    recordings: list[Recording]
    changes: dict[str, np.ndarray]
    fit: Fit
    windows: list[int]
    used: list[int]
    label: np.ndarray | None
    by_truth: dict[str, float]
    warnings: tuple[str, ...]


class _Seen(NamedTuple):
    """Windows with the numbers that detectors go by: `azimuth`, `inclination` rad, `strength` µT and `yaw`
    rad `(N + 1, K)`; `change` takes such to changes `(N, K)`, per step or per second; `north` rad."""

    azimuth: np.ndarray
    inclination: np.ndarray
    strength: np.ndarray
    yaw: np.ndarray
    change: Callable[..., np.ndarray]
    north: float


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.asarray(rotations.wrap(jnp.asarray(angle)))


def _of_strength(own: Any, seen: _Seen) -> dict[str, np.ndarray]:
    return {"sigma_strength": seen.change(seen.strength)}


def _of_iqsf(own: Any, seen: _Seen) -> dict[str, np.ndarray]:
    both = [seen.change(x, angle=True) for x in (seen.yaw, seen.yaw - seen.azimuth)]  # one sigma for both
    return {"sigma_heading": np.concatenate(both), "sigma_strength": seen.change(seen.strength)}


def _of_ma(own: Any, seen: _Seen) -> dict[str, np.ndarray]:
    if own.theta == "rate":
        heading = seen.change(-seen.azimuth, angle=True)
    else:
        heading = _wrapped(seen.north - seen.azimuth[1:])
    return {
        "sigma_heading": heading,
        "sigma_inclination": seen.change(seen.inclination),
        "sigma_strength": seen.change(seen.strength),
    }


def _of_aiez(own: Any, seen: _Seen) -> dict[str, np.ndarray]:
    return {
        "sigma_heading": _wrapped(seen.north - seen.azimuth[1:]),
        "sigma_strength": seen.change(seen.strength),
    }


CHANNELS: dict[str, Callable[[Any, _Seen], dict[str, np.ndarray]]] = {
    "ma": _of_ma, "iqsf": _of_iqsf, "qsf": _of_strength, "qmd": _of_strength,
    "aiez": _of_aiez,
}  # fmt: skip
"""Detectors with sigmas of changes: `(own parameters, what was seen) -> changes (n, K)` by a sigma's name."""


def _check(detector: str) -> None:
    if detector not in CHANNELS:
        raise InputError(
            f"the field detector '{detector}' has no sigmas of changes; choose one of {', '.join(CHANNELS)}"
        )


def changes_in(p: FieldParameters, windows: Windows, north: float = np.pi / 2) -> dict[str, np.ndarray]:
    """The changes in each window that the chosen detector weighs, `(n, K)` by the name of their sigma."""
    _check(p.detector)
    own = getattr(p, p.detector)

    def change(values: np.ndarray, angle: bool = False) -> np.ndarray:
        y = np.diff(values, axis=0)
        if angle:
            y = _wrapped(y)
        return y if own.per == "step" else y / np.maximum(np.diff(windows.time, axis=0), 1e-3)

    field = jnp.asarray(np.moveaxis(windows.field, 1, 0))
    azimuths, dips, sizes = (np.asarray(of(field)) for of in (azimuth, inclination, strength))
    return CHANNELS[p.detector](own, _Seen(azimuths, dips, sizes, windows.yaw, change, north))


def fit_sigmas(
    changes: Mapping[str, np.ndarray],
    keep: float = KEEP,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Fit:
    """Sigmas of the quasi-static part, without being told which windows are.

    `changes` holds `(n, K)` for each sigma's name; they are taken for Gaussian about zero and independent
    where the field is quasi-static. `bounds` are the lowest and highest value of each sigma.
    """
    limits = dict.fromkeys(changes, (1e-12, np.inf)) | dict(bounds or {})
    whole = np.all([np.isfinite(y).all(axis=0) for y in changes.values()], axis=0)
    given = {name: y[:, whole] for name, y in changes.items()}
    if not whole.any():
        raise InputError("no window of looks holds finite changes; look at the walk with pedjax run")

    def inside(sigma: Mapping[str, float]) -> dict[str, float]:
        return {name: float(np.clip(value, *limits[name])) for name, value in sigma.items()}

    def usual(some: np.ndarray) -> dict[str, float]:
        return inside({name: np.median(np.abs(y[:, some])) / _MEDIAN for name, y in given.items()})

    def energy(sigma: Mapping[str, float]) -> np.ndarray:
        return np.sum([((y / sigma[name]) ** 2).sum(axis=0) for name, y in given.items()], axis=0)

    count = sum(len(y) for y in given.values())
    quantile = chdtri(count, 1 - keep)
    left = chdtr(count + 2, quantile) / keep  # of the variance, in windows below the quantile
    size = energy(usual(np.full(int(whole.sum()), True)))
    sigma = usual(size <= np.quantile(size, _CALMEST))
    used, settled = energy(sigma) < quantile, False
    for _ in range(_ROUNDS):
        if not used.any():
            break
        sigma = inside({name: np.sqrt(np.mean(y[:, used] ** 2) / left) for name, y in given.items()})
        before, used = used, energy(sigma) < quantile
        if settled := bool(np.array_equal(before, used)):
            break
    everywhere = np.full(len(whole), False)
    everywhere[whole] = used
    return Fit(sigma, everywhere, settled)


def labelled_sigmas(changes: Mapping[str, np.ndarray], label: np.ndarray) -> dict[str, float]:
    """Root mean squares of the changes `(n, K)` in the windows of a mask `(K,)`."""
    return {name: float(np.sqrt(np.mean(y[:, label] ** 2))) for name, y in changes.items()}


def field_sigmas(
    system: System,
    params: Any,
    walks: Iterable[tuple[Recording, SensorTruth | None]],
    detector: str | None = None,
    *,
    keep: float = KEEP,
    sensor: str = "foot",
    clock: Clock | None = None,
) -> FieldSigmas:
    """The sigmas of a field detector (None: the one chosen in `params`) from all walks together.

    Of made walks the truth is known, and the sigmas of the windows that are truly quasi-static come beside;
    the walks may come one at a time, for their truth is large and not kept.
    """
    if not looks_at_field(params):
        raise InputError(f"the system '{system.name}' does not look at the field; choose another system")
    if not 0 < keep < 1:
        raise InputError(f"keep {keep:g} must lie between 0 and 1")
    if detector is not None:
        params = parameters.replace(params, {"field.detector": detector})
    detector, north = params.field.detector, float(params.compass.north())
    _check(detector)
    recordings: list[Recording] = []
    found: list[dict[str, np.ndarray]] = []
    labels: list[np.ndarray] = []
    for recording, truth in walks:
        if truth is None:
            windows = seen_windows(recording, system, params, sensor=sensor, clock=clock)
        else:
            walk = field_walk(recording, truth, system, params, sensor=sensor, clock=clock)
            windows = walk.windows
            straight = walk.turn < (STRAIGHT if detector == "iqsf" else np.inf)  # it asks the yaw to stay
            labels.append(walk.label() & straight)
        recordings.append(recording)
        found.append(changes_in(params.field, windows, north))
    changes = {name: np.concatenate([each[name] for each in found], axis=1) for name in found[0]}
    paths = {name: f"field.{detector}.{name}" for name in changes}
    specs = parameters.specs(params)
    bounds = {name: (specs[path].low, specs[path].high) for name, path in paths.items()}
    fit = fit_sigmas(changes, keep, bounds)
    if fit.used.sum() < FEWEST:
        more = f" and {len(recordings) - 1} more" if len(recordings) > 1 else ""
        raise InputError(
            f"{recordings[0].name}{more}: {fit.used.sum()} of {len(fit.used)} windows of looks count as "
            f"quasi-static, and sigmas need {FEWEST}; record a longer or calmer walk, or name several"
        )
    counts = [next(iter(each.values())).shape[1] for each in found]
    label = np.concatenate(labels) if len(labels) == len(recordings) else None
    return FieldSigmas(
        parameters.replace(params, {paths[name]: value for name, value in fit.sigma.items()}),
        detector,
        recordings,
        changes,
        fit,
        counts,
        [int(part.sum()) for part in np.split(fit.used, np.cumsum(counts)[:-1])],
        label,
        labelled_sigmas(changes, label) if label is not None and label.sum() >= FEWEST else {},
        tuple(_doubts(fit, changes, bounds, getattr(params.field, detector))),
    )


def _doubts(
    fit: Fit,
    changes: Mapping[str, np.ndarray],
    bounds: Mapping[str, tuple[float, float]],
    own: Any,
) -> list[str]:
    """What speaks against the sigmas, in words."""
    lines = []
    part = float(fit.used.mean())
    if part < 0.1:
        lines.append(
            f"only {part:.1%} of all windows count as quasi-static; the sigmas are those of a few calm places"
        )
    for name, value in fit.sigma.items():
        low, high = bounds[name]
        if value <= low or value >= high:
            lines.append(
                f"{name} ends at its bound of {value:g}; "
                + ("the field hardly changes" if value <= low else "the field changes far too much")
                + ": look at the magnetometer with pedjax info"
            )
    if not fit.settled:
        lines.append("the search for the quasi-static windows did not settle; the sigmas are its last ones")
    narrow, wide = (fit_sigmas(changes, part, bounds) for part in (KEEP, _WIDE))
    more = wide.used.sum() / max(narrow.used.sum(), 1)
    if more > _VAGUE:
        grows = max(wide.sigma[name] / value for name, value in narrow.sigma.items())
        lines.append(
            f"there is no clear quasi-static part: with {_WIDE:.0%} of it kept {more:.1f} times as many "
            f"windows count as with {KEEP:.0%}, and a sigma is {grows:.1f} times as large; take the sigmas "
            "for a guess"
        )
    if own.per == "step" and getattr(own, "theta", "rate") == "rate" and not isinstance(own, Aiez):
        most = {"sigma_heading": _SAME_HEADING, "sigma_strength": _SAME_FIELD}
        for name, allowed in most.items():
            if fit.sigma.get(name, 0.0) > allowed:
                lines.append(
                    f"{name} of {fit.sigma[name]:.3g} is more than the {allowed:.3g} by which a quasi-static "
                    "field may change in a step: the field is hardly quasi-static anywhere"
                )
    return lines
