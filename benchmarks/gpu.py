"""What a GPU makes of the filter: lanes against rate, each system, sweeps end to end, gradients.

python -m benchmarks gpu [--vicon VICON] [--limit limit.cu] [--quick]
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import pedjax
from benchmarks import cases
from benchmarks.sweeps import RANGES
from pedjax import filtering, parameters
from pedjax.kernels.columns import Layout
from pedjax.packing import Batch, pack
from pedjax.recording import Inertial
from pedjax.systems import SYSTEMS
from pedjax.walks import Walk

Row = tuple[str, str]


def wall(work: Callable[[], Any], repeats: int = 3) -> float:
    """Least wall time of a few runs, after one that compiles."""
    return cases.best_of(work, repeats, wall=True)


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


def rate(name: str, lanes: int, length: int, dtype: Any, kernel: str, layout: Layout | None = None) -> float:
    """Filter steps/s of that many parameter sets side by side over one walk, positions kept where scored."""
    system = SYSTEMS[name]
    params, batch = batch_of(name, length, dtype)
    sets = lanes_of(params, lanes, dtype)

    @jax.jit
    def go(sets: Any, packed: Any) -> Any:
        if layout is None:
            return filtering.points(system, sets, packed, batch.slots, kernel=kernel)  # type: ignore[arg-type]
        keep = ("position",)
        return filtering._kernel_points(system, sets, packed, batch.slots, keep, False, layout)

    return batch.packed.slot.shape[0] * lanes / wall(lambda: go(sets, batch.packed))


def agreement(name: str, dtype: Any) -> str:
    """How far the kernel is from the scan, over two demo walks in two columns."""
    from pedjax.walks import walk

    system = SYSTEMS[name]
    params = parameters.cast(system.defaults(), dtype)
    walks = [walk(pedjax.read(f"demo:{seed}"), needs=system.needs) for seed in (1, 2, 3)]
    batch = pack(system, params, walks, dtype, most_columns=2)
    sets = lanes_of(params, 40, dtype)
    found = [
        jax.jit(partial(_estimates, system, batch.slots, kernel))(sets, batch) for kernel in ("auto", "never")
    ]
    (a, x, s), (b, y, t) = found
    size = float(jnp.max(jnp.abs(b)))
    gates = max(float(jnp.max(jnp.abs(x[k] - y[k]))) for k in y)
    return (
        f"position {float(jnp.max(jnp.abs(a - b))):.1e} of {size:.0f} m, gates {gates:.1e}, "
        f"status {'equal' if bool((s == t).all()) else 'DIFFERS'}"
    )


def _estimates(system: Any, slots: int, kernel: Any, sets: Any, batch: Batch) -> Any:
    found = filtering.points(system, sets, batch.packed, slots, kernel=kernel)
    return batch.estimates(found)["position"], batch.gates(found), batch.status(found)


def sweep_rate(name: str, count: int, seconds: float, dtype: str = "float32") -> str:
    """A sweep end to end, scores and all, after compilation."""
    from pedjax.sweeping.engine import Engine, job

    with jax.enable_x64(dtype == "float64"):
        recording = pedjax.read("demo:1")
        system = SYSTEMS[name]
        work = job([recording], system)
        values = pedjax.design(system.defaults(), RANGES, count, "random")
        part = min(count, work.part)
        engine = Engine(work, part)
        parts = [{k: v[i : i + part] for k, v in values.items()} for i in range(0, count, part)]
        engine.run({}, parts[0])
        start = time.perf_counter()
        for each in parts:
            engine.run({}, each)
        taken = time.perf_counter() - start
    steps = count * work.samples / taken / 1e6
    return f"{steps:,.0f} M steps/s ({count:,} sets, {taken:.2f} s, parts of {part:,})"


def vicon(folder: Path) -> str:
    """Eighteen thresholds over all trials, from recordings to a table, after compilation."""
    recordings = [pedjax.read(path) for path in sorted(folder.glob("*.mat*"))]
    thresholds = {"stance.shoe.threshold": np.geomspace(1e6, 5e8, 18)}
    taken = []
    for _ in range(3):
        start = time.perf_counter()
        found = pedjax.sweep(recordings, thresholds)
        taken.append(time.perf_counter() - start)
    best = found.mean[found.best]
    return f"{len(recordings)} trials: first {taken[0]:.1f} s, then {min(taken[1:]):.2f} s, best {best:.4f} m"


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


def gradient(starts: int, length: int, count: int = 12) -> str:
    """Reverse mode over a scan against forward tangents in a kernel: seconds for one gradient."""
    from benchmarks.filters import TUNED
    from pedjax.ensemble import Problem
    from pedjax.packing import Batches
    from pedjax.tuning import objective
    from pedjax.tuning.loop import gated

    found = []
    for dtype, mode in (("float64", "reverse"), ("float64", "forward"), ("float32", "forward")):
        with jax.enable_x64(dtype == "float64"):
            system = SYSTEMS["iez"]
            kind = jnp.dtype(dtype)
            params, batch = batch_of("iez", length, kind)
            params = parameters.cast(gated(params, 0.25), kind)
            specs = parameters.specs(params)
            free = {
                n: jnp.full(starts, specs[n].to_free(parameters.get(params, n)), kind) for n in TUNED[:count]
            }
            batches = Batches((batch,), jnp.zeros(1, int))
            problem = Problem(system, "armse", "yaw_translation")
            of = objective.GRADIENTS[mode]
            taken = wall(lambda of=of, p=problem, q=params, f=free, b=batches: of(p, q, f, b), 2)
        found.append(f"{mode} {dtype} {taken:.2f} s")
    return ", ".join(found)


def measure(
    quick: bool = False, vicon_folder: Path | None = None, limit_source: Path | None = None
) -> list[Row]:
    """All of it, in order of importance; a case that fails says why and does not stop the rest."""
    device = jax.devices()[0]
    rows: list[Row] = [("device", f"{device.device_kind}, jax {jax.__version__}")]

    def add(title: str, work: Callable[[], str]) -> None:
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", UserWarning)
                found = work()
        except Exception as error:
            found = f"FAILED {type(error).__name__}: {str(error)[:300]}"
            traceback.print_exc(limit=-4)
        rows.append((title, f"{found}   [{time.perf_counter() - start:.0f} s]"))
        print(*rows[-1], sep=": ", flush=True)

    for name in ("iez", "ma2018"):
        for kind in (jnp.float32, jnp.float64):
            with jax.enable_x64(kind == jnp.float64):
                add(f"agreement {name} {jnp.dtype(kind).name}", partial(agreement, name, kind))
    length = 2048

    def steps(*given: Any) -> str:
        return f"{rate(*given) / 1e6:,.0f} M steps/s"

    for name in ("iez", "ma2018"):
        for lanes in (8192, 65536) if quick else (8192, 65536, 262144):
            add(
                f"kernel {name} float32, {lanes:,} lanes",
                partial(steps, name, lanes, length, jnp.float32, "auto"),
            )
        for tile in (Layout(32, 1), Layout(128, 4)):
            given = (name, 65536, length, jnp.float32, "auto", tile)
            add(
                f"kernel {name} float32, 65,536 lanes, {tile.block} in {tile.warps} warps",
                partial(steps, *given),
            )
        add(f"scan {name} float32, 65,536 lanes", partial(steps, name, 65536, length, jnp.float32, "never"))
        with jax.enable_x64(True):
            add(
                f"kernel {name} float64, 65,536 lanes",
                partial(steps, name, 65536, length, jnp.float64, "auto"),
            )
    for name in ("iez", "ma2018"):
        add(f"sweep {name}, 65,536 sets", partial(sweep_rate, name, 65536, 60.0))
    if not quick:
        add("sweep iez, 1,000,000 sets", partial(sweep_rate, "iez", 1_000_000, 60.0))
    if vicon_folder is not None:
        add("18 thresholds x Vicon trials", partial(vicon, vicon_folder))
    if limit_source is not None:
        add("hand-written kernel", partial(limit, limit_source))
    add("gradient, 12 parameters, 64 starts", partial(gradient, 64, 8192))
    return rows
