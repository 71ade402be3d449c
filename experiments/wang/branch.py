"""The triangle of earth, disturbance and measurement: 10,000 cases with a gyroscope within 20 degrees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from experiments.table import Row, row
from experiments.wang.stands import DIP, STRENGTH
from pedjax import parameters
from pedjax.filters import compensation
from pedjax.filters.compensation import Compensation
from pedjax.output import write_figure, write_table
from pedjax.runtime import double_precision

COUNT = 10_000
GYRO = np.radians(20.0)
LEVEL = STRENGTH * np.cos(DIP)
_chosen = jax.jit(compensation.chosen)


def cases(seed: int, noise: float) -> dict[str, np.ndarray]:
    """δ/H from .05 to .95 in any direction, the gyroscope's error `gyro` rad even within 20 degrees; what is
    `measured`, with that relative noise, and the plain compass's `innovation` rad (its error is that less
    the gyroscope's)."""
    rng = np.random.default_rng([73, seed])
    share, way = rng.uniform(0.05, 0.95, COUNT), rng.uniform(-np.pi, np.pi, COUNT)
    gyro = rng.uniform(-GYRO, GYRO, COUNT)
    seen = 1.0 + share * np.exp(1j * way)  # in units of H; the earth's along the real axis
    seen = seen * (1 + noise * rng.normal(size=COUNT))
    innovation = np.angle(np.exp(1j * (gyro - np.angle(seen))))  # what would turn the gyroscope's heading
    return {"share": share, "gyro": gyro, "measured": np.abs(seen), "innovation": innovation}


def _turned(case: dict[str, np.ndarray], softness: float, noise: float) -> np.ndarray:
    """The innovation that is chosen, rad: the right one is `gyro`."""
    p = parameters.cast(parameters.replace(Compensation(), {"softness": softness}), float)
    variance = GYRO**2 / 3 + np.radians(1.0) ** 2
    level = tuple(jnp.asarray(LEVEL * x) for x in (case["measured"], np.ones(COUNT), case["share"]))
    given: Any = (p, jnp.asarray(case["innovation"]), jnp.full(COUNT, variance), level)
    return np.asarray(_chosen(*given, jnp.asarray(max(noise, 1e-4) * LEVEL))[0])


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        return _run(seeds[0], out)


def _run(seed: int, out: Path) -> list[Row]:
    rows, lines = [], []
    for noise in (0.0, 0.01):
        case = cases(seed, noise)
        gyro, on = case["gyro"], case["share"] > 0.1
        lengths = (jnp.asarray(LEVEL * x) for x in (case["measured"], np.ones(COUNT), case["share"]))
        angle = np.asarray(compensation.sides(*lengths, jnp.asarray(1e-6))[0])
        both = np.stack([case["innovation"] - angle, case["innovation"] + angle])
        away = np.abs(_wrapped(both - gyro))
        right = away.argmin(axis=0) == np.abs(_wrapped(both)).argmin(axis=0)
        apart = angle > np.abs(gyro)
        hard, soft = (_turned(case, softness, noise) for softness in (1e-3, 1.0))
        errors = {
            "plain compass": case["innovation"] - gyro, "gyroscope": gyro,
            "hard choice": hard - gyro, "soft choice": soft - gyro,
        }  # fmt: skip
        rms = {k: float(np.degrees(np.sqrt(np.mean(_wrapped(e) ** 2)))) for k, e in errors.items()}
        lines.append({"noise": noise, **rms, "right": right.mean(), "right_where_apart": right[apart].mean()})
        if noise == 0:
            held = int((away.min(axis=0) < 1e-6).sum())
            rows.append(row("BR", "truth is one of the two", "all of 10,000", str(held), held == COUNT))
            over = np.abs(_wrapped(hard - gyro))[on] / np.maximum(np.abs(gyro[on]), 1e-3)
            what = "hard choice, error over the gyroscope's"
            rows.append(row("BR", what, "at most twice", f"{over.max():.3f}", bool(over.max() <= 2.0)))
            same = bool(np.allclose(soft[~on], case["innovation"][~on]))
            rows.append(row("BR", "below delta/H = 0.1", "as without", str(same), same))
        wanted, share = (1.0 if noise == 0 else 0.98), float(right[apart].mean())
        what = f"right side where acos K > gyro's error, {100 * noise:g} %"
        told = f"{100 * share:.2f} % ({100 * right.mean():.0f} % of all)"
        rows.append(row("BR", what, f"{100 * wanted:g} %", told, share >= wanted))
        told = ", ".join(f"{k} {v:.1f}" for k, v in rms.items())
        better = rms["soft choice"] < rms["hard choice"]
        rows.append(row("BR", f"rms, deg, noise {100 * noise:g} %", "soft below hard", told, better))
    write_table(out / "branch.csv", {key: [line[key] for line in lines] for key in lines[0]})
    _figure(seed, out)
    return rows


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * angle))


def _figure(seed: int, out: Path) -> None:
    case = cases(seed, 0.01)
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    ax = figure.subplots()
    edges = np.linspace(0.05, 0.95, 10)
    of = np.digitize(case["share"], edges) - 1
    shown = {
        "plain compass": case["innovation"], "hard choice": _turned(case, 1e-3, 0.01),
        "soft choice": _turned(case, 1.0, 0.01), "gyroscope": 0 * case["gyro"],
    }  # fmt: skip
    for name, turned in shown.items():
        error = _wrapped(turned - case["gyro"])
        rms = [np.degrees(np.sqrt(np.mean(error[of == k] ** 2))) for k in range(len(edges) - 1)]
        ax.plot(0.5 * (edges[1:] + edges[:-1]), rms, marker="o", ms=3, label=name)
    ax.set_xlabel("disturbance over the earth's level field")
    ax.set_ylabel("heading error (deg rms)")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    write_figure(out / "branch.png", figure)
