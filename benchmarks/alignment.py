"""What an aligned start costs: 7 s at 100 Hz beside a walk of ten minutes with `wang`."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.cases import best_of
from pedjax import filtering, parameters
from pedjax.filtering import Packed
from pedjax.runtime import double_precision, lane_count
from pedjax.system import Signals
from pedjax.systems.wang import WANG

RATE = 100.0
STAND_S = 7.0
NAMES = {
    "agda": ("initial.align.gain", "initial.align.decay", "compass.noise.floor", "updates.zero_velocity"),
    "weighted": (
        "initial.align.strength_spread", "initial.align.dip_spread", "compass.noise.floor",
        "updates.zero_velocity",
    ),
}  # fmt: skip
"""What is differentiated by: numbers of the start among them, or its gradient would cost nothing."""


def signals(length: int) -> tuple[Signals, np.ndarray]:
    """A stand of 8 s, then rest for half of each second and motion for the other, in a field that points
    north."""
    rng = np.random.default_rng(0)
    time = np.arange(length) / RATE
    still = ((time < 8.0) | (time % 1.0 < 0.45))[:, None]
    force = rng.normal(size=(length, 3)) * np.where(still, 0.02, 2.0) + [0, 0, 9.8]
    rate = rng.normal(size=(length, 3)) * np.where(still, 0.01, 1.0)
    field = rng.normal(size=(length, 3)) * 0.1 + [0.0, 21.0, -43.0]
    return Signals(*(jnp.asarray(x) for x in (force, rate, field))), np.full(length, 1 / RATE)


def packed(length: int, method: str, dtype: Any) -> tuple[Any, Packed]:
    changes = {"initial.alignment": method, "initial.align.seconds": STAND_S, "gate.width": 0.25}
    params = parameters.cast(parameters.replace(WANG.defaults(), changes), dtype)
    found, dt = signals(length)
    given = jax.tree.map(lambda x: x.astype(dtype), found)
    inputs = WANG.prepare(params, {"foot": given}, jnp.asarray(dt, dtype), RATE)
    chunk = 1 << round(np.log2(length) / 2)
    length = length // chunk * chunk
    slot, which = np.full((length, 1), -1), np.full((length // chunk, 1), -1)
    slot[::1000], which[0] = 0, 0
    samples = jax.tree.map(lambda x: x[:length, ..., None], inputs.samples)
    opening = jax.tree.map(lambda x: x[..., None], inputs.opening)
    return params, Packed(samples, opening, jnp.asarray(which), jnp.asarray(slot))


def shares(length: int, method: str) -> dict[str, float]:
    """Time of the start over that of all, forward of one walk and in lanes (float32), and under a gradient
    (float64)."""
    found = {}
    with double_precision():
        for kind, width, dtype in (
            ("forward", 1, jnp.float32),
            ("lanes", lane_count(jnp.float32), jnp.float32),
            ("gradient", 4, jnp.float64),
        ):
            params, data = packed(length, method, dtype)
            spread = jnp.geomspace(0.8, 1.25, width).astype(dtype)[:, None]
            values = {path: parameters.get(params, path) * spread for path in NAMES[method]}

            def whole(values: dict[str, jax.Array], data: Packed, params: Any = params) -> jax.Array:
                q = parameters.with_leaves(params, values)
                return jnp.sum(filtering.scan_points(WANG, q, data, 1).kept["position"] ** 2)

            def start(values: dict[str, jax.Array], data: Packed, params: Any = params) -> jax.Array:
                state = filtering.starts_of(WANG, parameters.with_leaves(params, values), data)
                return jnp.sum(state.estimate.attitude**2 * jnp.arange(9.0).reshape(3, 3, 1, 1))

            if kind == "gradient":
                works = [jax.jit(jax.grad(f)) for f in (start, whole)]
            else:
                works = [jax.jit(f) for f in (start, whole)]
            times = [best_of(partial(work, values, data)) for work in works]
            found[kind] = times[0] / times[1]
    return found
