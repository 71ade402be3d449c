"""Alignment of a stand: Figure 7, and what each method makes of disturbances that stay, pass or fade.

Errors of tilt and heading in deg of 200 stands of 5 s at random attitudes: seeded by TRIAD, and from random
first attitudes. Then whether strength and dip tell a wrong heading, and whether a later clean field does.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from experiments.table import Row, row
from experiments.wang import stands
from experiments.wang.stands import Made, errors, made
from pedjax.calibration import attitude
from pedjax.calibration.attitude import Align, Earth, Stand
from pedjax.output import write_figure, write_table
from pedjax.runtime import double_precision

COUNT = 200
CLEAN = {
    "clean, 0.03 m/s^2, 0.3 uT": (0.03, 0.3, False, 0.95),
    "clean, 0.01 m/s^2, 0.1 uT": (0.01, 0.1, False, 1.0),
    "clean, 0.03, 0.3 along each axis": (0.03, 0.3, True, None),
}
"""Biases of force and field, whether these are standard deviations along each axis or lengths, and the share
that is wanted within 0.5 deg of tilt and 2 deg of heading."""
CHANGING = {
    "passing 20": stands.passing(20.0),
    "first 4 s, 20": stands.until(20.0, 4.0),
    "last 1.5 s, 20": stands.last(20.0, 1.5),
}
CONSTANT = {f"constant {size:g}": stands.constant(size) for size in (5.0, 10.0, 20.0)}
WAYS: dict[str, tuple[str, dict[str, str]]] = {
    "triad": ("triad", {}),
    "weighted": ("weighted", {}),
    "gauss_newton": ("gauss_newton", {}),
    "gda": ("gda", {}),
    "gda fixed": ("gda", {"reference": "fixed"}),
    "agda": ("agda", {}),
    "agda fixed": ("agda", {"reference": "fixed"}),
}


@partial(jax.jit, static_argnames="method")
def _aligned(p: Align, method: str, stand: Stand, earth: Earth, first: jax.Array | None) -> attitude.Aligned:
    return attitude.aligned(p, method, stand, earth, first)


@partial(jax.jit, static_argnames="method")
def _path(p: Align, method: str, stand: Stand, earth: Earth, first: jax.Array | None) -> jax.Array:
    return attitude.path(p, method, stand, earth, first)


def found(
    given: Made, way: str, first: jax.Array | None = None
) -> tuple[attitude.Aligned, np.ndarray, np.ndarray]:
    """The alignment by a way, and its errors of tilt and heading in deg, both positive."""
    method, changes = WAYS[way]
    aligned = _aligned(stands.align(**changes), method, given.stand, given.earth, first)
    tilt, heading = errors(given, aligned.attitude)
    return aligned, tilt, np.abs(heading)


def auc(bad: np.ndarray, good: np.ndarray) -> float:
    """The chance that a bad one is larger than a good one."""
    order = np.argsort(np.concatenate([good, bad]), kind="stable")
    rank = np.empty(len(order))
    rank[order] = np.arange(1, len(order) + 1)
    n = len(bad)
    return float((rank[len(good) :].sum() - n * (n + 1) / 2) / (n * len(good)))


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        rows, lines = _accuracy(seeds[0])
        rows += _constant(seeds[0]) + _flag(seeds[0])
        _figure(seeds[0], out)
    write_table(out / "alignment.csv", {key: [line[key] for line in lines] for key in lines[0]})
    return rows


def _accuracy(seed: int) -> tuple[list[Row], list[Row]]:
    rows: list[Row] = []
    lines: list[Row] = []
    middles: dict[tuple[str, str], float] = {}
    cases: dict[str, tuple[stands.Disturbance | None, float, float, bool, float | None]]
    cases = {name: (None, *sizes) for name, sizes in CLEAN.items()}
    cases |= {name: (what, 0.03, 0.3, True, None) for name, what in (CONSTANT | CHANGING).items()}
    for name, (what, bias, iron, each_axis, wanted) in cases.items():
        given = made(seed, COUNT, what, force_bias=bias, iron=iron, each_axis=each_axis)
        for way in WAYS:
            aligned, tilt, heading = found(given, way)
            middles[name, way] = float(np.median(heading))
            within = float(((tilt < 0.5) & (heading < 2.0)).mean())
            lines.append(
                {
                    "disturbance": name, "way": way, "heading_median": np.median(heading),
                    "heading_p90": np.quantile(heading, 0.9), "heading_worst": heading.max(),
                    "tilt_median": np.median(tilt), "tilt_p90": np.quantile(tilt, 0.9), "within": within,
                    "told_sigma": np.degrees(np.sqrt(np.median(aligned.heading))),
                    "spread_of_last_second": np.degrees(np.median(aligned.spread[1])),
                }
            )  # fmt: skip
            if name.startswith("clean") and "fixed" not in way:
                limits = "within 0.5 deg tilt, 2 deg heading" + (f": {100 * wanted:g} %" if wanted else "")
                good = within >= wanted if wanted else None
                rows.append(row("AL", f"{name}: {way}", limits, f"{100 * within:.1f} %", good))
    first = stands.random_attitudes(seed, COUNT)
    given = made(seed, COUNT)
    for way in ("gda", "gda fixed", "agda", "agda fixed", "gauss_newton"):
        method, changes = WAYS[way]
        path = _path(stands.align(**changes), method, given.stand, given.earth, first)
        _, tilt, heading = found(given, way, first)
        off = int(((tilt > 20) | (heading > 20)).sum())
        time = jnp.cumsum(given.stand.dt, axis=0)
        when = np.asarray(attitude.converged(path, time, path[-1], np.radians(2.0)))
        late = float(np.quantile(when, 0.9))
        told = f"{off} beyond 20 deg; 90 % within 2 deg of the end after {late:.2f} s"
        good = off == 0 and late <= 3.5
        rows.append(row("AL", f"random first attitudes: {way}", "none; 90 % after 3.5 s", told, good))
    for name in CHANGING:
        weighted = middles[name, "weighted"]
        told = (
            f"weighted {weighted:.2f}, triad {middles[name, 'triad']:.2f}, gda {middles[name, 'gda']:.2f}, "
        )
        told += f"agda {middles[name, 'agda']:.2f}, agda fixed {middles[name, 'agda fixed']:.2f} deg"
        quarter = weighted <= 1.0 and weighted <= 0.25 * middles[name, "triad"]
        rows.append(row("AL", f"{name}: at most 1 deg, a quarter of triad", "median", told, quarter))
        half = weighted <= 0.5 * middles[name, "gda"]
        rows.append(
            row("AL", f"{name}: half of gda", "median", f"{weighted / middles[name, 'gda']:.2f}", half)
        )
    return rows, lines


def _constant(seed: int) -> list[Row]:
    rows = []
    for name, what in CONSTANT.items():
        given = made(seed, COUNT, what, force_bias=0.0, iron=0.0)
        by_triad, _, _ = found(given, "triad")
        _, reference = errors(given, by_triad.attitude)
        for way in ("weighted", "gauss_newton", "gda", "agda"):
            aligned, tilt, _ = found(given, way)
            _, heading = errors(given, aligned.attitude)
            apart = float(np.quantile(np.abs(heading - reference), 0.9))
            good = apart <= 0.1 and float(np.median(tilt)) <= 0.3
            told = f"90 % within {apart:.3f} deg of triad, tilt {np.median(tilt):.2f}"
            rows.append(row("AL", f"{name}: {way}", "0.1 deg; tilt 0.3", told, good))
        part = np.asarray(by_triad.disturbance)
        east = float(np.abs(part[0]).max())
        rows.append(
            row("AL", f"{name}: part across north that triad finds", "0", f"{east:.1e} uT", east < 1e-6)
        )
    return rows


def _flag(seed: int) -> list[Row]:
    """Strength and dip against a disturbed stand, and against a wrong heading."""
    rows = []
    clean = _told_odd(made(seed + 1000, COUNT))
    limit = float(np.quantile(clean, 0.95))
    for size in (2.0, 5.0, 10.0, 20.0):
        given = made(seed, COUNT, stands.constant(size))
        odd = _told_odd(given)
        _, _, heading = found(given, "triad")
        area = auc(odd, clean)
        off = heading > 5
        caught = float((odd[off] > limit).mean()) if off.any() else float("nan")
        told = f"AUC {area:.3f}; caught {100 * caught:.0f} % of {off.sum()}"
        good = (area >= 0.99 and not caught < 0.95) if size >= 5 else None
        rows.append(row("AL", f"disturbed by {size:g} uT, any direction", "AUC .99, 95 % at 5 %", told, good))
    level = stands.STRENGTH * np.cos(stands.DIP)
    angle = np.random.default_rng([67, seed]).uniform(-0.5, 0.5, COUNT)
    rotated = level * np.stack([-np.sin(angle), np.cos(angle) - 1, 0 * angle])
    given = made(seed, COUNT, stands.constant(1.0), direction=rotated)
    area = auc(_told_odd(given), clean)
    rows.append(
        row("AL", "level field only turned, up to 29 deg", "AUC .5: not seen", f"AUC {area:.3f}", None)
    )
    later = _later(seed)
    rows.append(row("AL", "same field later, Wang's check", "AUC .5", f"AUC {later['same']:.3f}", None))
    clean_later = later["carried"]
    rows.append(
        row("AL", "later clean field, carried back", "AUC .95", f"AUC {clean_later:.3f}", clean_later >= 0.95)
    )
    return rows


def _told_odd(given: Made) -> np.ndarray:
    up, field = (x.mean(axis=0) for x in (given.stand.force, given.stand.field))
    return np.asarray(attitude.oddity(up, field, given.earth))


def _later(seed: int) -> dict[str, float]:
    """Wang's check with a second stand in the same field, and the heading of a third, clean one carried back
    by a gyroscope (over 60 s, with a bias of 0.02 deg/s and 10 deg/sqrt(h)): which headings are 5 deg off?"""
    rng = np.random.default_rng([71, seed])
    size = rng.uniform(0, 10, COUNT)
    way = rng.normal(size=(3, COUNT))
    way = size * way / np.linalg.norm(way, axis=0)
    start = made(seed, COUNT, stands.constant(1.0), direction=way)
    aligned, _, heading = found(start, "triad")
    off = heading > 5
    again = made(seed + 1, COUNT, stands.constant(1.0), direction=way)
    turned = np.einsum("kij,klj->kil", np.moveaxis(np.asarray(aligned.attitude), -1, 0), start.attitude)
    second = jnp.asarray(np.moveaxis(np.einsum("kij,kjl->kil", turned, again.attitude), 0, -1))
    tau = attitude.left_over(again.stand.field.mean(axis=0), second, aligned.disturbance, start.earth)
    third = made(seed + 2, COUNT)
    _, later = errors(third, found(third, "triad")[0].attitude)
    _, first = errors(start, aligned.attitude)
    drift = np.degrees(rng.normal(0, np.radians(0.02) * 60, COUNT)) + rng.normal(
        0, 10 / 60 * np.sqrt(60 / 60), COUNT
    )
    carried = np.abs(later - (first + drift))
    score = np.asarray(jnp.abs(tau))
    return {"same": auc(score[off], score[~off]), "carried": auc(carried[off], carried[~off])}


def _figure(seed: int, out: Path) -> None:
    """Figure 7: attitude error and disturbance over the seconds of a stand that a car passes."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    panels = figure.subplots(1, 2)
    for ax, (name, what) in zip(
        panels, (("nothing", None), ("a car passes", stands.passing(20.0))), strict=True
    ):
        given = made(seed, COUNT, what, seconds=7.0)
        first = stands.random_attitudes(seed, COUNT)
        time = np.cumsum(np.asarray(given.stand.dt)[:, 0])
        for k, way in enumerate(("gda", "agda", "gauss_newton")):
            method, changes = WAYS[way]
            path = np.asarray(_path(stands.align(**changes), method, given.stand, given.earth, first))
            turn = np.einsum("nijk,kij->nk", path, given.attitude)
            angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
            low, middle, high = np.quantile(angle, [0.1, 0.5, 0.9], axis=1)
            ax.plot(time, middle, color=f"C{k}", label=way)
            ax.fill_between(time, low, high, color=f"C{k}", alpha=0.15, lw=0)
        _, tilt, heading = found(given, "weighted")
        ax.axhline(np.median(np.hypot(tilt, heading)), color="k", lw=1, ls="--", label="weighted, all of it")
        ax.set_yscale("log")
        ax.set_xlabel("seconds of standing")
        ax.set_ylabel("attitude error (deg), median and 10 to 90 %")
        ax.set_title(f"{name}; from random first attitudes", fontsize=10)
        ax.grid(alpha=0.3, which="both")
        ax.legend(fontsize=8)
    write_figure(out / "alignment.png", figure)
