"""Munoz Diaz 2017, section 3.2: 12 rounds in Munich with a unit of medium cost, Figures 13 and 14.

Gravity alone; readings against the one before, from a magnetometer as it comes and from a calibrated one; and
the field as a state, which may estimate the hard iron while walking. The soft iron stays in either case.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.munoz_diaz.biases_told import COLOURS, band
from experiments.munoz_diaz.emulated import (
    IRON,
    MTW_BIAS,
    MTW_LENGTH,
    MTW_ROUNDS,
    MTW_TIME,
    MTW_WANDER,
    Emulated,
    Iron,
    mtw,
)
from experiments.munoz_diaz.lanes import Told
from experiments.munoz_diaz.scenes import SPREADS, Ready, Variant, yaw_error
from experiments.table import Row, row
from pedjax.output import write_figure, write_table
from pedjax.runtime import double_precision

STEP = 0.857
"""m, of a step at 1.76 m/s, by the distance and the strides on seeds 0 and 1."""
UNIT = {
    "process.gyroscope_bias": float(MTW_WANDER * np.sqrt(2 / MTW_TIME)),
    "steps.length": STEP,
    "reference.state.deviates": False,
}
"""How fast the unit's biases wander is known, as from its Allan deviation."""
PUBLISHED = Variant("munoz_diaz", UNIT)
GRAVITY = PUBLISHED.with_(**{"reference.form": "none"})
STATE = Variant("munoz_diaz_twin", UNIT)
WALKED = STATE.with_(**{"reference.state.iron": True, "reference.state.iron_sigma": 40.0})
SOFT = {"reference.state.deviates": True}
"""Soft iron, which turns with the body, passed off as a deviation of the field: 1.5 µT for 3 s as the package
has it, 0.5 µT for what a calibration leaves."""
RUNS: dict[str, tuple[Iron, Variant]] = {
    "gravity only": ("calibrated", GRAVITY),
    "published, calibrated": ("calibrated", PUBLISHED),
    "state, calibrated": ("calibrated", STATE),
    "state, calibrated, deviation": ("calibrated", STATE.with_(**SOFT, **{"reference.state.deviation": 0.5})),
    "published, raw": ("raw", PUBLISHED),
    "state, raw, hard iron while walking": ("raw", WALKED),
    "state, raw, hard iron and deviation": ("raw", WALKED.with_(**SOFT)),
    "published, no iron": ("none", PUBLISHED),
    "state, no iron": ("none", STATE),
}


class Walked(NamedTuple):
    """The walk with what iron leaves on the magnetometer."""

    iron: Iron
    length: float = MTW_LENGTH
    rounds: int = MTW_ROUNDS

    def made(self, seed: int) -> Emulated:
        return mtw(seed, self.iron, self.length, self.rounds)


class Found(NamedTuple):
    """A run, the true `bias (K, 3, R)` in rad/s, the yaw's error `(K, R)` and true `place (K, 3)` m."""

    told: Told
    bias: np.ndarray
    yaw: np.ndarray
    place: np.ndarray


Key = tuple[str, str]
"""Which run, and the spread of the first bias."""


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        found = everything(seeds)
    _write(found, out)
    return _rows(found)


def everything(seeds: range, names: Collection[str] = tuple(RUNS), **size: Any) -> dict[Key, Found]:
    found = {}
    for iron in ("calibrated", "raw", "none"):
        ready = Ready(Walked(iron, **size), seeds)
        for name, (own, variant) in RUNS.items():
            if own != iron or name not in names:
                continue
            more = ("hard_iron",) if "reference.state.iron" in variant.changes else ()
            for spread, sigma in SPREADS.items():
                told = ready.run(variant.with_(**{"initial.gyroscope_bias": float(sigma)}), more)
                yaw = yaw_error(told, ready.attitude)
                found[name, spread] = Found(told, ready.bias, yaw, ready.place)
    return found


def first_round(place: np.ndarray, rounds: int = MTW_ROUNDS) -> int:
    """At which block the first round is done: the way back comes nearest to the start."""
    each = len(place) / rounds
    some = slice(int(0.6 * each), int(1.4 * each))
    return some.start + int(np.linalg.norm(place[some, :2], axis=1).argmin())


def _path(position: np.ndarray) -> np.ndarray:
    """Length of the path `(K, 3, R)` in the plane, m."""
    return np.linalg.norm(np.diff(position[:, :2], axis=0), axis=1).sum(axis=0)


def _rows(found: dict[Key, Found]) -> list[Row]:
    made = []
    true = np.degrees(MTW_BIAS)
    wanted = {
        "gravity only": ("DI-F13a", "x, y fine; z not"),
        "published, raw": ("DI-F13b", "z -1.7, x swings to -0.5"),
        "published, calibrated": ("DI-F13c", "z slowly to -0.22, not reached"),
    }
    for (name, spread), each in found.items():
        end = np.degrees(each.told.bias[-1])
        error = end - np.degrees(each.bias[-1])
        told = ", ".join(band(end[axis], 3) for axis in range(3))
        which, published = wanted.get(name, ("DI-F13", "-"))
        far = np.median(np.abs(error), axis=-1)
        good = None
        if name == "gravity only":
            good = bool(max(far[:2]) < 0.02 < far[2])
        elif name == "published, raw":
            least = np.degrees(each.told.bias[:, 0]).min(axis=0)
            told += f"; x least {band(least, 2)}"
            good = bool(np.median(end[2]) < -1 and np.median(least) < -0.3)
        elif name == "published, calibrated":
            good = bool(far[2] < abs(true[2]) and max(far[:2]) < 0.02)
        made.append(row(which, f"{name}, {spread}: b at the end", published, told, good))
        sigma = each.told.sigma[:, 2]
        late = each.told.time > 60 if each.told.time[-1] > 120 else each.told.time > 0
        nees = (((each.told.bias[:, 2] - each.bias[:, 2]) / sigma)[late] ** 2).mean()
        asked = bool(0.5 <= nees <= 2) if name.startswith("state") else None
        made.append(
            row("DI-F13", "  NEES of z", "0.5 to 2" if asked is not None else "-", f"{nees:.2f}", asked)
        )
        if "hard_iron" in each.told.more:
            iron = each.told.more["hard_iron"][-1]
            told = ", ".join(band(iron[axis], 1) for axis in range(3))
            true_iron = "({})".format(", ".join(f"{x:g}" for x in IRON["raw"][0]))
            off = float(np.median(np.linalg.norm(iron - IRON["raw"][0][:, None], axis=0)))
            made.append(row("DI-F13", "  hard iron, uT", true_iron, f"{told}; off by {off:.1f}", None))
    return made + _track_rows(found)


_PUBLISHED_TRACKS = {
    "published, calibrated": (20.0, 30.0, 160.0),
    "gravity only": (50.0, 140.0, 270.0),
}


def _track_rows(found: dict[Key, Found]) -> list[Row]:
    made = []
    for (name, spread), each in found.items():
        k = first_round(each.place)
        yaw = np.abs(each.yaw[k]), np.abs(each.yaw[-1])
        away = np.linalg.norm(each.told.position[k, :2], axis=0)
        printed = _PUBLISHED_TRACKS.get(name)
        published = "{:.0f} deg, {:.0f} m, {:.0f} deg".format(*printed) if printed else "-"
        told = f"{band(yaw[0], 0)} deg, {band(away, 0)} m, {band(yaw[1], 0)} deg"
        made.append(row("DI-F14", f"{name}, {spread}: round 1, total", published, told, None))
    for spread in SPREADS:
        one, other = (found[name, spread] for name in ("published, calibrated", "gravity only"))
        k = first_round(one.place)
        better = [
            np.median(np.abs(one.yaw[k])) < np.median(np.abs(other.yaw[k])),
            np.median(np.abs(one.yaw[-1])) < np.median(np.abs(other.yaw[-1])),
        ]
        made.append(row("DI-F14", f"published before gravity, {spread}", "in round 1, in total",
                        ", ".join("yes" if x else "no" for x in better), bool(all(better))))  # fmt: skip
    walked = _path(found["published, calibrated", "0.57"].told.position) / 1e3
    made.append(row("DI-F14", "distance, km", "4.3", band(walked), bool(abs(np.median(walked) - 4.3) < 0.1)))
    return made


def _write(found: dict[Key, Found], out: Path) -> None:
    lines = []
    for (name, spread), each in found.items():
        k = first_round(each.place)
        line: dict[str, Any] = {"run": name, "first_sigma_deg_s": spread}
        for axis, letter in enumerate("xyz"):
            bias = np.degrees(each.told.bias[:, axis])
            line[f"{letter}_end"] = np.median(bias[-1])
            line[f"{letter}_least"], line[f"{letter}_most"] = np.median(bias.min(0)), np.median(bias.max(0))
        for what, at in (("round", k), ("total", -1)):
            line[f"yaw_{what}_deg"] = np.median(np.abs(each.yaw[at]))
            line[f"away_{what}_m"] = np.median(np.linalg.norm(each.told.position[at, :2], axis=0))
        line["km"] = np.median(_path(each.told.position)) / 1e3
        line["faults"] = int((each.told.status[-1] > 0).sum())
        lines.append(line)
    write_table(out / "trajectory.csv", {key: [line[key] for line in lines] for key in lines[0]})
    for spread in SPREADS:
        write_figure(out / f"fig13_{spread}.png", _traces(found, spread))
        write_figure(out / f"fig14_{spread}.png", _tracks(found, spread))


def _traces(found: dict[Key, Found], spread: str) -> Figure:
    names = ("gravity only", "published, raw", "published, calibrated", "state, calibrated, deviation",
             "state, raw, hard iron and deviation")  # fmt: skip
    figure = Figure(figsize=(3.6 * len(names), 3.2), layout="constrained")
    for ax, name in zip(figure.subplots(1, len(names)), names, strict=True):
        each = found[name, spread]
        minutes = each.told.time / 60
        for axis, colour in enumerate(COLOURS):
            low, middle, high = np.quantile(np.degrees(each.told.bias[:, axis]), [0.1, 0.5, 0.9], axis=-1)
            ax.fill_between(minutes, low, high, color=colour, alpha=0.25, lw=0)
            ax.plot(minutes, middle, color=colour, lw=1.1, label="xyz"[axis])
            ax.axhline(np.degrees(MTW_BIAS[axis]), color=colour, lw=0.6, ls=":")
        ax.set_title(name, fontsize=9)
        ax.set_xlabel("time (min)")
        ax.set_ylim(*((-2.0, 0.7) if name == "published, raw" else (-0.5, 0.3)))
        ax.grid(alpha=0.3)
    figure.axes[0].set_ylabel("bias (deg/s)")
    figure.axes[0].legend(fontsize=8)
    return figure


def _tracks(found: dict[Key, Found], spread: str, lane: int = 0) -> Figure:
    figure = Figure(figsize=(11, 5), layout="constrained")
    shown = {
        "gravity only": "C2",
        "published, calibrated": "m",
        "state, calibrated, deviation": "C0",
        "state, raw, hard iron and deviation": "C1",
    }
    for ax, which in zip(figure.subplots(1, 2), ("first round", "all"), strict=True):
        for name, colour in shown.items():
            each = found[name, spread]
            until = first_round(each.place) + 1 if which == "first round" else None
            ax.plot(*each.told.position[:until, :2, lane].T, color=colour, lw=0.9, label=name)
        ax.plot(*each.place[:until, :2].T, color="gold", lw=1.6, label="truth")
        ax.set_title(which, fontsize=10)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("east (m)")
        ax.set_ylabel("north (m)")
        ax.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=7)
    return figure
