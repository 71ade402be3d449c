"""What a GPU makes of the filter: lanes against rate, each system, sweeps end to end, gradients.

python -m benchmarks gpu [--vicon VICON] [--limit limit.cu] [--quick]
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import pedjax
from benchmarks import cases
from benchmarks.cases import Case, compiled, timed
from benchmarks.sweeps import RANGES
from benchmarks.trials import gradient, vicon
from pedjax import filtering, parameters
from pedjax.kernels.columns import Layout
from pedjax.packing import Batch, pack
from pedjax.recording import Inertial
from pedjax.systems import SYSTEMS
from pedjax.walks import Walk

Row = tuple[str, str]


def batch_of(name: str, length: int, dtype: Any) -> tuple[Any, Batch]:
    """Parameters of a system, and a made-up walk with a magnetometer, packed."""
    walk = cases.walk(length)
    field = np.random.default_rng(1).normal(size=(length, 3)) + np.array([0.0, 20.0, -43.0])
    imu = walk.imu
    imu = Inertial(imu.time, imu.dt, imu.specific_force, imu.angular_rate, field)
    walk = Walk(walk.name, {"foot": imu}, walk.index, walk.position)
    params = parameters.cast(SYSTEMS[name].defaults(), dtype)
    return params, pack(SYSTEMS[name], params, [walk], dtype)


def lanes_of(params: Any, count: int, dtype: Any) -> Any:
    """The parameters with a threshold, a noise and a density for each of `count` lanes."""
    drawn = pedjax.design(params, RANGES, count, "random")
    return parameters.with_leaves(params, {k: jnp.asarray(v, dtype)[:, None] for k, v in drawn.items()})


def rate(
    name: str, lanes: int, dtype: str, kernel: str, layout: Layout | None = None, length: int = 2048
) -> Case:
    """That many parameter sets side by side over one walk, positions kept where scored."""
    system = SYSTEMS[name]

    def make() -> Callable[[], Any]:
        params, batch = batch_of(name, length, jnp.dtype(dtype))
        sets = lanes_of(params, lanes, jnp.dtype(dtype))

        @jax.jit
        def go(sets: Any, packed: Any) -> Any:
            if layout is None:
                return filtering.points(system, sets, packed, batch.slots, kernel=kernel)  # type: ignore[arg-type]
            return filtering._kernel_points(system, sets, packed, batch.slots, ("position",), False, layout)

        return lambda: go(sets, batch.packed)

    how = (
        "scan"
        if kernel == "never"
        else "kernel"
        if layout is None
        else f"kernel {layout.block}/{layout.warps}"
    )
    title = f"{how} {name} {dtype}, {lanes:,} lanes"
    return Case(title, make, lambda s: f"{length * lanes / s / 1e6:,.0f} M steps/s", dtype == "float64")


def agreement(name: str, dtype: str) -> Case:
    """How far the kernel on this device is from the scan on the CPU, three demo walks in two columns."""
    from pedjax.walks import walk

    found: dict[str, Any] = {}
    system = SYSTEMS[name]

    def make() -> Callable[[], Any]:
        params = parameters.cast(system.defaults(), jnp.dtype(dtype))
        walks = [walk(pedjax.read(f"demo:{seed}"), needs=system.needs) for seed in (1, 2, 3)]
        batch = pack(system, params, walks, jnp.dtype(dtype), most_columns=2)
        sets = lanes_of(params, 40, jnp.dtype(dtype))
        here, there = jax.devices()[0], jax.devices("cpu")[0]

        def both() -> None:
            for kernel, device in (("auto", here), ("never", there)):
                given = jax.device_put((sets, batch), device)
                found[kernel] = jax.jit(partial(_estimates, system, kernel))(*given)

        return both

    def told(seconds: float) -> str:
        (a, x, s), (b, y, t) = (jax.tree.map(np.asarray, found[k]) for k in ("auto", "never"))
        gates = max(float(np.max(np.abs(x[k] - y[k]))) for k in y)
        away = float(np.max(np.abs(a - b)))
        same = "equal" if (s == t).all() else "DIFFERS"
        return f"position {away:.1e} of {np.abs(b).max():.0f} m, mean gates {gates:.1e}, status {same}"

    return Case(f"agreement {name} {dtype}", make, told, dtype == "float64")


def _estimates(system: Any, kernel: Any, sets: Any, batch: Batch) -> Any:
    found = filtering.points(system, sets, batch.packed, batch.slots, kernel=kernel)
    return batch.estimates(found)["position"], batch.gates(found), batch.status(found)


def sweep_rate(name: str, count: int, dtype: str = "float32") -> Case:
    """A sweep end to end, from parameter sets to a table of scores, over a demo walk."""
    from pedjax.sweeping.engine import Engine, job

    size: dict[str, int] = {}

    def make() -> Callable[[], Any]:
        system = SYSTEMS[name]
        work = job([pedjax.read("demo:1")], system)
        values = pedjax.design(system.defaults(), RANGES, count, "random")
        part = min(count, work.part)
        size["steps"] = count * work.samples
        engine = Engine(work, part)
        parts = [{k: v[i : i + part] for k, v in values.items()} for i in range(0, count, part)]
        return lambda: [engine.run({}, each) for each in parts]

    title = f"sweep {name} {dtype}, {count:,} sets"

    def told(seconds: float) -> str:
        return f"{size['steps'] / seconds / 1e6:,.0f} M steps/s, {seconds:.2f} s"

    return Case(title, make, told, dtype == "float64")


def limit(source: Path, lanes: int = 65536, length: int = 2000) -> str:
    """The hand-written kernel beside, where there is a compiler."""
    if shutil.which("nvcc") is None:
        return "no nvcc"
    with tempfile.TemporaryDirectory() as place:
        made = Path(place) / "limit"
        command = [
            "nvcc",
            "-O3",
            "-arch=native",
            "--use_fast_math",
            "-DBLOCK=64",
            str(source),
            "-o",
            str(made),
        ]
        subprocess.run(command, check=True, capture_output=True)
        done = subprocess.run([made, str(lanes), str(length)], check=True, capture_output=True, text=True)
    return done.stdout.strip()


def cases_of(quick: bool, folder: Path | None) -> list[Case]:
    """What is measured, the most telling first."""
    systems = ("iez", "ma2018")
    found = [agreement("iez", "float32"), *(sweep_rate(name, 65536) for name in systems)]
    found += [rate(name, 65536, "float32", "auto") for name in systems]
    if folder is not None:
        found += [vicon(folder), *(gradient("forward", kind, folder) for kind in ("float64", "float32"))]
    found += [rate("iez", 65536, "float32", "auto", layout) for layout in (Layout(32, 1), Layout(128, 4))]
    found += [agreement("ma2018", "float32"), agreement("iez", "float64"), sweep_rate("iez", 1_000_000)]
    found += [rate(name, 65536, "float64", "auto") for name in systems]
    found += [rate("iez", 262144, "float32", "auto"), rate("iez", 65536, "float32", "never")]
    found += [rate("ma2018", 65536, "float32", "auto", layout) for layout in (Layout(32, 1), Layout(128, 4))]
    found += [rate("iez", 8192, "float32", "auto"), agreement("ma2018", "float64")]
    if folder is not None:
        found += [gradient("reverse", "float64", folder)]
    return found[: 8 if quick else None]


def measure(
    quick: bool = False,
    folder: Path | None = None,
    source: Path | None = None,
    seconds: float = 1e9,
    workers: int = 1,
) -> list[Row]:
    """Measure what fits into so many seconds; a case that fails says why and does not stop the rest. With
    several `workers` programs are compiled beside each other, and timed alone."""
    began, device = time.perf_counter(), jax.devices()[0]
    rows: list[Row] = [("device", f"{device.device_kind}, jax {jax.__version__}")]
    if source is not None:
        rows.append(("hand-written kernel", limit(source)))
    print(*(": ".join(row) for row in rows), sep="\n", flush=True)

    def left() -> float:
        return max(seconds - (time.perf_counter() - began), 0.0)

    todo = cases_of(quick, folder)
    pool = ThreadPoolExecutor(workers)
    for first in range(0, len(todo), workers):
        group = [(case, pool.submit(compiled, case)) for case in todo[first : first + workers]]
        wait([made for _, made in group], timeout=left())
        for case, made in group:
            try:
                found = timed(case, made.result(timeout=0))
            except Exception as error:
                made.cancel()
                found = f"FAILED {type(error).__name__}: {str(error)[:200]}"
            rows.append((case.title, found))
            print(f"{case.title}: {found}   [{time.perf_counter() - began:.0f} s]", flush=True)
        if left() == 0:
            break
    pool.shutdown(wait=False, cancel_futures=True)
    return rows
