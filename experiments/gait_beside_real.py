"""Simulated gait beside real recordings: norms over a few strides, spectra, and figures that describe a gait.

    python -m experiments.gait_beside_real RECORDING... [--out DIR]

Each recording is compared with the simulated gait whose stride takes nearly as long. Nothing is fitted here:
it shows how far the defaults of `pedjax.simulation.footsteps.GAITS` are from a foot.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import pedjax
from experiments.gait_fit import period
from pedjax.output import folder, write_figure, write_table
from pedjax.simulation.footsteps import GAITS, Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import simulate

STILL = 0.6  # rad/s


def norms(recording: pedjax.Recording) -> tuple[float, np.ndarray, np.ndarray]:
    """Rate in Hz, norms of force and of angular rate while walking."""
    samples = pedjax.inertial(recording, next(iter(recording.sensors)))
    force = np.linalg.norm(samples.specific_force, axis=1)
    rate = np.linalg.norm(samples.angular_rate, axis=1)
    walking = np.flatnonzero(np.convolve(rate > 2.0, np.ones(int(samples.rate * 2)), "same") > 0)
    return samples.rate, force[walking[0] : walking[-1]], rate[walking[0] : walking[-1]]


def figures(recording: pedjax.Recording) -> dict[str, float]:
    """What describes a gait: percentiles, share of stillness, spectrum."""
    hz, force, rate = norms(recording)
    power = np.abs(np.fft.rfft((force - force.mean()) * np.hanning(len(force)))) ** 2
    share = np.cumsum(power) / power.sum()
    frequency = np.fft.rfftfreq(len(force), 1 / hz)
    found = {"stride_s": period(rate, hz) / hz}
    found |= {f"rate_p{q}_rad_per_s": float(np.percentile(rate, q)) for q in (15, 50, 90, 99)}
    found |= {f"force_p{q}_m_per_s2": float(np.percentile(force, q)) for q in (1, 50, 90, 99)}
    return {
        **found,
        "still_share": float((rate < STILL).mean()),
        "force_spectrum_median_hz": float(frequency[np.searchsorted(share, 0.5)]),
        "force_spectrum_p90_hz": float(frequency[np.searchsorted(share, 0.9)]),
    }


def simulated(gait: str, hz: float) -> pedjax.Recording:
    """A minute of that gait with the unit of the real walks."""
    leg = Leg(points=((0.0, 0.0), (60.0 * GAITS[gait].speed, 0.0)), gait=gait)
    scenario = Scenario(gait, legs=(leg,), sensors={"foot": "gx5"}, rate_hz=hz, field={"kind": "none"})
    return simulate(scenario, 1).recording


def beside(pairs: list[tuple[pedjax.Recording, pedjax.Recording]]) -> Figure:
    """Three seconds of each pair, real above simulated."""
    figure = Figure(figsize=(11, 2.6 * len(pairs)), layout="constrained")
    axes = figure.subplots(len(pairs), 2, squeeze=False, sharex=True)
    for row, pair in zip(axes, pairs, strict=True):
        for recording, label, colour in zip(pair, ("real", "simulated"), ("C0", "C1"), strict=True):
            hz, force, rate = norms(recording)
            first = int(np.argmax(rate[int(5 * hz) : int(7 * hz)])) + int(5 * hz)
            here = slice(first, first + int(3 * hz))
            time = np.arange(here.stop - here.start)[: len(force[here])] / hz
            row[0].plot(time, force[here], lw=0.8, color=colour, label=label)
            row[1].plot(time, rate[here], lw=0.8, color=colour, label=label)
        row[0].set_ylabel(
            f"{Path(pair[0].name).name.split('.')[0]}\n{pair[1].name.split(':')[0]}", fontsize=8
        )
        for ax in row:
            ax.grid(alpha=0.3)
    axes[0, 0].set_title("norm of the specific force (m/s²)", fontsize=10)
    axes[0, 1].set_title("norm of the angular rate (rad/s)", fontsize=10)
    axes[0, 1].legend(fontsize=8)
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--out", default="out")
    args = parser.parse_args()
    pedjax.configure()
    out = folder(args.out)
    gaits = {gait: simulated(gait, 200.0) for gait in ("slow", "walk", "fast", "run")}
    known = {gait: figures(made) for gait, made in gaits.items()}
    pairs, rows = [], []
    for path in args.recordings:
        real = pedjax.read(path)
        found = figures(real)
        gait = min(known, key=lambda g, f=found: abs(known[g]["stride_s"] - f["stride_s"]))
        pairs.append((real, gaits[gait]))
        for name, each in ((Path(path).name, found), (f"simulated {gait}", known[gait])):
            rows.append({"what": name, **each})
            print(f"{name:42}", *(f"{k} {v:.3g}" for k, v in each.items()), sep="  ")
    write_table(out / "gaits.csv", {key: [row[key] for row in rows] for key in rows[0]})
    write_figure(out / "gaits.png", beside(pairs))


if __name__ == "__main__":
    main()
