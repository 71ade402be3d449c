"""Figs. 3, 10 to 12, 15 and 16: three loops of an office, three rounds of a mall.

    python -m experiments.ma2018 office mall

Landmark errors after the best yaw and translation. QSF, iQSF and Ma have the thresholds that find 0.8 of the
quasi-static windows on straight parts of office loops (seeds 0 to 5), which is where the paper put its own;
its number, 170, is there as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

import pedjax
from experiments.ma2018 import presets
from experiments.ma2018.table import Row, row
from pedjax.output import write_figure
from pedjax.recording import nearest
from pedjax.scoring import aligned

FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ZUPT": ("ma2018_zupt", {}),
    "QSF": ("ma2018_qsf", {}),
    "iQSF": ("ma2018_iqsf", {}),
    "Ma": ("ma2018", {}),
    "iQSF at 170": ("ma2018_iqsf", {"field.iqsf.threshold": 170.0}),
    "Ma at 170": ("ma2018_published", {}),
    "vector": ("ma2018", {"field.detector": "vector", "compass.looking.levelling": "attitude"}),
}
"""Presets, and what else is changed."""


def walks(
    place: str, seeds: range
) -> tuple[dict[str, np.ndarray], dict[str, pedjax.Track], pedjax.Simulated]:
    """Mean, maximum, final landmark error in m and heading drift in deg of each filter, `(N, 4)`; the tracks
    and the world of the first seed."""
    found: dict[str, list[list[float]]] = {name: [] for name in FILTERS}
    tracks: dict[str, pedjax.Track] = {}
    first = None
    for seed in tqdm(seeds, place):
        made = pedjax.simulate(place, seed)
        first = first or made
        attitude = made.truth["foot"].motion.attitude[[0, -1]]
        yaw = np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])
        for name, (preset, changes) in FILTERS.items():
            track = presets.run(made.recording, preset, changes)
            score = presets.score(track, made.recording)
            drift = np.degrees(np.diff(track.euler[[0, -1], 2] - yaw)[0])
            found[name].append(
                [score.mean_2d_m, score.max_2d_m, score.final_2d_m, abs((drift + 180) % 360 - 180)]
            )
            if first is made:
                tracks[name] = track
    assert first is not None
    return {name: np.array(each) for name, each in found.items()}, tracks, first


def _error_rows(name: str, place: str, errors: dict[str, np.ndarray]) -> list[Row]:
    """What each filter leaves, in one line each."""
    return [
        row(
            name, f"{place}: {each}", "-",
            "mean {:.2f}, largest {:.1f}, end {:.2f} m, {:.0f} deg".format(*found.mean(axis=0)), None,
        )
        for each, found in errors.items()
    ]  # fmt: skip


def office(seeds: range, out: Path) -> list[Row]:
    """Figs. 3, 10 and 11."""
    errors, tracks, world = walks("office-loop", seeds)
    means = {name: each.mean(axis=0) for name, each in errors.items()}
    zupt, iqsf, ma = (means[name] for name in ("ZUPT", "iQSF", "Ma"))
    to_end, on_way = ((ma[k] / zupt[k], iqsf[k] / zupt[k]) for k in (2, 0))
    figure = Figure(figsize=(11, 9), layout="constrained")
    axes = figure.subplots(3, 1)
    truth = world.truth["foot"]
    strength = np.linalg.norm(truth.magnetic_field, axis=1)
    axes[0].plot(truth.time, strength, lw=0.6)
    axes[0].set(title="Fig. 3: strength of the field along the walk", xlabel="time (s)", ylabel="µT")
    _draw_tracks(axes[1], tracks, world)
    axes[1].set_title("Fig. 10: the office", fontsize=10)
    gyroscope, magnetic, time = _headings(tracks["Ma"])
    axes[2].plot(time, gyroscope, label="filter")
    axes[2].plot(time, magnetic, ".", ms=3, label="magnetic")
    axes[2].set(title="Fig. 11: headings of the first loop", xlabel="time (s)", ylabel="deg")
    axes[2].legend(fontsize=8)
    write_figure(out / "office.png", figure)
    apart = magnetic - gyroscope
    return [
        row("F3", "strength along the walk", "figure", f"{np.ptp(strength):.0f} µT from least to most", None),
        row(
            "F10", "office, end", "ZUPT 2 m and 14 deg; iQSF, Ma within 0.5 m",
            f"ZUPT {zupt[2]:.1f} m and {zupt[3]:.0f} deg; {iqsf[2]:.2f}, {ma[2]:.2f} m",
            bool(max(ma[2], iqsf[2]) < 0.5),
        ),
        row(
            "F10", "office, end: Ma, iQSF below 0.3 of ZUPT", "0.25",
            "{:.2f}, {:.2f} (mean {:.2f}, {:.2f})".format(*to_end, *on_way), max(to_end) < 0.3,
        ),
        *_error_rows("F10", "office", errors),
        row(
            "F11", "magnetic less filter heading, first loop", "figure",
            "median {:.1f}, 9 of 10 within {:.0f} deg".format(*np.percentile(abs(apart), (50, 90))), None,
        ),
    ]  # fmt: skip


def _headings(track: pedjax.Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the filter and of the field in deg, and the time, at the looks of the first of three loops."""
    at = np.flatnonzero(track.more["look"] > 0)
    at = at[: len(at) // 3]
    yaw = np.unwrap(track.euler[at, 2])
    return np.degrees(yaw), np.degrees(yaw + track.more["heading_innovation"][at]), track.time[at]


def mall(seeds: range, out: Path) -> list[Row]:
    """Figs. 12, 15 and 16; and the same in a mall with straight stretches."""
    errors, tracks, world = walks("mall", seeds)
    means = {name: each.mean(axis=0) for name, each in errors.items()}
    zupt, iqsf, ma = (means[name] for name in ("ZUPT", "iQSF", "Ma"))
    figure = Figure(figsize=(11, 12), layout="constrained")
    axes = figure.subplots(2, 1, height_ratios=(2, 1))
    _draw_tracks(axes[0], tracks, world)
    axes[0].set_title("Fig. 12: the mall", fontsize=10)
    marks = world.recording.landmarks
    assert marks is not None
    for name, track in tracks.items():
        estimate = aligned(track, world.recording, "yaw_translation")[nearest(track.time, marks.time)]
        apart = np.linalg.norm((estimate - marks.position)[:, :2], axis=1)
        axes[1].plot(apart, ".-", label=name)
    axes[1].set(
        title="Figs. 15, 16: error at each landmark", xlabel="landmark passed", ylabel="m", yscale="log"
    )
    axes[1].legend(fontsize=8)
    axes[1].grid(alpha=0.3)
    write_figure(out / "mall.png", figure)
    gentle = {name: each.mean(axis=0) for name, each in walks("mall-gentle", seeds)[0].items()}
    return [
        row(
            "F12", "mall: largest error", "iQSF 51 m, Ma 3 m",
            f"ZUPT {zupt[1]:.0f}, iQSF {iqsf[1]:.1f}, Ma {ma[1]:.1f} m", None,
        ),
        row(
            "F15,16", "mall: mean error", "iQSF 11.3 m, Ma 1.5 m",
            f"ZUPT {zupt[0]:.1f}, iQSF {iqsf[0]:.2f}, Ma {ma[0]:.2f} m", None,
        ),
        *(
            row("F15,16", f"mall: Ma below 0.3 of {name}", told, f"{ratio:.2f}", bool(ratio < 0.3))
            for name, told, ratio in (("ZUPT", "-", ma[0] / zupt[0]), ("iQSF", "0.13", ma[0] / iqsf[0]))
        ),
        *_error_rows("F15,16", "mall", errors),
        row(
            "F15,16", "mall with straight stretches: mean", "-",
            "ZUPT {:.1f}, iQSF {:.2f}, Ma {:.2f} m".format(*(gentle[n][0] for n in ("ZUPT", "iQSF", "Ma"))),
            None,
        ),
    ]  # fmt: skip


def _draw_tracks(axes: Axes, tracks: dict[str, pedjax.Track], world: pedjax.Simulated) -> None:
    true = world.recording.truth
    assert true is not None
    for name in ("ZUPT", "iQSF", "Ma"):
        path = aligned(tracks[name], world.recording, "yaw_translation")
        axes.plot(*path[:, :2].T, lw=0.7, label=name)
    axes.plot(*true.position[:, :2].T, "k--", lw=0.7, label="true")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.legend(fontsize=8)
