"""Wang's alignment on BROAD's still windows, and Wang's filters on recorded feet.

    python -m experiments.wang.real [--broad FILE ...] [--walks FILE ...] [--loops FILE ...] [--out DIR]

`--broad` have an optical attitude: of each window of 3 s and more in which the board lies still, the errors
of tilt and heading by each method, the room's own north included. `--walks` have landmarks: RMS errors in m
after the best yaw and translation; `--loops` end where they began: closure in m. The field of the place is
taken to be as the recording's first stand shows it. Nothing is tuned.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import pedjax
from experiments import recorded
from experiments.wang import stands
from pedjax.calibration import attitude
from pedjax.calibration.attitude import METHODS, Earth, Stand
from pedjax.detectors.rest import standing_rows
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache, double_precision

WANG = ("wang", "wang_best", "wang_adaptive")
PRESETS = ("iez", "iez_adaptive", "ma2018", "aiez", "aiez_adaptive", *WANG)
STILL_S = 3.0
_QUIET = np.radians(1.0)


def still_windows(rate: np.ndarray, hertz: float) -> list[slice]:
    """Stretches of `STILL_S` s and more without turning; their first and last quarter second left out."""
    quiet = np.linalg.norm(rate, axis=1) < _QUIET
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(int)))
    margin, least = round(0.25 * hertz), round((STILL_S + 0.5) * hertz)
    return [
        slice(a + margin, b - margin) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least
    ]


def windows_of(path: Path) -> list[dict[str, Any]]:
    """Errors of each still window of a trial by each method, deg."""
    recording = pedjax.read(path)
    imu, truth = pedjax.inertial(recording, "hand"), recording.truth
    assert imu.magnetic_field is not None
    assert truth is not None
    assert truth.quaternion is not None
    from scipy.spatial.transform import Rotation

    lines = []
    for window in still_windows(imu.angular_rate, imu.rate):
        known = np.isfinite(truth.quaternion[window]).all(axis=1)
        if known.mean() < 0.5:
            continue
        true = Rotation.from_quat(truth.quaternion[window][known], scalar_first=True).mean().as_matrix()
        signals = (imu.dt, imu.specific_force, imu.angular_rate, imu.magnetic_field)
        stand = Stand(*(jnp.asarray(x[window]) for x in signals))
        size, dip = _seen(imu.specific_force[window], imu.magnetic_field[window])
        earth = Earth(*(jnp.asarray(x) for x in (size, dip, np.pi / 2)))
        line: dict[str, Any] = {
            "trial": recording.name,
            "from_s": float(imu.time[window][0]),
            "seconds": float(np.ptp(imu.time[window])),
        }
        for method in METHODS[1:]:
            found = attitude.aligned(stands.align(), method, stand, earth)
            turn = np.asarray(found.attitude) @ true.T
            tilt = np.degrees(np.arccos(np.clip(turn[2, 2], -1, 1)))
            heading = np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
            line |= {f"{method}_tilt": float(tilt), f"{method}_heading": float(heading)}
        lines.append(line)
    return lines


def place(recording: pedjax.Recording) -> dict[str, float]:
    """Strength and dip of the field as the first stand shows them."""
    imu = pedjax.inertial(recording)
    assert imu.magnetic_field is not None
    rows = int(standing_rows(jnp.asarray(imu.angular_rate), jnp.asarray(imu.dt), imu.rate, 5.0))
    first = slice(0, max(rows, round(0.1 * imu.rate)))
    size, dip = _seen(imu.specific_force[first], imu.magnetic_field[first])
    return {"compass.strength": size, "compass.inclination": dip}


def _seen(force: np.ndarray, field: np.ndarray) -> tuple[float, float]:
    """Median strength in µT and dip in rad of a stretch of rest."""
    dip = attitude.dip(jnp.asarray(force.mean(axis=0))[None], jnp.asarray(field))
    return float(np.median(np.linalg.norm(field, axis=1))), float(np.median(np.asarray(dip)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("broad", "walks", "loops"):
        parser.add_argument(f"--{name}", nargs="*", type=Path, default=[])
    parser.add_argument("--out", type=Path, default=Path("out/wang_real"))
    args = parser.parse_args()
    pedjax.configure(cache=default_cache())
    out = folder(args.out)
    with double_precision():
        lines = [line for path in args.broad for line in windows_of(path)]
    for line in lines:
        print(*(f"{k} {v:.2f}" if isinstance(v, float) else v for k, v in line.items()), sep="  ")
    if lines:
        write_table(out / "broad.csv", {key: [line[key] for line in lines] for key in lines[0]})
    rows = []
    for kind, paths in (("walk", args.walks), ("loop", args.loops)):
        for path in paths:
            recording = pedjax.read(path)
            if recording.sensor().magnetometer is None:
                continue
            here = place(recording)
            rows.append(recorded.line(recording, kind, PRESETS, dict.fromkeys(WANG, here)))
    recorded.tell(rows, PRESETS)
    if rows:
        write_table(out / "presets.csv", {key: [row[key] for row in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
