"""A simulated walk: the site and its field, the path, and what the sensors measured."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pedjax.simulation.world import Simulated

_CELLS = 160


def world_figure(made: Simulated, seconds: float = 6.0) -> Figure:
    """The strength of the field at the height of the first sensor with the path and landmarks in it, and some
    seconds of its signals with the stances shaded."""
    figure = Figure(figsize=(11, 9), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=[5, 6])
    upper, lower = parts
    place, truth = next(iter(made.truth.items()))
    site = upper.subplots()
    route = truth.motion.position
    low, high = route[:, :2].min(axis=0) - 3, route[:, :2].max(axis=0) + 3
    if made.scenario.field["kind"] != "none":
        strength = _strength(made, low, high, float(np.median(route[:, 2])))
        spread = np.percentile(strength, [1, 99])
        drawn = site.imshow(
            strength, origin="lower", extent=(low[0], high[0], low[1], high[1]), cmap="viridis",
            vmin=spread[0] - 0.5, vmax=spread[1] + 0.5, interpolation="bilinear",
        )  # fmt: skip
        upper.colorbar(drawn, cax=site.inset_axes((1.03, 0.1, 0.03, 0.8)), label="field (µT)")
    site.plot(route[:, 0], route[:, 1], color="white", lw=0.8)
    if made.recording.landmarks is not None:
        marks = made.recording.landmarks.position + route[0]
        site.plot(marks[:, 0], marks[:, 1], "rx", ms=6)
    site.set_aspect("equal")
    site.set_xlabel("east (m)")
    site.set_ylabel("north (m)")
    upper.suptitle(made.scenario.title or made.scenario.name, fontsize=10)  # wider than the map may be
    sensor = made.recording.sensors[place]
    streams = [("force (m/s²)", sensor.accelerometer), ("rate (rad/s)", sensor.gyroscope)]
    if sensor.magnetometer is not None:
        streams.append(("field (µT)", sensor.magnetometer))
    axes = lower.subplots(len(streams), 1, sharex=True, squeeze=False)[:, 0]
    begin = 0.5 * (truth.time[0] + truth.time[-1])
    for ax, (label, stream) in zip(axes, streams, strict=True):
        here = (stream.time >= begin) & (stream.time < begin + seconds)
        for k, axis in enumerate("xyz"):
            ax.plot(stream.time[here], stream.values[here, k], lw=0.8, label=axis)
        some = (truth.time >= begin) & (truth.time < begin + seconds)
        ax.fill_between(
            truth.time[some], 0, 1, where=truth.stance[some], transform=ax.get_xaxis_transform(), color="0.9"
        )
        ax.set_ylabel(label, fontsize=9)
        ax.grid(alpha=0.3)
    axes[0].legend(fontsize=8, ncols=3, loc="upper right")
    axes[-1].set_xlabel(f"time (s); sensor '{place}', stances shaded")
    return figure


def _strength(made: Simulated, low: np.ndarray, high: np.ndarray, height: float) -> np.ndarray:
    x, y = np.linspace(low[0], high[0], _CELLS), np.linspace(low[1], high[1], _CELLS)
    grid = np.stack([a.ravel() for a in np.meshgrid(x, y)])
    points = np.column_stack([grid.T, np.full(grid.shape[1], height)])
    return np.linalg.norm(made.field_at(points), axis=1).reshape(_CELLS, _CELLS)
