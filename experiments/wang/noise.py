"""Adaptive noise on a heading alone: a look each second, disturbances of 30 degrees for 4 and for 30 looks,
or none. RMS errors are those from a disturbance's first look until 20 looks after its last."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.table import Row, row
from pedjax import parameters
from pedjax.filters import adaptive, kalman, measurements
from pedjax.filters.adaptive import Adaptive
from pedjax.output import write_table
from pedjax.runtime import double_precision

COUNT, LOOKS = 200, 160
SIGMA, DRIFT = np.radians(2.0), np.radians(0.2)
"""Of a look, and of the gyroscope's yaw from one to the next."""
WRONG = np.radians(30.0)
LENGTHS = {"none": 0, "short": 4, "long": 30}
BEGINS = 60
LAWS: dict[str, dict[str, Any]] = {
    "fixed": {},
    "printed": {"law": "printed"},
    "trace": {"law": "trace"},
    "trace in deg^2": {"law": "trace", "scale": float(np.degrees(1.0) ** 2)},
    "windowed": {"law": "windowed"},
    "innovation": {"law": "innovation"},
    "innovation, hard": {"law": "innovation", "softness": 1e-3},
}
STUDENT = "student, 4 degrees"


@partial(jax.jit, static_argnames="tail")
def _filtered(
    p: Adaptive, true: jax.Array, turn: jax.Array, looks: jax.Array, tail: float
) -> tuple[Any, ...]:
    """Errors `(T, N)` rad, gains and noises of a filter of yaw alone."""
    like = jnp.zeros(looks.shape[1])
    zero = jnp.zeros((3, 3, looks.shape[1]))
    memory = adaptive.start(p, like)
    P = {"tt": zero.at[2, 2].set(SIGMA**2)}
    H = jnp.zeros((1, 3, looks.shape[1])).at[0, 2].set(1.0)

    def step(carry: Any, at: Any) -> Any:
        yaw, P, memory = carry
        turned, look = at
        yaw, P = yaw + turned, {"tt": P["tt"].at[2, 2].add(DRIFT**2)}
        rows = measurements.heading(look - yaw, H, jnp.full_like(yaw, SIGMA))
        noise = rows.noise[0, 0]
        if p.law != "none":
            memory, rows, _ = adaptive.adapted(p, memory, P, rows, jnp.ones_like(yaw))
        far = kalman.normalised_innovation(P, rows)
        weight = jnp.minimum((tail + 1) / (tail + far), 1.0)
        before = P["tt"][2, 2]
        P, correction = kalman.update(P, rows, weight)
        gain = weight * before / (weight * before + rows.noise[0, 0])
        return (yaw + correction["t"][2], P, memory), (
            yaw + correction["t"][2],
            gain,
            rows.noise[0, 0] / noise,
        )

    _, (yaw, gain, factor) = jax.lax.scan(step, (true[0], P, memory), (turn, looks))
    return yaw - true, gain, factor


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        return _run(seeds[0], out)


def _run(seed: int, out: Path) -> list[Row]:
    rng = np.random.default_rng([79, seed])
    true = np.cumsum(rng.normal(0, 0.3, (LOOKS, COUNT)), axis=0)
    turn = np.diff(true, axis=0, prepend=true[:1]) + rng.normal(0, DRIFT, (LOOKS, COUNT))
    look = true + rng.normal(0, SIGMA, (LOOKS, COUNT))
    found: dict[str, dict[str, tuple[np.ndarray, ...]]] = {}
    for law, changes in (*LAWS.items(), (STUDENT, {})):
        p = parameters.cast(parameters.replace(Adaptive(), changes), float)
        for kind, length in LENGTHS.items():
            wrong = look.copy()
            wrong[BEGINS : BEGINS + length] += WRONG
            given = (jnp.asarray(x) for x in (true, turn, wrong))
            tail = 4.0 if law == STUDENT else 1e9
            found.setdefault(law, {})[kind] = tuple(map(np.asarray, _filtered(p, *given, tail)))
    lines = []
    rms = {
        (law, kind): float(np.degrees(np.sqrt(np.mean(each[kind][0][BEGINS : BEGINS + length + 20] ** 2))))
        for law, each in found.items()
        for kind, length in LENGTHS.items()
    }
    for law in found:
        after = BEGINS + LENGTHS["short"] + 1  # the second look that fits
        short, none = found[law]["short"], found[law]["none"]
        back = float((short[1][after] >= 0.5 * none[1][after]).mean())
        least = min(float(each[2].min()) for each in found[law].values())
        lines.append(
            {"law": law, **{k: rms[law, k] for k in LENGTHS}, "gain_back": back, "least_noise_of_R": least}
        )
    write_table(out / "noise.csv", {key: [line[key] for line in lines] for key in lines[0]})
    rows = []
    for line in lines:
        told = ", ".join(f"{kind} {line[kind]:.2f}" for kind in LENGTHS)
        told += f" deg; gain back {line['gain_back']:.2f}"
        ours = line["law"] == "innovation"
        fixed = lines[0]
        quarter = line["short"] <= 0.25 * fixed["short"] and line["long"] <= 0.25 * fixed["long"]
        clean = line["none"] <= 1.25 * fixed["none"]
        good = quarter and clean and line["gain_back"] >= 0.9 and line["least_noise_of_R"] >= 1
        wanted = "a quarter; 1.25; gain back .9; never below R" if ours else "(beside it)"
        rows.append(row("NO", f"law {line['law']}", wanted, told, bool(good) if ours else None))
    return rows
