"""The way back: Zhang's attitude rows with the identity turn the tilt away from the truth at yaw 180 degrees.

Forty metres out and back in a field that is the same everywhere, with a glitch of 2 degrees about x on each
leg. Told is how much of the tilt error is left three seconds later: without tilt rows (zero velocities alone
mend it), with level axes, with roll and pitch and the right block, and with the identity as printed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import pedjax
from experiments.aiez import made
from experiments.table import Row, row
from pedjax.output import write_figure, write_table

LEGS = {"out": 20.0, "back": 60.0}
"""When the glitches are, s."""
GLITCH = 2.0
TIGHT = {"tilt.sigma": 0.02, "initial.attitude": 0.03, "process.gyroscope": 3e-3}
"""The rows are believed, and the filter knows that its attitude may be off."""
ROWS = {
    "none": "zero velocities alone",
    "level": "level axes",
    "euler": "M",
    "printed": "identity, as printed",
}


def tilt_error(walked: pedjax.Simulated, track: pedjax.Track) -> np.ndarray:
    """Degrees between true and estimated up, at every sample."""
    up = walked.truth["foot"].motion.attitude[:, 2]  # in body axes
    index = np.clip(np.searchsorted(walked.truth["foot"].time, track.time), 0, len(up) - 1)
    return between(up[index], track.attitude[:, 2])


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors `(T, 3)`, small ones too."""
    return np.asarray(np.degrees(np.arcsin(np.clip(np.linalg.norm(np.cross(a, b), axis=1), 0, 1))))


def run(seeds: range, out: Path) -> list[Row]:
    left: dict[tuple[str, str], list[float]] = {}
    for seed in tqdm(seeds, "way back"):
        walked = made.walk("floor-magnet", seed, field={"kind": "munich"})
        recording = walked.recording
        begins = {}
        for leg, at in LEGS.items():
            recording, begins[leg] = made.forced(walked, GLITCH, at, 0, recording)
        curves = {}
        for rows in ROWS:
            changes: dict[str, Any] = {**TIGHT, "tilt.rows": rows}
            track = made.run(recording, "aiez_iez", changes, made.given_yaw(walked))
            clean = made.run(walked.recording, "aiez_iez", changes, made.given_yaw(walked))
            error = tilt_error(walked, track)
            apart = between(track.attitude[:, 2], clean.attitude[:, 2])
            curves[rows] = (track.time, error)
            for leg, begin in begins.items():
                since = int(np.searchsorted(track.time, begin + 0.005))
                then = int(np.searchsorted(track.time, begin + 3.0))
                left.setdefault((rows, leg), []).append(float(apart[then] / apart[since]))
        if seed == seeds[0]:
            _figure(curves, begins, out)
    table: dict[str, list[Any]] = {"rows": [ROWS[k[0]] for k in left], "leg": [k[1] for k in left]}
    table |= {"left_median": [float(np.median(x)) for x in left.values()]}
    table |= {"left_worst": [float(np.max(x)) for x in left.values()]}
    print(*zip(*table.values(), strict=True), sep="\n", flush=True)
    write_table(out / "wayback.csv", table)
    found = []
    for rows, name in ROWS.items():
        a, b = (float(np.median(left[rows, leg])) for leg in LEGS)
        wanted = {"printed": "wrong on the way back", "none": ""}.get(rows, "as good back as out")
        met = bool(abs(b - a) < 0.1) if rows in ("level", "euler") else None
        found.append(
            row("WB", f"tilt error left after 3 s, {name}", wanted, f"out {a:.2f}, back {b:.2f}", met)
        )
    return found


def _figure(curves: dict[str, Any], begins: dict[str, float], out: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.5), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, (leg, begin) in zip(axes, begins.items(), strict=True):
        for rows, (time, error) in curves.items():
            some = (time > begin - 1) & (time < begin + 5)
            axis.plot(time[some] - begin, error[some], lw=1, label=ROWS[rows])
        axis.set_title(f"on the way {leg}")
        axis.set_xlabel("time since the glitch, s")
    axes[0].set_ylabel("tilt error, deg")
    axes[0].legend()
    write_figure(out / "wayback.png", figure)
