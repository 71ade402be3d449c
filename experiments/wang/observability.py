"""Theorem 1: how many of the states a standing foot tells, by the rank of the observability matrix.

Of the filter's own F and H. The paper says 5 of 15; that is the rank of nine states without biases.
"""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from experiments.table import Row, row
from pedjax import rotations
from pedjax.filters import covariance
from pedjax.filters.covariance import STATES, ProcessNoise
from pedjax.output import write_table
from pedjax.runtime import double_precision

WANTED = {
    ("zero velocity",): 8,
    ("zero velocity", "heading"): 10,
    ("zero velocity", "heading", "position"): 13,
    ("zero velocity", "zero angular rate"): 9,
}
NINE = "tpv"
MEASURED = {"zero velocity": "v", "position": "p", "zero angular rate": "g"}


def transition(states: str, dt: float = 0.01) -> np.ndarray:
    """F of the inertial filter for a foot that stands, leaning, with random walks for biases."""
    attitude = rotations.from_euler(jnp.asarray(0.1), jnp.asarray(0.4), jnp.asarray(0.7))
    never = jnp.asarray(1e30)
    noise = ProcessNoise(*(jnp.asarray(0.0),) * 4, never, never)
    F = covariance.inertial_transition(attitude, jnp.array([0.0, 0.0, 9.81]), jnp.asarray(dt), noise)
    whole = np.zeros((3 * len(states), 3 * len(states)))
    for i, a in enumerate(states):
        for j, b in enumerate(states):
            if b in F[a]:
                block = F[a][b]
                one = np.eye(3) if block is None else np.asarray(block)
                whole[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = one if one.ndim else float(one) * np.eye(3)
    return whole


def measured(name: str, states: str) -> np.ndarray:
    """H."""
    rows = np.zeros((1 if name == "heading" else 3, 3 * len(states)))
    if name == "heading":
        rows[0, 3 * states.index("t") + 2] = 1.0
    else:
        k = 3 * states.index(MEASURED[name])
        rows[:, k : k + 3] = np.eye(3)
    return rows


def rank(measurements: tuple[str, ...], states: str = STATES) -> int:
    """Of [H; H A; H A²; ...] with A = (F − I)/dt, so that its powers are all of one size."""
    dt = 0.01
    A = (transition(states, dt) - np.eye(3 * len(states))) / dt
    H = np.concatenate([measured(name, states) for name in measurements])
    parts = [H]
    for _ in range(3 * len(states) - 1):
        parts.append(parts[-1] @ A)
    whole = np.concatenate(parts)
    return int(np.linalg.matrix_rank(whole, tol=1e-8 * np.linalg.norm(whole, 2)))


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        rows = [
            row("OB", f"15 states, {', '.join(names)}", str(wanted), str(rank(names)), rank(names) == wanted)
            for names, wanted in WANTED.items()
        ]
        nine = rank(("zero velocity",), NINE)
    rows.append(row("OB", "9 states, zero velocity", "5 (the paper: of 15)", str(nine), nine == 5))
    write_table(out / "observability.csv", {key: [line[key] for line in rows] for key in rows[0]})
    return rows
