"""Fit the shape of a stride to recorded feet: the numbers behind `pedjax.simulation.footsteps.GAITS`.

    python -m experiments.gait_fit RECORDING... [--distance M ...] [--out DIR]

A recording is cut at the moments in which the foot is stillest; its strides are laid over one another, and
the shape of one simulated swing is fitted to their median (norms of angular rate and of specific force, and
the angle about the axis that the foot turns about most) by least squares with exact derivatives. The stride
length comes from the recording's truth, or from `--distance` m walked, one for each recording.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares

import pedjax
from pedjax.errors import InputError
from pedjax.output import folder, write_figure, write_table
from pedjax.runtime import double_precision
from pedjax.simulation import gait, motion

PHASE = np.linspace(0.0, 1.0, 121)
SHAPE = {  # start, lowest, highest of what is fitted
    "push": (0.1, 0.02, 0.4), "swing": (0.6, 0.3, 0.75), "settle": (0.1, 0.02, 0.4),
    "steepest": (0.3, 0.15, 0.55), "toe_up": (0.84, 0.6, 0.95), "toe_off": (1.05, 0.3, 1.6),
    "heel_strike": (0.5, 0.05, 0.9), "lift": (0.05, 0.0, 0.25), "highest": (0.35, 0.15, 0.7),
    "roll": (0.2, 0.0, 0.6), "middle": (0.5, 0.3, 0.7),
}  # fmt: skip
SPREAD = np.array([1.0, 4.0, 0.15])[:, None]  # rad/s, m/s^2, rad that count alike


def period(rate: np.ndarray, hz: float) -> int:
    """Samples in a stride: where the norm of the angular rate `(T,)` is most like itself."""
    even = rate - rate.mean()
    alike = np.correlate(even, even, "full")[len(even) - 1 :]
    lags = np.arange(int(0.55 * hz), int(1.7 * hz))
    return int(lags[np.argmax(alike[lags])])


def strides(recording: pedjax.Recording) -> tuple[np.ndarray, np.ndarray]:
    """Rate, force and angle over the phase `(N, 3, 121)` of N strides, and their durations `(N,)` in s."""
    samples = pedjax.inertial(recording, next(iter(recording.sensors)))
    hz, spin = samples.rate, np.asarray(samples.angular_rate)
    rate, force = np.linalg.norm(spin, axis=1), np.linalg.norm(samples.specific_force, axis=1)
    smooth = np.convolve(rate, np.ones(int(0.15 * hz)) / int(0.15 * hz), "same")
    usual = period(rate, hz)
    near = int(0.35 * usual)
    still = [
        i
        for i in range(near, len(smooth) - near)
        if smooth[i] == smooth[i - near : i + near + 1].min() and smooth[i] < 2.0
    ]
    found, seconds = [], []
    for first, last in itertools.pairwise(still):
        if 0.8 * usual < last - first < 1.25 * usual:
            here = slice(first, last + 1)
            angle = np.cumsum(spin[here] @ np.linalg.svd(spin[here], full_matrices=False)[2][0]) / hz
            angle = angle if abs(angle.min()) > abs(angle.max()) else -angle  # the heel rises first
            phase = np.linspace(0.0, 1.0, last - first + 1)
            found.append([np.interp(PHASE, phase, x) for x in (rate[here], force[here], angle)])
            seconds.append((last - first) / hz)
    if len(found) < 5:
        raise InputError(f"{recording.name}: fewer than five strides of like duration; name a longer walk")
    return np.array(found), np.array(seconds)


@jax.jit
def one_swing(shape: jax.Array, seconds: jax.Array, length: jax.Array) -> jax.Array:
    """Rate, force and angle `(3, 121)` of a simulated stride."""
    named = dict(zip(SHAPE, shape, strict=True))
    middle, flight = named.pop("middle") * seconds, named.pop("swing") * seconds
    zero, still = jnp.zeros(1), jnp.zeros((1, 2))
    fields: dict[str, Any] = {name: value[None] for name, value in named.items()}
    fields |= {name: fields[name] * seconds for name in ("push", "settle")}
    fields |= {
        "border": jnp.array([-9.0, 9.0]), "leaves": (middle - flight / 2)[None],
        "lands": (middle + flight / 2)[None], "start": jnp.zeros((1, 3)),
        "end": jnp.array([[1.0, 0.0, 0.0]]) * length, "heading": zero, "turn": zero, "aside": zero + 0.02,
        "shock": zero, "slip": jnp.zeros((1, 3)), "rest_before": still, "rest": still,
        "unrest_before": zero, "unrest": zero,
    }  # fmt: skip
    swing, none = gait.Swings(**fields), jnp.zeros((2, 1))
    walker = gait.Walker(swing, swing, gait.Sway(none, none, none), jnp.array([[1e6, 1e6 + 1, 0.0]]))
    gravity, lever = jnp.asarray(motion.GRAVITY), jnp.asarray(gait.INSTEP)
    made = jax.vmap(lambda t: motion.at(t, walker, "foot", lever, gravity))(jnp.asarray(PHASE) * seconds)
    rate = jnp.linalg.norm(made.angular_rate + 1e-9, axis=1)  # its slope at rest is finite
    angle = -jnp.cumsum(made.angular_rate[:, 1]) * seconds / (len(PHASE) - 1)
    return jnp.stack([rate, jnp.linalg.norm(made.specific_force, axis=1), angle])


_slopes = jax.jit(jax.jacfwd(one_swing))


def fit(median: np.ndarray, seconds: float, length: float) -> np.ndarray:
    """The shape nearest to a median stride, in the order of `SHAPE`."""

    def apart(shape: np.ndarray) -> np.ndarray:
        return ((np.asarray(one_swing(shape, seconds, length)) - median) / SPREAD).ravel()

    def slopes(shape: np.ndarray) -> np.ndarray:
        return (np.asarray(_slopes(shape, seconds, length)) / SPREAD[..., None]).reshape(-1, len(SHAPE))

    start, low, high = np.array(list(SHAPE.values())).T
    return np.asarray(least_squares(apart, start, slopes, (low, high), loss="soft_l1").x)


def length_of(recording: pedjax.Recording, seconds: np.ndarray, distance: float | None) -> float:
    """Metres a stride."""
    if distance is not None:
        return distance / len(seconds)
    if recording.truth is None or recording.truth.position is None:
        raise InputError(f"{recording.name}: has no dense truth; give the metres walked with --distance")
    every = max(int(0.1 / float(np.median(np.diff(recording.truth.time)))), 1)
    path = np.linalg.norm(np.diff(recording.truth.position[::every, :2], axis=0), axis=1).sum()
    return float(path / np.ptp(recording.truth.time) * np.median(seconds))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--distance", nargs="+", type=float, help="metres walked in each recording")
    parser.add_argument("--out", default="out")
    args = parser.parse_args()
    out = folder(args.out)
    distances = args.distance or [None] * len(args.recordings)
    figure = Figure(figsize=(11, 2.2 * len(args.recordings)), layout="constrained")
    axes = figure.subplots(len(args.recordings), 3, squeeze=False, sharex=True)
    rows = []
    for row, path, distance in zip(axes, args.recordings, distances, strict=True):
        recording = pedjax.read(path)
        found, seconds = strides(recording)
        median, each = np.median(found, axis=0), float(np.median(seconds))
        length = length_of(recording, seconds, distance)
        with double_precision():
            shape = fit(median, each, length)
            made = np.asarray(one_swing(shape, each, length))
        rows.append({"recording": Path(path).name, "stride_s": each, "stride_m": length})
        rows[-1] |= {name: float(value) for name, value in zip(SHAPE, shape, strict=True)}
        print(*(f"{k} {v:.2f}" if isinstance(v, float) else f"{v:28}" for k, v in rows[-1].items()))
        for ax, every, middle, ours in zip(row, found.transpose(1, 0, 2), median, made, strict=True):
            ax.plot(PHASE, every.T, color="0.8", lw=0.3)
            ax.plot(PHASE, middle, label="median of the recorded strides")
            ax.plot(PHASE, ours, label="fitted")
            ax.set_ylim(min(0.0, 1.2 * middle.min()), 1.4 * middle.max())
            ax.grid(alpha=0.3)
        row[0].set_ylabel(Path(path).name.split(".")[0], fontsize=7)
    for ax, title in zip(
        axes[0], ("angular rate (rad/s)", "specific force (m/s²)", "angle (rad)"), strict=True
    ):
        ax.set_title(title, fontsize=10)
    axes[0, 2].legend(fontsize=7)
    write_table(out / "gait_fit.csv", {key: [row[key] for row in rows] for key in rows[0]})
    write_figure(out / "gait_fit.png", figure)


if __name__ == "__main__":
    main()
