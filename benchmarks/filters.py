"""One walk, many lanes, detectors, gradients."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.cases import RATE, best_of, inputs, packed, signals
from pedjax import filtering, parameters
from pedjax.detectors import stance
from pedjax.filtering import Packed
from pedjax.runtime import double_precision, lane_count
from pedjax.systems.iez import IEZ

TUNED = (
    "stance.shoe.threshold", "updates.zero_velocity", "process.accelerometer", "process.gyroscope",
    "initial.accelerometer_bias", "initial.gyroscope_bias", "initial.attitude", "gravity",
    "process.accelerometer_bias", "process.gyroscope_bias", "stance.shoe.sigma_accelerometer",
    "stance.shoe.sigma_gyroscope",
)  # fmt: skip


def single_walk(length: int, dtype: Any) -> float:
    """Samples/s of one walk, whole track kept."""
    params = parameters.cast(IEZ.defaults(), dtype)
    given = inputs(params, length, dtype)

    @jax.jit
    def go(p: Any, i: Any) -> Any:
        state = IEZ.start(p, None, i.opening)
        return filtering.scan(IEZ, p, None, i.samples, state, lambda o: (o.estimate, o.gates["stance"]))[1]

    return length / best_of(lambda: go(params, given))


def lanes(length: int, width: int, dtype: Any, **changes: Any) -> float:
    """Filter steps/s of `width` parameter sets side by side in one loop."""
    params, data = packed(length, dtype, **changes)
    paths = ("stance.shoe.threshold", "updates.zero_velocity", "process.accelerometer", "process.gyroscope")
    spread = jnp.geomspace(0.5, 2.0, width).astype(dtype)[:, None]
    values = {path: parameters.get(params, path) * spread for path in paths}

    @jax.jit
    def go(values: dict[str, jax.Array], data: Packed) -> jax.Array:
        return filtering.scan_points(IEZ, parameters.with_leaves(params, values), data, 1).kept["position"]

    return data.slot.shape[0] * width / best_of(lambda: go(values, data))


def statistics(length: int) -> dict[str, float]:
    """Samples/s of each detector's statistic, float32."""
    force, rate, _ = (jnp.asarray(x, jnp.float32) for x in signals(length))
    found = {}
    for name in stance.DETECTORS:
        params = parameters.cast(
            parameters.replace(IEZ.defaults(), {"stance.detector": name}).stance, jnp.float32
        )
        go = jax.jit(lambda f, r, p=params: stance.statistic(p, f, r, RATE))
        found[name] = length / best_of(lambda go=go: go(force, rate))
    return found


def gradient(length: int, starts: int = 1, mode: str = "reverse", names: tuple[str, ...] = TUNED) -> Any:
    """A landmark loss over `length` samples, float64: microseconds a step of one forward run alone and of
    the gradient of each start, their ratio, and MiB of temporaries a start.

    `starts` are taken in blocks that fill the lanes.
    """
    with double_precision():
        params, data = packed(length, jnp.float64)
        params = parameters.with_leaves(params, {"gate.width": jnp.asarray(0.25)})
        width = min(starts, lane_count(jnp.float64))

        def loss(values: dict[str, jax.Array], data: Packed) -> jax.Array:
            points = filtering.scan_points(IEZ, parameters.with_leaves(params, values), data, 1)
            return jnp.sum(jnp.mean(points.kept["position"] ** 2, axis=(0, 1, 2)))

        def forward_mode(values: dict[str, jax.Array], data: Packed) -> dict[str, jax.Array]:
            def slope(name: str) -> jax.Array:
                tangent = {n: jnp.ones_like(x) * (n == name) for n, x in values.items()}
                return jax.jvp(lambda v: loss(v, data), (values,), (tangent,))[1]

            return {name: slope(name) for name in values}

        alone = {n: jnp.asarray(parameters.get(params, n), float) for n in names}
        block = alone if width == 1 else {n: jnp.full((width, 1), x) for n, x in alone.items()}
        forward = jax.jit(loss)
        backward = jax.jit(jax.grad(loss) if mode == "reverse" else forward_mode)
        memory = backward.lower(block, data).compile().memory_analysis().temp_size_in_bytes / 2**20
        steps = data.slot.shape[0]
        one = best_of(lambda: forward(alone, data)) / steps
        many = best_of(lambda: [backward(block, data) for _ in range(starts // width)]) / steps / starts
        return {
            "forward_us": 1e6 * one,
            "gradient_us": 1e6 * many,
            "ratio": many / one,
            "temporaries_MiB": memory / width,
        }
