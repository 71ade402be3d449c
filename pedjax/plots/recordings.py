"""A recording as it came from the sensor."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from pedjax.recording import Recording


def raw_signals(recording: Recording, sensor: str) -> Figure:
    """Specific force, angular rate and field of one sensor over time, landmarks as ticks."""
    source = recording.sensor(sensor)
    panels = [
        ("specific force (m/s²)", source.accelerometer),
        ("angular rate (rad/s)", source.gyroscope),
    ]
    if source.magnetometer is not None:
        panels.append(("magnetic field (µT)", source.magnetometer))
    figure = Figure(figsize=(10, 2.4 * len(panels) + 0.6), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (label, stream) in zip(axes, panels, strict=True):
        for column, name, colour in zip(stream.values.T, "xyz", ("C3", "C2", "C0"), strict=True):
            ax.plot(stream.time, column, lw=0.6, color=colour, label=name)
        ax.plot(stream.time, np.linalg.norm(stream.values, axis=1), lw=0.6, color="0.2", label="norm")
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
        if recording.landmarks is not None:
            for t in recording.landmarks.time:
                ax.axvline(t, color="C1", lw=0.6, alpha=0.5)
    axes[0].legend(loc="upper right", ncols=4, fontsize=8)
    axes[-1].set_xlabel("time (s)" + (", landmarks orange" if recording.landmarks is not None else ""))
    figure.suptitle(f"{recording.name}: sensor '{sensor}'")
    return figure
