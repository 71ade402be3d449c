"""Figs. 3, 10 to 12, 15 and 16, drawn for one walk: three loops of an office, three rounds of a mall.

    python -m experiments.ma2018 figures

Landmark errors after the best yaw and translation. `spread` has the numbers of many walks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pedjax
from experiments import presets
from experiments.ma2018.spread import FILTERS
from experiments.table import Row, row
from pedjax.output import write_figure
from pedjax.recording import nearest
from pedjax.scoring import aligned

SHOWN = ("ZUPT", "iQSF", "Ma")


def _tracks(world: pedjax.Simulated) -> dict[str, pedjax.Track]:
    return {name: presets.run(world.recording, *FILTERS[name]) for name in SHOWN}


def run(seeds: range, out: Path) -> list[Row]:
    """The pictures, of the first seed."""
    return [*office(seeds[0], out), *mall(seeds[0], out)]


def office(seed: int, out: Path) -> list[Row]:
    """Figs. 3, 10 and 11."""
    world = pedjax.simulate("office-loop", seed)
    tracks = _tracks(world)
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


def mall(seed: int, out: Path) -> list[Row]:
    """Figs. 12, 15 and 16."""
    world = pedjax.simulate("mall", seed)
    tracks = _tracks(world)
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
    return [row("F12,15,16", "tracks, and error at each landmark", "figure", "figure", None)]


def _draw_tracks(axes: Axes, tracks: dict[str, pedjax.Track], world: pedjax.Simulated) -> None:
    true = world.recording.truth
    assert true is not None
    for name in SHOWN:
        path = aligned(tracks[name], world.recording, "yaw_translation")
        axes.plot(*path[:, :2].T, lw=0.7, label=name)
    axes.plot(*true.position[:, :2].T, "k--", lw=0.7, label="true")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.legend(fontsize=8)
