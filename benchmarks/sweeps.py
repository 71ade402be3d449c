"""End to end: cost against size, all cores, and a sweep that another project took minutes for."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import pedjax
from benchmarks.cases import RATE, walk
from pedjax.ensemble import Problem
from pedjax.sweeping.engine import Engine, Job
from pedjax.systems.iez import IEZ
from pedjax.walks import Walk

RANGES = {
    "stance.shoe.threshold": [1e6, 1e9],
    "updates.zero_velocity": [0.003, 0.1],
    "process.accelerometer": [0.003, 0.3],
}


def job_of(walks: list[Walk]) -> Job:
    problem = Problem(IEZ, "armse", "yaw_translation")
    return Job(problem, IEZ.defaults(), tuple(walks), jnp.result_type(float), {"foot": "foot"})


def sets(count: int) -> dict[str, np.ndarray]:
    return pedjax.design(IEZ.defaults(), RANGES, count, "random")


def through(job: Job, count: int, devices: list[jax.Device] | None = None) -> float:
    """Wall time of `count` runs after compilation."""
    engine = Engine(job, min(count, job.part), devices)
    values = sets(count)
    parts = [{k: v[i : i + job.part] for k, v in values.items()} for i in range(0, count, job.part)]
    engine.run({}, parts[0])
    start = time.perf_counter()
    for part in parts:
        engine.run({}, part)
    return time.perf_counter() - start


def cores(seconds: float = 60.0) -> dict[str, Any]:
    """Aggregate steps/s of a sweep over a walk, scores and all, on one device and on all."""
    found: dict[str, Any] = {"devices": len(jax.local_devices())}
    for name in ("float32", "float64"):
        with jax.enable_x64(name == "float64"):
            job = job_of([walk(int(seconds * RATE))])
            steps = 2048 * job.samples
            found[f"{name}_one"] = steps / through(job, 2048, jax.local_devices()[:1])
            found[f"{name}_all"] = steps / through(job, 2048)
    return found


def growth(few: int = 1_000, many: int = 100_000, rate: float = 100.0) -> dict[str, float]:
    """Wall times of a few and of many runs over a one-minute walk, and the most memory ever held."""
    job = job_of([walk(int(60 * rate))])
    small = min(through(job, few) for _ in range(3))
    before = _peak_gib()
    large = through(job, many)
    return {
        "few_s": small,
        "many_s": large,
        "ratio_to_linear": large / (small * many / few),
        "peak_before_GiB": before,
        "peak_after_GiB": _peak_gib(),
        "steps_per_s": many * job.samples / large,
    }


def _peak_gib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def vicon(folder: Path) -> dict[str, Any]:
    """Eighteen thresholds over all trials of a folder, from files to a table of errors: first call (reading
    and compiling included) and second."""
    thresholds = {"stance.shoe.threshold": np.geomspace(1e6, 5e8, 18)}
    times = []
    for _ in range(2):
        start = time.perf_counter()
        recordings = [pedjax.read(path) for path in sorted(folder.glob("*.mat*"))]
        result = pedjax.sweep(recordings, thresholds)
        times.append(time.perf_counter() - start)
    return {
        "trials": len(recordings),
        "first_s": times[0],
        "second_s": times[1],
        "best_mean_m": float(result.mean[result.best]),
    }
