"""Figures 8 to 12: walks outdoors, by exact truth and by a GPS of 1 m.

A rectangle, a circle and an irregular path with bumps of the field along the way, after a clean start, with
the gyroscope as Table 1 has it and with a calibrated one; the same after a disturbed start; and figures of
eight that a car passes while the walker stands, or with one disturbance all the way. Errors are RMS in the
plane, m; nothing is aligned to the truth.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import pedjax
from experiments.table import Row, row
from experiments.wang import made
from pedjax.output import write_figure, write_table
from pedjax.runtime import default_cache

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "ZUPT": ("wang_basic", {}),
    "ZUPT + start": ("wang_agda", {}),
    "ZUPT + start, rest": ("wang_agda", {"initial.bias": "rest"}),
    "alpha zero": ("wang_alpha_zero", {}),
    "improved": ("wang", {}),
    "improved, law as printed": ("wang", {"compass.adaptive.law": "trace"}),
    "best": ("wang_best", {}),
    "best, no rest": ("wang_best", {"initial.bias": "zero"}),
}
"""Preset and changes. `rest`: the mean rate of the stand is the gyroscope's first bias."""


class Condition(NamedTuple):
    """Which paths, how well the sensor is calibrated, and the field beside the earth's; `along` µT is there
    all the way, in a direction of its own, whenever the foot stands."""

    paths: tuple[str, ...]
    calibrated: float = 0.0
    field: Mapping[str, float] = {}
    along: float = 0.0


CONDITIONS = {
    "changing": Condition(made.PATHS),
    "changing, calibrated gyro": Condition(made.PATHS, calibrated=0.95),
    "disturbed start": Condition(made.PATHS, field={"start": 15.0}),
    "car while standing": Condition(("figure-eight",), field={"bumps": 0, "car": 20.0}),
    "constant": Condition(("figure-eight",), field={"bumps": 0}, along=5.0),
}


def errors(condition: str, path: str, seed: int) -> dict[str, made.Error]:
    """Of every variant on one walk."""
    how = CONDITIONS[condition]
    walked = made.walk(path, seed, how.calibrated, how.along, **how.field)
    return {
        name: made.error(walked, made.run(walked, preset, changes, seed), seed)
        for name, (preset, changes) in VARIANTS.items()
    }


def _begin() -> None:
    pedjax.configure(cache=default_cache())


def run(seeds: range, out: Path) -> list[Row]:
    found: dict[tuple[str, str], list[dict[str, made.Error]]] = {}
    jobs = [(name, path, seed) for name, how in CONDITIONS.items() for path in how.paths for seed in seeds]
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn"), _begin) as pool:
        results = pool.map(errors, *zip(*jobs, strict=True))
        for (name, path, _), one in zip(jobs, tqdm(results, "walks", len(jobs)), strict=True):
            found.setdefault((name, path), []).append(one)
    _write(found, out)
    for path in made.PATHS:
        _figure(path, seeds[0], out)
    return _rows(found)


def _of(each: list[dict[str, made.Error]], variant: str, kind: str) -> np.ndarray:
    return np.array([getattr(one[variant], kind) for one in each])


def _write(found: dict[tuple[str, str], list[dict[str, made.Error]]], out: Path) -> None:
    lines = []
    for (name, path), each in found.items():
        for variant in VARIANTS:
            exact, gps, end = (_of(each, variant, kind) for kind in ("exact", "gps", "end"))
            zero = _of(each, "alpha zero", "exact")
            lines.append(
                {
                    "condition": name, "path": path, "variant": variant, "walks": len(each),
                    "rms_median_m": np.median(exact), "rms_p10_m": np.quantile(exact, 0.1),
                    "rms_p90_m": np.quantile(exact, 0.9), "rms_worst_m": exact.max(),
                    "gps_median_m": np.median(gps), "end_median_m": np.median(end),
                    "better_than_alpha_zero": (exact < zero).mean(),
                }
            )  # fmt: skip
    write_table(out / "walks.csv", {key: [line[key] for line in lines] for key in lines[0]})


def _rows(found: dict[tuple[str, str], list[dict[str, made.Error]]]) -> list[Row]:
    rows = []
    for (name, path), each in found.items():
        for kind in ("exact", "gps"):
            middle = {v: float(np.median(_of(each, v, kind))) for v in VARIANTS}
            told = ", ".join(
                f"{middle[v]:.2f}" for v in ("ZUPT", "ZUPT + start", "alpha zero", "improved", "best")
            )
            ordered = middle["improved"] < middle["ZUPT + start"] < middle["ZUPT"]
            wanted = "ZUPT > + start > improved (zero, best beside)"
            asked = name in ("changing", "car while standing")
            rows.append(row("WA", f"{name}, {path}, {kind}", wanted, told, ordered if asked else None))
            better = {v: float((_of(each, v, kind) < _of(each, "alpha zero", kind)).mean()) for v in VARIANTS}
            told = f"{100 * better['improved']:.0f} %; best {100 * better['best']:.0f} %"
            needed = "changing" in name
            good = better["improved"] >= 0.9 if needed else None
            rows.append(row("WA", "  better than alpha zero", "improved on 90 %", told, good))
        if name == "disturbed start":
            told = ", ".join(
                f"{v} {np.median(_of(each, v, 'exact')):.2f}" for v in ("alpha zero", "improved", "best")
            )
            best = np.median(_of(each, "best, no rest", "exact"))
            others = [np.median(_of(each, v, "exact")) for v in ("alpha zero", "improved")]
            rows.append(row("WA", f"{name}, {path}", "best below both", told, bool(best < min(others))))
    return rows


def _figure(path: str, seed: int, out: Path) -> None:
    """Track, yaw and disturbance of one walk, as Figures 10 to 12."""
    walked = made.walk(path, seed)
    figure = Figure(figsize=(13, 4.4), layout="constrained")
    track, yaw, field = figure.subplots(1, 3)
    truth = walked.truth["foot"]
    place = truth.motion.position[:, :2] - truth.motion.position[0, :2]
    track.plot(*place.T, "k", lw=1.2, label="truth")
    for k, name in enumerate(("ZUPT", "ZUPT + start", "alpha zero", "improved", "best")):
        found = made.run(walked, *VARIANTS[name], seed)
        track.plot(*found.position[:, :2].T, color=f"C{k}", lw=0.9, label=name)
        yaw.plot(found.time - found.time[0], made.yaw_error(walked, found), color=f"C{k}", lw=0.8, label=name)
    size = np.linalg.norm(truth.magnetic_field, axis=1) / made.EARTH["compass.strength"] - 1
    field.plot(truth.time - truth.time[0], size, lw=0.7)
    track.set_aspect("equal")
    track.set_xlabel("east (m)")
    track.set_ylabel("north (m)")
    yaw.set_xlabel("time (s)")
    yaw.set_ylabel("error of yaw (deg)")
    field.set_xlabel("time (s)")
    field.set_ylabel("strength over the earth's, less 1")
    for ax in (track, yaw, field):
        ax.grid(alpha=0.3)
    track.legend(fontsize=7)
    write_figure(out / f"walk_{path}.png", figure)
