"""Is a magnet that is put on a moving sensor found while it moves? BROAD's trials, with optical truth beside.

    python -m experiments.broad_magnets BROAD_FOLDER [--out DIR]

The filter sees gyroscope and magnetometer only. Its noises, and by how much the magnetometer is behind the
gyroscope, come from the two undisturbed trials, 02 and 21 (the lag is found anew here, without optics); no
number was chosen by the trials with a magnet attached, but for how long an estimate must hold was chosen
with 28, the magnet in the room, in sight. The truth is what is left of the readings when the field of 02 and
21, turned by the optical attitude, is taken away. A magnet is there when its offset stays within `NEAR` µT
of the new one. While the board lies still an offset cannot be told from a field, so delays count from when
the magnet is there and the board turns.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import pedjax
from pedjax import parameters, rotations
from pedjax.errors import InputError
from pedjax.filters.hard_iron import HardIron, HardIronParameters, OffsetStep, offset_steps, track_hard_iron
from pedjax.output import folder, write_figure, write_table
from pedjax.recording import Recording
from pedjax.runtime import double_precision

UNDISTURBED = ("02_", "21_")
LAGS = np.arange(0.0, 0.031, 0.003)
NEAR = 2.5  # µT
SMALLEST = 3.0  # µT, of a true step
TURNS = 0.5  # rad/s, from which on a board turns


class Signals(NamedTuple):
    """What the filter sees: `time`, `dt` (T,) s, `rate` rad/s and `reading` µT (T, 3)."""

    time: np.ndarray
    dt: np.ndarray
    rate: np.ndarray
    reading: np.ndarray


class Switch(NamedTuple):
    """A true step of the offset: when it begins, is done, can be seen by turning, and the offset after it."""

    begins: float
    done: float
    seen: float
    offset: np.ndarray


class Found(NamedTuple):
    """One trial: its truth `residual (T, 3)` and `switches`, the filter's track, and the steps told of."""

    signals: Signals
    residual: np.ndarray
    switches: list[Switch]
    track: HardIron
    steps: list[OffsetStep]


def signals_of(recording: Recording) -> Signals:
    hand = recording.sensors["hand"]
    if hand.magnetometer is None:
        raise InputError(f"{recording.name}: has no magnetometer")
    time = hand.gyroscope.time
    dt = np.diff(time, prepend=2 * time[0] - time[1])
    return Signals(time, dt, hand.gyroscope.values, hand.magnetometer.values)


def lag_of(every: list[Signals], piece_s: float = 1.0) -> float:
    """By how many s the magnetometer is behind: the lag with which a field that only turns, and an offset,
    fit pieces of the recordings best."""
    misfit = np.zeros(len(LAGS))
    for signals in every:
        size = round(piece_s / float(np.median(signals.dt)))
        pieces = len(signals.time) // size
        moving = (np.abs(signals.rate[: pieces * size]).max(axis=1) > TURNS).reshape(pieces, size).all(axis=1)
        reading = signals.reading[: pieces * size].reshape(pieces, size, 3)[moving]
        for i, lag in enumerate(LAGS):
            late = [np.interp(signals.time - lag, signals.time, rate) for rate in signals.rate.T]
            turns = np.asarray(rotations.exp(jnp.asarray(late * signals.dt[None])), float).transpose(2, 0, 1)
            turns = turns[: pieces * size].reshape(pieces, size, 3, 3)[moving]
            design = np.empty((len(turns), size, 3, 6))
            attitude = np.broadcast_to(np.eye(3), (len(turns), 3, 3))
            for k in range(size):
                attitude = attitude @ turns[:, k]
                design[:, k] = np.concatenate(
                    [attitude.swapaxes(1, 2), np.broadcast_to(np.eye(3), (len(turns), 3, 3))], 2
                )
            flat, wanted = design.reshape(len(turns), -1, 6), reading.reshape(len(turns), -1, 1)
            fitted = flat @ (np.linalg.pinv(flat) @ wanted)
            misfit[i] += np.sum((wanted - fitted) ** 2)
    curve = np.polyfit(LAGS, misfit, 2)
    return float(-curve[1] / (2 * curve[0]))


def attitudes(recording: Recording, lag: float) -> np.ndarray:
    """Optical body-to-room attitude `(T, 3, 3)`, as late as the magnetometer; NaN where it was lost."""
    if recording.truth is None or recording.truth.quaternion is None:
        raise InputError(f"{recording.name}: has no optical attitude")
    every = float(np.median(np.diff(recording.truth.time)))
    turned = np.asarray(rotations.from_quaternion(jnp.asarray(recording.truth.quaternion.T))).transpose(
        2, 0, 1
    )
    shift = round(lag / every)
    return np.concatenate([np.repeat(turned[:1], shift, axis=0), turned[: len(turned) - shift]])


def earth_field(recordings: list[Recording], lag: float) -> np.ndarray:
    """Mean field in the room `(3,)` µT."""
    fields = []
    for recording in recordings:
        fields.append(np.einsum("nij,nj->ni", attitudes(recording, lag), signals_of(recording).reading))
    return np.nanmean(np.concatenate(fields), axis=0)


def medians(time: np.ndarray, values: np.ndarray, seconds: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    """Medians of what is known in each interval, and its middle."""
    size = round(seconds / float(np.median(np.diff(time))))
    count = len(time) // size
    blocks = values[: count * size].reshape(count, size, -1)
    known = np.isfinite(blocks).all(axis=2).any(axis=1)
    middle = time[: count * size].reshape(count, size).mean(axis=1)
    return middle[known], np.array([np.nanmedian(b, axis=0) for b in blocks[known]])


def switches_of(signals: Signals, residual: np.ndarray) -> list[Switch]:
    """A magnet put on and taken off again, if there is one: the board is without it in the first fifth and
    the last quarter of a trial, and with it before the middle."""
    time, offset = medians(signals.time, residual)
    part = (time - time[0]) / np.ptp(time)
    plain = np.median(offset[(part < 0.2) | (part > 0.75)], axis=0)
    magnet = np.median(offset[(part > 0.3) & (part < 0.5)], axis=0)
    apart = magnet - plain
    if np.linalg.norm(apart) < SMALLEST:
        return []
    has = (offset - plain) @ apart > 0.5 * apart @ apart
    on, off = np.flatnonzero(has)[[0, -1]]
    switches = []
    for old, new, at in ((plain, magnet, on), (magnet, plain, off + 1)):
        early = np.flatnonzero(np.linalg.norm(offset[:at] - old, axis=1) < NEAR)[-1]
        reached = np.linalg.norm(offset - new, axis=1) < NEAR
        late = next((k for k in range(at, len(time)) if reached[k : k + 3].all()), len(time) - 1)
        turning = np.linalg.norm(signals.rate, axis=1) > TURNS
        seen = signals.time[np.flatnonzero(turning & (signals.time >= time[late]))[0]]
        switches.append(Switch(time[early], time[late], float(seen), new))
    return switches


def find(recording: Recording, lag: float, earth: np.ndarray) -> Found:
    """A trial through the filter, and its truth."""
    signals = signals_of(recording)
    residual = signals.reading - np.einsum("nji,j->ni", attitudes(recording, lag), earth)
    params = parameters.replace(HardIronParameters(), {"lag": lag})
    with double_precision():
        params = parameters.cast(params, jnp.float64)
        track = jax.tree.map(np.asarray, _tracked(signals.rate, signals.reading, signals.dt, params))
    return Found(signals, residual, switches_of(signals, residual), track, offset_steps(signals.time, track))


_tracked = jax.jit(track_hard_iron)


def matched(found: Found) -> list[tuple[Switch | None, OffsetStep | None]]:
    """Each true step with the first one told of between its begin and the next one's; then what is left."""
    pairs: list[tuple[Switch | None, OffsetStep | None]] = []
    left = list(found.steps)
    for i, switch in enumerate(found.switches):
        end = found.switches[i + 1].begins if i + 1 < len(found.switches) else np.inf
        mine = next((step for step in left if switch.begins <= step.time < end), None)
        left = [step for step in left if step is not mine]
        pairs.append((switch, mine))
    return pairs + [(None, step) for step in left]


def draw(results: dict[str, Found]) -> Figure:
    figure = Figure(figsize=(11, 2.3 * len(results)), layout="constrained")
    for ax, (name, found) in zip(
        figure.subplots(len(results), 1, squeeze=False)[:, 0], results.items(), strict=True
    ):
        time, truth = medians(found.signals.time, found.residual)
        for axis, colour in enumerate(("C0", "C1", "C2")):
            offset, sigma = found.track.offset[::20, axis], found.track.sigma[::20, axis]
            ax.plot(time, truth[:, axis], ".", color=colour, ms=2, alpha=0.5)
            ax.plot(found.signals.time[::20], offset, color=colour, lw=1.2, label="xyz"[axis])
            ax.fill_between(
                found.signals.time[::20],
                offset - 2 * sigma,
                offset + 2 * sigma,
                color=colour,
                alpha=0.15,
                lw=0,
            )
        for step in found.steps:
            ax.axvline(step.time, color="k", lw=0.8, ls="--")
        low, high = min(truth.min(), -4.0), max(truth.max(), 4.0)
        ax.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))
        ax.set_ylabel("offset (µT)")
        ax.set_title(name, fontsize=9, loc="left")
        ax.grid(alpha=0.3)
    ax.set_xlabel("time (s); dots: optical truth, lines: filter with 2 sigma, dashed: step told")
    figure.axes[0].legend(fontsize=7, ncols=3)
    return figure


def row_of(name: str, found: Found, switch: Switch | None, step: OffsetStep | None) -> dict[str, str]:
    """One line of the table; `then` is the error of the estimate 3 s after the board turns."""
    row = dict.fromkeys(
        (
            "trial",
            "begins_s",
            "there_s",
            "turns_s",
            "found_s",
            "delay_s",
            "true_ut",
            "found_ut",
            "error_ut",
            "then_ut",
        ),
        "",
    )
    row["trial"], row["found_s"] = name[:32], "none"
    if switch is not None:
        row |= {
            "begins_s": f"{switch.begins:.1f}",
            "there_s": f"{switch.done:.1f}",
            "turns_s": f"{switch.seen:.1f}",
        }
        row["true_ut"] = " ".join(f"{x:.1f}" for x in switch.offset)
        then = found.track.offset[np.searchsorted(found.signals.time, switch.seen + 3.0)]
        row["then_ut"] = f"{np.linalg.norm(then - switch.offset):.1f}"
    if step is not None:
        row |= {"found_s": f"{step.time:.1f}", "found_ut": " ".join(f"{x:.1f}" for x in step.after)}
    if switch is not None and step is not None:
        row["delay_s"] = f"{step.time - switch.seen:.1f}"
        row["error_ut"] = f"{np.linalg.norm(step.after - switch.offset):.1f}"
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/broad_magnets"))
    args = parser.parse_args()
    out = folder(args.out)
    recordings = {path.stem: pedjax.read(str(path)) for path in sorted(args.folder.glob("*.mat"))}
    plain = [r for name, r in recordings.items() if name.startswith(UNDISTURBED)]
    if not plain:
        raise InputError(
            f"{args.folder}: no undisturbed trial ({', '.join(UNDISTURBED)}) to take the field from"
        )
    lag = lag_of([signals_of(recording) for recording in plain])
    earth = earth_field(plain, lag)
    print(
        f"undisturbed trials: magnetometer late by {1e3 * lag:.1f} ms, field in the room {earth.round(1)} µT"
    )
    results = {name: find(recording, lag, earth) for name, recording in recordings.items()}
    rows = [
        row_of(name, found, switch, step)
        for name, found in results.items()
        for switch, step in matched(found) or [(None, None)]
    ]
    widths = {key: max(len(key), *(len(row[key]) for row in rows)) for key in rows[0]}
    print(*(key.ljust(width) for key, width in widths.items()))
    for row in rows:
        print(*(row[key].ljust(width) for key, width in widths.items()))
    write_table(out / "broad_magnets.csv", {key: [row[key] for row in rows] for key in rows[0]})
    write_figure(out / "broad_magnets.png", draw(results))


if __name__ == "__main__":
    main()
