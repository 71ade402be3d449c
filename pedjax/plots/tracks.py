"""A track on the floor, and the stance decisions behind it."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pedjax.recording import Clock, Recording, inertial
from pedjax.running import Track
from pedjax.scoring import Score, aligned
from pedjax.walks import points_of

Other = tuple[str, Track]


def trajectory(
    track: Track,
    recording: Recording,
    score: Score | None = None,
    alignment: str = "auto",
    other: Other | None = None,
) -> Figure:
    """The aligned path from above with landmarks and error lines, and its height; `other` is a second track
    (such as before tuning) drawn thin."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    plan, profile = figure.subplots(2, 1, height_ratios=[4, 1])
    path = aligned(track, recording, alignment)
    if other is not None:
        before = aligned(other[1], recording, alignment)
        plan.plot(before[:, 0], before[:, 1], color="0.6", lw=0.8, label=other[0])
        profile.plot(track.time, before[:, 2], color="0.6", lw=0.8)
    plan.plot(path[:, 0], path[:, 1], color="C0", lw=1.2, label=track.system if other is None else "after")
    plan.plot(*path[0, :2], "o", color="C2", ms=7, label="start")
    plan.plot(*path[-1, :2], "s", color="C3", ms=6, label="end")
    index, position = points_of(recording, track.time, None, track.sensor)
    if len(index):
        if recording.landmarks is None:
            plan.plot(position[:, 0], position[:, 1], color="k", lw=0.9, ls="--", label="truth")
        else:
            plan.plot(position[:, 0], position[:, 1], "x", color="k", ms=6, label="landmark")
            lines = LineCollection(
                list(np.stack([path[index, :2], position[:, :2]], axis=1)), colors="C1", lw=1.2
            )
            plan.add_collection(lines)
        profile.plot(track.time[index], position[:, 2], "k.", ms=3)
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel("x (m)")
    plan.set_ylabel("y (m)")
    plan.grid(alpha=0.3)
    plan.legend(fontsize=8)
    profile.plot(track.time, path[:, 2], color="C0", lw=1)
    profile.set_xlabel("time (s)")
    profile.set_ylabel("height (m)")
    profile.grid(alpha=0.3)
    title = f"{track.name}, {track.distance:.0f} m"
    if score is not None and score.rms_2d_m is not None:
        how = score.alignment.replace("_", " and ")
        title += f": RMS {score.rms_2d_m:.2f} m, final {score.final_2d_m:.2f} m ({how})"
    figure.suptitle(title)
    return figure


def gate_over_signals(
    track: Track,
    recording: Recording,
    gate: str = "stance",
    clock: Clock | None = None,
    seconds: float = 12.0,
) -> Figure:
    """Norms of force and rate, a gate's statistic over its threshold, and shaded where it is open: the whole
    walk of the statistic, and a stretch of the rest that can be read."""
    imu, shown = inertial(recording, track.sensor, clock), track.gate(gate)
    decades = np.clip(shown.log_ratio / np.log(10), -4, 4)
    time = track.time
    middle = 0.5 * (time[0] + time[-1])
    begin = max(time[0], middle - seconds / 2)
    near = (time >= begin) & (time <= begin + seconds)
    if near.sum() < 2:  # the middle of the walk is a gap
        near = np.arange(len(time)) < max(int(seconds / np.median(np.diff(time))), 2)
        begin = time[0]
    figure = Figure(figsize=(10, 7.5), layout="constrained")
    force, rate, ratio, whole = figure.subplots(4, 1)
    still = shown.open
    for ax, signal, label in (
        (force, np.linalg.norm(imu.specific_force, axis=1), "force (m/s²)"),
        (rate, np.linalg.norm(imu.angular_rate, axis=1), "rate (rad/s)"),
        (ratio, decades, "log₁₀ statistic\n/ threshold"),
    ):
        ax.plot(time[near], signal[near], lw=0.9, color="C0")
        ax.fill_between(
            time[near],
            0,
            1,
            where=still[near],
            transform=ax.get_xaxis_transform(),
            color="C2",
            alpha=0.25,
            lw=0,
        )
        ax.set_ylabel(label)
        ax.set_xlim(time[near][0], time[near][-1])
        ax.grid(alpha=0.3)
    ratio.axhline(0, color="k", lw=0.8)
    ratio.set_xlabel(f"time (s), {gate} green")
    whole.plot(time, decades, lw=0.5, color="C0")
    whole.axhline(0, color="k", lw=0.8)
    whole.axvspan(begin, begin + seconds, color="C1", alpha=0.2, lw=0)
    whole.set_xlabel("time (s), the whole walk; the stretch above is shaded")
    whole.set_ylabel("log₁₀ ratio")
    whole.grid(alpha=0.3)
    figure.suptitle(f"{track.name}: {100 * still.mean():.0f} % {gate}")
    return figure
