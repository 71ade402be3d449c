"""Fits at the edge: a cloud or a walked loop becomes a calibration, with what is odd about it in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import rotations
from pedjax.calibration import alignment, ellipsoid, levelling, planar
from pedjax.calibration.clouds import Cloud
from pedjax.calibration.magnetometer import Calibration, apply, uncalibrated
from pedjax.detectors import stance
from pedjax.detectors.segments import clean_stance, stance_id
from pedjax.errors import InputError
from pedjax.recording import Inertial, nominal_rate
from pedjax.runtime import double_precision
from pedjax.shapes import bucket

LEAST_FLATNESS = 0.02
LEAST_COVERAGE = 0.02
WIDEST_GAP = np.deg2rad(90.0)
"""Limits of methods for a usable cloud and loop; those below are kit choices."""

MOST_RESIDUAL = 0.05  # of the field: beyond it the field was not the same everywhere, and auto walks a loop
MOST_LEVEL_RESIDUAL = 0.1  # of the horizontal field
MOST_TILT = 0.04  # residual of the alignment over the field, beyond which it is not applied
QUIET_S = 3.0  # at rest that an alignment needs
WIDEST_SIGMA = 1.0  # deg of the alignment, beyond which it is not applied
MERGE_S, DROP_S = 0.12, 0.15  # a stance is one: gaps in it are merged, and what is shorter is none
_WHOLE_TURNS = np.deg2rad(45.0)
UPRIGHT = 0.8  # of the force along x: beyond it y is taken for the axis ahead


@dataclass(frozen=True)
class Fit:
    """A calibration with numpy leaves; `method` and `reason` why that one; `strength` F in µT (of the
    horizontal field for a loop); `diagnostics` by name with the unit in it; `warnings`."""

    calibration: Calibration
    method: str
    reason: str
    strength: float
    diagnostics: dict[str, Any]
    warnings: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class Loop:
    """Stances of a walk: `points (K, 3)` µT, the levelled field of each, `turn (K,)` rad the yaw of the
    gyroscope at each from the first on, and the body axis `ahead` (0, 1, 2) whose level direction is the
    points' x."""

    points: np.ndarray
    turn: np.ndarray
    ahead: int = 0


_FITS = {name: jax.jit(fit) for name, fit in ellipsoid.FITS.items()}
_refine, _quality, _align = (jax.jit(f) for f in (ellipsoid.refine, ellipsoid.quality, alignment.align))
_factor = jax.jit(ellipsoid.factor, static_argnames="form")
_PLANAR = {name: jax.jit(fit) for name, fit in planar.METHODS.items()}


def _numpy(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)


def _check(name: str, values: np.ndarray, fewest: int, what: str) -> None:
    """Refuse what no fit can use."""
    if len(values) < fewest:
        raise InputError(
            f"{name}: {len(values)} {what} are too few, this method needs {fewest}; record longer, or choose "
            "another --method"
        )
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(
            f"{name}: {len(bad)} {what} are not numbers, the first is number {bad[0]}; remove them"
        )
    if np.ptp(values, axis=0).max() <= 1e-6 * max(np.abs(values).max(), 1e-300):
        raise InputError(f"{name}: all {len(values)} {what} are the same; turn the sensor while recording")


@double_precision()
def fit_cloud(
    cloud: Cloud,
    method: str = "algebraic",
    strength: float | None = None,
    form: str = "symmetric",
    refined: bool = True,
    aligned: bool = True,
    reason: str = "as asked",
) -> Fit:
    """The ellipsoid of a turned sensor. `strength` is the field's in µT where known, otherwise the geometric
    mean of the half axes. `refined` makes the fit a geometric one, `aligned` turns it to the
    accelerometer."""
    _check(cloud.name, cloud.field, ellipsoid.FEWEST, "samples of the field")
    size = bucket(len(cloud.field))
    values, weights = _padded(cloud.field, size), _padded(np.ones(len(cloud.field)), size)
    found = _FITS[method](values, weights)
    if refined:
        found = _refine(found, values, weights)
    told = _numpy(_quality(found, values, weights))
    f = float(ellipsoid.strength(found)) if strength is None else strength
    matrix = np.asarray(_factor(found, f, form=form))
    warnings = _cloud_warnings(
        told, bool(found.positive), f * float(told.residual) / float(ellipsoid.strength(found)), f
    )
    diagnostics = {
        "samples": len(cloud.field),
        "residual_ut": float(told.residual) * f / float(ellipsoid.strength(found)),
        "half_axes_ut": told.axes.tolist(),
        "coverage": float(told.coverage),
        "flatness": float(told.flatness),
        "condition": float(told.condition),
    }
    if aligned and cloud.force is not None:
        turned, more, said = _aligned(cloud, np.asarray(found.centre), matrix, f)
        matrix, warnings = turned @ matrix, [*warnings, *more]
        diagnostics |= said
    base = _numpy(uncalibrated())
    calibration = base._replace(hard_iron=np.asarray(found.centre, float), matrix=np.asarray(matrix, float))
    name = method + (" + refined" if refined else "")
    return Fit(calibration, name, reason, f, diagnostics, tuple(warnings))


def _padded(x: np.ndarray, size: int) -> jax.Array:
    """Zeros behind it, so that few shapes are compiled."""
    return jnp.asarray(np.concatenate([x, np.zeros((size - len(x), *x.shape[1:]))]), jnp.result_type(float))


def _cloud_warnings(told: ellipsoid.Quality, positive: bool, residual: float, f: float) -> list[str]:
    lines = []
    if not positive:
        lines.append(
            "the points fit no ellipsoid, a sphere was taken: soft iron is not corrected; turn the sensor "
            "through more attitudes"
        )
    if told.flatness < LEAST_FLATNESS:
        lines.append(
            f"the points lie nearly in a plane (flatness {told.flatness:.3f}): the hard iron across it is "
            "not known; turn the sensor upside down too, or walk a loop and use --method lsq"
        )
    elif told.coverage < LEAST_COVERAGE:
        lines.append(
            f"the directions cover little (smallest eigenvalue {told.coverage:.3f} of 1/3): turn the sensor "
            "through all attitudes"
        )
    if residual > MOST_RESIDUAL * f:
        lines.append(
            f"|m| strays by {residual:.2f} µT ({residual / f:.0%}) after calibration: the field was not the "
            "same everywhere, or the hard iron changed meanwhile"
        )
    if not 20 < f < 70:
        lines.append(f"a field of {f:.1f} µT is not the earth's (25 to 65); is the unit right?")
    return lines


def _aligned(
    cloud: Cloud, centre: np.ndarray, matrix: np.ndarray, f: float
) -> tuple[np.ndarray, list[str], dict[str, Any]]:
    """The rotation to the accelerometer's axes, or none with a line that says why."""
    if cloud.force is None or cloud.quiet is None:
        return np.eye(3), [], {}
    quiet = cloud.quiet
    seconds = float(quiet.sum() * np.median(np.diff(cloud.time)))
    remedy = "turn the sensor slowly through all attitudes, with rests"
    if seconds < QUIET_S:
        line = f"not aligned to gravity: it is at rest for {seconds:.1f} s, {QUIET_S:g} are needed; {remedy}"
        return np.eye(3), [line], {}
    size = bucket(len(cloud.field))
    m = (cloud.field - centre) @ matrix.T
    found = _numpy(_align(_padded(m, size), _padded(cloud.force, size), _padded(quiet.astype(float), size)))
    angle = float(np.arccos(np.clip((np.trace(found.rotation) - 1) / 2, -1, 1)))
    # a second at rest is taken as one independent attitude: counting samples made this 17 times too small
    sigma = np.rad2deg(found.sigma) * np.sqrt(max(quiet.sum() / seconds, 1.0))
    good = float(found.residual) <= MOST_TILT * f and sigma < WIDEST_SIGMA
    said = {
        "aligned": good,
        "alignment_s": seconds,
        "alignment_deg": float(np.rad2deg(angle)),
        "alignment_sigma_deg": float(sigma),
        "alignment_residual_ut": float(found.residual),
        "inclination_deg": float(np.rad2deg(found.inclination)),
    }
    if good:
        return found.rotation, [], said
    line = (
        f"not aligned to gravity: f·m strays by {found.residual:.2f} µT in {seconds:.0f} s at rest, which "
        f"leaves {sigma:.1f} deg; {remedy}"
    )
    return np.eye(3), [line], said


@partial(jax.jit, static_argnames=("count", "ahead"))
def _stances(
    force: jax.Array, mag: jax.Array, ids: jax.Array, count: int, ahead: int
) -> tuple[jax.Array, jax.Array]:
    values = jnp.concatenate([levelling.level(force, mag, ahead), force], axis=-1)
    means, _ = levelling.stance_means(values, jnp.ones_like(force[:, 0]), ids, count)
    return means[:, :3], means[:, 3:]


@double_precision()
def walk_loop(imu: Inertial, base: Calibration | None = None, threshold: float | None = None) -> Loop:
    """The stances of a walk by the SHOE detector (`threshold` where not the published one) and their levelled
    fields, behind the body part of `base`."""
    if imu.magnetic_field is None:
        raise InputError("the recording has no magnetometer; a calibration needs one")
    params = stance.StanceParameters()
    limit = float(params.shoe.threshold) if threshold is None else threshold
    force, rate, dt = (jnp.asarray(x) for x in (imu.specific_force, imu.angular_rate, imu.dt))
    still = clean_stance(
        stance.statistic(params, force, rate, nominal_rate(imu)) < limit, dt, MERGE_S, DROP_S
    )
    ids = np.asarray(stance_id(still))
    count = int(ids.max()) + 1
    if count < 1:
        return Loop(np.zeros((0, 3)), np.zeros(0))
    mag = apply(base or uncalibrated(), imu.magnetic_field)
    standing = np.asarray(force)[ids >= 0].mean(axis=0)
    ahead = int(abs(standing[0]) > UPRIGHT * np.linalg.norm(standing))
    points, up = _numpy(_stances(force, mag, jnp.asarray(ids), bucket(count), ahead))
    onset = np.searchsorted(np.maximum.accumulate(ids), np.arange(count))
    seen = np.isfinite(points[:count]).all(axis=1)  # not where the magnetometer has no readings
    return Loop(points[:count][seen], _turn(imu, onset, up[:count], ahead)[seen], ahead)


def _turn(imu: Inertial, at: np.ndarray, up: np.ndarray, ahead: int) -> np.ndarray:
    """Yaw `(K,)` rad by the gyroscope since the first of the samples `at (K,)`, where the specific force is
    `up (K, 3)`: levelled anew at each, so that only yaw adds up."""
    level = np.stack([np.asarray(axis).T for axis in rotations.level_axes(jnp.asarray(up).T, ahead)], axis=1)
    turns = np.moveaxis(np.asarray(rotations.exp(jnp.asarray((imu.angular_rate * imu.dt[:, None]).T))), -1, 0)
    yaw = np.zeros(len(at))
    for k in range(1, len(at)):
        attitude = level[k - 1]
        for turn in turns[at[k - 1] + 1 : at[k] + 1]:
            attitude = attitude @ turn
        about = attitude @ level[k].T
        yaw[k] = yaw[k - 1] + np.arctan2(about[1, 0] - about[0, 1], about[0, 0] + about[1, 1])
    return yaw


@double_precision()
def fit_loop(
    name: str,
    loop: Loop,
    method: str = "lsq",
    strength: float | None = None,
    base: Calibration | None = None,
    reason: str = "as asked",
) -> Fit:
    """The planar calibration of a walked loop. `strength` is the horizontal field's in µT, where known."""
    points = loop.points[:, :2]
    _check(name, points, planar.FEWEST[method], "stances")
    size = bucket(len(points))
    found = _numpy(_PLANAR[method](_padded(points, size), _padded(np.ones(len(points)), size)))
    if not found.enough:
        raise InputError(f"{name}: the {len(points)} stances' fields lie on a line; walk a loop with bends")
    scale = 1.0 if strength is None else strength / float(found.radius)
    radius = float(found.radius) * scale
    base = _numpy(base or uncalibrated())
    calibration = base._replace(
        level_offset=found.offset, level_matrix=scale * found.matrix, level_ahead=loop.ahead
    )
    corrected = (points - found.offset) @ calibration.level_matrix.T
    whole = float(loop.turn[-1] - loop.turn[0])
    away = abs(whole - 2 * np.pi * round(whole / (2 * np.pi)))
    warnings = []
    if not found.ellipse:
        warnings.append(
            "the points lie on no ellipse, a circle was fitted: soft iron is not corrected; walk "
            "a rounder loop"
        )
    if found.gap > WIDEST_GAP:
        warnings.append(
            f"the stances cover {360 - np.rad2deg(found.gap):.0f} deg of azimuth, less than 270: the offset "
            "leans to the covered side; walk a whole loop"
        )
    if away > _WHOLE_TURNS:
        warnings.append(
            f"the loop is not closed: the walk turns by {np.rad2deg(whole):.0f} deg in all, no whole turns"
        )
    if scale * found.residual > MOST_LEVEL_RESIDUAL * radius:
        warnings.append(
            f"the corrected points stray by {scale * found.residual:.2f} µT from a circle of {radius:.1f} "
            "µT: the field was not the same along the walk; walk it outdoors"
        )
    diagnostics = {
        "stances": len(points),
        "residual_ut": float(scale * found.residual),
        "tau": float(found.tau),
        "eta_rad": float(found.eta),
        "azimuth_gap_deg": float(np.rad2deg(found.gap)),
        "turned_deg": float(np.rad2deg(whole)),
        "ellipse": bool(found.ellipse),
    }
    return Fit(
        calibration, method, reason, radius, diagnostics, tuple(warnings),
        {"points": points, "corrected": corrected},
    )  # fmt: skip


@double_precision()
def choose(cloud: Cloud, loop: Loop | None) -> tuple[str, str]:
    """Method and reason: the ellipsoid where the sensor was turned through space in one field, otherwise the
    walked loop."""
    walked = loop is not None and len(loop.points) >= planar.FEWEST["lsq"]
    enough = len(cloud.field) >= ellipsoid.FEWEST and np.isfinite(cloud.field).all()
    if enough:
        size = bucket(len(cloud.field))
        values, weights = _padded(cloud.field, size), _padded(np.ones(len(cloud.field)), size)
        found = _FITS["algebraic"](values, weights)
        told = _quality(found, values, weights)
        share = float(told.residual) / float(ellipsoid.strength(found))
        flat, covers = float(told.flatness), float(told.coverage)
        if (
            flat >= LEAST_FLATNESS
            and covers >= LEAST_COVERAGE
            and share <= MOST_RESIDUAL
            and bool(found.positive)
        ):
            return (
                "algebraic",
                f"turned through space (coverage {covers:.2f}) in one field (residual {share:.1%})",
            )
        why = (
            f"the field lies nearly in a plane (flatness {flat:.3f})" if flat < LEAST_FLATNESS
            else f"its directions cover little ({covers:.3f})" if covers < LEAST_COVERAGE
            else f"it fits no single ellipsoid (residual {share:.0%})"
        )  # fmt: skip
    else:
        why = f"{len(cloud.field)} samples are too few for an ellipsoid"
    if walked and loop is not None:
        return "lsq", f"{why}, and there are {len(loop.points)} stances"
    return "algebraic", f"{why}, but there is no walk to use instead"
