"""Strides and distance of phones in real pockets, beside the cameras'.

    python -m experiments.munoz_diaz.strides [DATA] [--out DIR]

Strides are those of `detectors.swing` at its default threshold, with no parameter chosen here. The cameras'
are peaks of the optical swing by one fixed rule (prominence 8 degrees); how that count itself moves with the
rule is told beside. Lengths of steps by three models (constant, affine in the swing, Weinberg), fitted on one
subject's walks and used on the other's."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import pedjax
from experiments.munoz_diaz import pockets
from experiments.munoz_diaz.pockets import Trial
from pedjax.detectors import swing
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache
from pedjax.system import Need
from pedjax.systems import system
from pedjax.walks import walk

RULES = (5.0, 8.0, 12.0)
DROP_S = 10.0


class Walked(NamedTuple):
    """A walk's strides between the cameras' first and last: `swing` rad, `bounce` m/s^2 of each, and the
    `distance` in m by the cameras between the same."""

    trial: Trial
    swing: np.ndarray
    bounce: np.ndarray
    distance: float


def found_in(trial: Trial) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, swings and bounces of the strides."""
    imu = walk(trial.recording, needs=(Need("pocket"),)).imu
    made = jax.jit(swing.cycles)(*(jnp.asarray(x) for x in (imu.specific_force, imu.angular_rate, imu.dt)))
    threshold = float(system("pocket").defaults().steps.threshold)
    at = np.flatnonzero((np.asarray(made.event) > 0) & (np.asarray(made.swing) > threshold))
    return imu.time[at], np.asarray(made.swing)[at], np.asarray(made.bounce)[at]


def counted(trial: Trial) -> dict[str, Any]:
    """Strides from ten seconds after the cameras begin on, by phone and by rule."""
    known = np.isfinite(trial.truth.quaternion).all(axis=1)  # type: ignore[union-attr]
    seen = trial.truth.time[known]
    low, high = seen[0] + DROP_S, seen[-1]
    times = found_in(trial)[0]
    own = int(((times >= low) & (times <= high)).sum())
    line: dict[str, Any] = {"walk": trial.name, "strides": own}
    for rule in RULES:
        true = pockets.strides_by_truth(trial, rule)
        count = int(((true >= low) & (true <= high)).sum())
        line[f"cameras_{rule:g}_deg"] = count
        line[f"off_{rule:g}_percent"] = 100 * (own / count - 1)
    return line


def walked(trial: Trial) -> Walked:
    """With the distance, over the time from the cameras' first stride to their last."""
    true = pockets.strides_by_truth(trial)
    times, swings, bounces = found_in(trial)
    some = (times > true[0]) & (times <= true[-1] + 0.3)
    return Walked(trial, swings[some], bounces[some], pockets.distance_by_truth(trial))


def _constant(x: Walked) -> np.ndarray:
    return np.array([2.0 * len(x.swing)])


def _affine(x: Walked) -> np.ndarray:
    return np.array([2.0 * len(x.swing), 2.0 * x.swing.sum()])


def _weinberg(x: Walked) -> np.ndarray:
    return np.array([2.0 * (x.bounce**0.25).sum()])


MODELS: dict[str, Callable[[Walked], np.ndarray]] = {
    "constant": _constant,
    "affine in swing": _affine,
    "Weinberg": _weinberg,
}
"""What a model's numbers are multiplied by to give the distance."""


def distances(walks: Sequence[Walked]) -> list[dict[str, Any]]:
    """Of each walk by each model fitted on the other subject's walks (least squares)."""
    lines = []
    for x in walks:
        others = [y for y in walks if y.trial.subject != x.trial.subject]
        line: dict[str, Any] = {"walk": x.trial.name, "cameras_m": x.distance}
        for name, terms in MODELS.items():
            A = np.array([terms(y) for y in others])
            fitted = np.linalg.lstsq(A, np.array([y.distance for y in others]), rcond=None)[0]
            line[f"{name}_percent"] = 100 * (float(terms(x) @ fitted) / x.distance - 1)
        lines.append(line)
    return lines


def tell(lines: Sequence[dict[str, Any]]) -> None:
    """Each line, and mean and worst of what is in percent."""
    for line in lines:
        print(*(f"{x:.1f}" if isinstance(x, float) else x for x in line.values()), sep="  ", flush=True)
    for key in lines[0]:
        if key.endswith("percent"):
            size = np.abs([line[key] for line in lines])
            print(f"  {key}: mean {size.mean():.2f}, worst {size.max():.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", nargs="?", type=Path, default=os.environ.get("PEDJAX_DATA"))
    parser.add_argument("--out", type=Path, default=Path("out/strides"))
    args = parser.parse_args()
    if args.data is None:
        parser.error("name the folder with the recordings, or set PEDJAX_DATA to it")
    pedjax.configure(precision="float64", cache=default_cache())
    out = folder(args.out)
    trials = pockets.load(Path(args.data))
    for name, lines in (
        ("strides", [counted(trial) for trial in trials]),
        ("distances", distances([walked(trial) for trial in trials])),
    ):
        tell(lines)
        write_table(out / f"{name}.csv", {key: [line[key] for line in lines] for key in lines[0]})


if __name__ == "__main__":
    main()
