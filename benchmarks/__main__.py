"""Speed figures and their ratios, all from one run on one machine.

    python -m benchmarks [--quick]

Times are processor time of this process on one core where the work is single-threaded (`taskset -c 0` makes
it so), best of three after compilation.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import pedjax

pedjax.configure()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from pedjax import filtering, parameters  # noqa: E402
from pedjax.detectors import stance  # noqa: E402
from pedjax.filtering import Packed  # noqa: E402
from pedjax.runtime import double_precision  # noqa: E402
from pedjax.systems.iez import IEZ  # noqa: E402


def best_of(work: Callable[[], Any], repeats: int = 3) -> float:
    """Least processor time of a few runs, after one that compiles."""
    jax.block_until_ready(work())
    times = []
    for _ in range(repeats):
        start = time.process_time()
        jax.block_until_ready(work())
        times.append(time.process_time() - start)
    return min(times)


def signals(length: int, dtype: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Noise about rest for half of each second, motion for the other."""
    rng = np.random.default_rng(0)
    still = (np.arange(length) % 200 < 90)[:, None]
    force = rng.normal(size=(length, 3)) * np.where(still, 0.02, 2.0) + [0, 0, 9.8]
    rate = rng.normal(size=(length, 3)) * np.where(still, 0.01, 1.0)
    return jnp.asarray(force, dtype), jnp.asarray(rate, dtype), jnp.full(length, 0.005, dtype)


def packed(length: int, dtype: Any) -> tuple[Any, Packed]:
    """Parameters and one recording in one column, scored every 1000 samples."""
    params = parameters.cast(IEZ.defaults(), dtype)
    chunk = int(np.sqrt(length))
    length = length // chunk * chunk
    inputs = jax.jit(lambda f, r, d: IEZ.prepare(params, f, r, d, 200.0))(*signals(length, dtype))
    slot = np.full((length, 1), -1)
    slot[::1000] = 0
    begin = np.zeros((length // chunk, 1), bool)
    begin[0] = True
    lanes = jax.tree.map(lambda x: x[..., None], inputs)
    opening = jax.tree.map(lambda x: jnp.broadcast_to(x, (length // chunk, *x.shape)), lanes.opening)
    return params, Packed(lanes.samples, opening, jnp.asarray(begin), jnp.asarray(slot))


def single_walk(length: int) -> dict[str, float]:
    """Samples/s of one walk, whole track kept."""
    found = {}
    for name in ("float32", "float64"):
        with double_precision():
            dtype = jnp.dtype(name)
            params = parameters.cast(IEZ.defaults(), dtype)
            inputs = jax.jit(lambda f, r, d, p=params: IEZ.prepare(p, f, r, d, 200.0))(
                *signals(length, dtype)
            )
            go = jax.jit(
                lambda p, i: filtering.scan(
                    IEZ, p, i.samples, IEZ.start(p, i.opening), lambda o: (o.navigation, o.stance)
                )[1]
            )
            found[name] = length / best_of(lambda go=go, p=params, i=inputs: go(p, i))
    return found


def lanes(length: int, sets: int, width: int, dtype: Any) -> float:
    """Filter steps/s of many parameter sets, `width` lanes at a time."""
    params, data = packed(length, dtype)
    thresholds = jnp.geomspace(1e6, 1e9, sets).astype(dtype).reshape(-1, width)
    steps = data.slot.shape[0]

    @jax.jit
    def go(blocks: jax.Array) -> jax.Array:
        def block(values: jax.Array) -> jax.Array:
            tree = parameters.with_leaves(params, {"stance.shoe.threshold": values[:, None]})
            return filtering.scan_points(IEZ, tree, data, 1).position

        return jax.lax.map(block, blocks)

    return steps * sets / best_of(lambda: go(thresholds))


def statistics(length: int) -> dict[str, float]:
    """Samples/s of each detector's statistic, float32."""
    force, rate, _ = signals(length, jnp.float32)
    found = {}
    for name in stance.DETECTORS:
        params = parameters.cast(
            parameters.replace(IEZ.defaults(), {"stance.detector": name}).stance, jnp.float32
        )
        go = jax.jit(lambda f, r, p=params: stance.statistic(p, f, r, 200.0))
        found[name] = length / best_of(lambda go=go: go(force, rate))
    return found


def gradient(length: int) -> dict[str, float]:
    """A landmark loss over `length` steps, six parameters, float64: forward run, gradient, temporaries."""
    names = ("stance.shoe.threshold", "updates.zero_velocity", "process.accelerometer", "process.gyroscope",
             "initial.accelerometer_bias", "initial.gyroscope_bias")  # fmt: skip
    with double_precision():
        params, data = packed(length, jnp.float64)
        params = parameters.with_leaves(params, {"gate.width": jnp.asarray(0.25)})
        values = {n: parameters.get(params, n) for n in names}

        def loss(values: dict[str, jax.Array], data: Packed) -> jax.Array:
            points = filtering.scan_points(IEZ, parameters.with_leaves(params, values), data, 1)
            return jnp.mean(points.position**2)

        forward, backward = jax.jit(loss), jax.jit(jax.grad(loss))
        analysis = backward.lower(values, data).compile().memory_analysis()
        forward_s = best_of(lambda: forward(values, data))
        gradient_s = best_of(lambda: backward(values, data))
    return {
        "forward_us_per_step": 1e6 * forward_s / length,
        "gradient_us_per_step": 1e6 * gradient_s / length,
        "ratio": gradient_s / forward_s,
        "temporaries_MiB": analysis.temp_size_in_bytes / 2**20,
    }


def numpy_loop(length: int) -> float:
    """Samples/s of a plain numpy 15-state predict-and-update loop, the yardstick of this run."""
    force, rate, dt = (np.asarray(x, float) for x in signals(length, jnp.float32))
    F, P, Q = np.eye(15), np.eye(15) * 1e-4, np.eye(15) * 1e-8
    H, R = np.eye(15)[9:12], np.eye(3) * 1e-4
    v, p, C = np.zeros(3), np.zeros(3), np.eye(3)
    start = time.process_time()
    for k in range(length):
        w, step = rate[k], dt[k]
        W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) * step
        C = C @ (np.eye(3) + W + 0.5 * W @ W)
        f = C @ force[k]
        p = p + step * v
        v = v + step * (f - [0, 0, 9.8])
        F[0:3, 3:6], F[9:12, 12:15], F[6:9, 9:12] = -step * C, -step * C, step * np.eye(3)
        F[9:12, 0:3] = -step * np.array([[0, -f[2], f[1]], [f[2], 0, -f[0]], [-f[1], f[0], 0]])
        P = F @ P @ F.T + Q
        if k % 200 < 90:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x = K @ -v
            P = P - K @ H @ P
            v, p = v + x[9:12], p + x[6:9]
    return length / (time.process_time() - start)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples")
    args = parser.parse_args()
    length = 12_000 if args.quick else 120_000
    print(
        f"jax {jax.__version__}, {jax.devices()[0].device_kind}, {length} samples; rates in processor time\n"
    )
    base = numpy_loop(length // 12)
    print(f"plain numpy loop               {base / 1e3:10.1f} k samples/s")
    for name, rate in single_walk(length).items():
        print(f"one walk, {name}, 15 states  {rate / 1e3:10.1f} k samples/s   {rate / base:7.0f} x numpy")
    for dtype in (jnp.float32, jnp.float64):
        with double_precision():
            for width in (1, 8, 32, 64, 128):
                sets = 512 if width > 1 else 8
                rate = lanes(length // 10, sets, width, dtype)
                label = f"{sets} sets, {width} lanes, {jnp.dtype(dtype).name}"
                print(f"{label:30} {rate / 1e6:10.2f} M steps/s     {rate / base:7.0f} x numpy")
    for name, rate in statistics(length).items():
        print(f"{name:6} statistic               {rate / 1e6:10.2f} M samples/s")
    found = gradient(10_000 if args.quick else 100_000)
    print(
        f"gradient by 6 parameters: {found['gradient_us_per_step']:.2f} us a step against "
        f"{found['forward_us_per_step']:.2f} forward, ratio {found['ratio']:.1f}, "
        f"{found['temporaries_MiB']:.1f} MiB of temporaries"
    )


if __name__ == "__main__":
    main()
