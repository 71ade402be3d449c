"""What PyShoe's Vicon trials take on any device: a table of thresholds, gradients, and how sure float32 is.

python -m benchmarks trials --vicon FOLDER
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import pedjax
from benchmarks.cases import Case, compiled, timed
from pedjax import parameters
from pedjax.systems import SYSTEMS


def vicon(folder: Path) -> Case:
    """Eighteen thresholds over all trials, from recordings to a table of errors."""
    found: dict[str, Any] = {}

    def make() -> Callable[[], Any]:
        recordings = [pedjax.read(path) for path in sorted(folder.glob("*.mat*"))]
        thresholds = {"stance.shoe.threshold": np.geomspace(1e6, 5e8, 18)}

        def work() -> None:
            found["sweep"] = pedjax.sweep(recordings, thresholds)

        return work

    def told(seconds: float) -> str:
        result = found["sweep"]
        return f"{len(result.names)} trials in {seconds:.3f} s, best mean {result.mean[result.best]:.4f} m"

    return Case("18 thresholds x Vicon trials", make, told)


def gradient(mode: str, dtype: str, folder: Path, starts: int = 64, trials: int = 19) -> Case:
    """One gradient by twelve parameters of so many starts over so many Vicon trials."""
    from benchmarks.filters import TUNED
    from pedjax.ensemble import Problem, walks_for
    from pedjax.packing import pack_all
    from pedjax.tuning import objective
    from pedjax.tuning.loop import gated

    def make() -> Callable[[], Any]:
        system = SYSTEMS["iez"]
        params = parameters.cast(gated(system.defaults(), 0.25), jnp.dtype(dtype))
        recordings = [pedjax.read(path) for path in sorted(folder.glob("*.mat*"))[:trials]]
        walks = walks_for(system, params, recordings, None, None, "armse")
        batches = pack_all(system, params, walks, jnp.dtype(dtype))
        specs = parameters.specs(params)
        centre = {n: float(specs[n].to_free(parameters.get(params, n))) for n in TUNED}
        spread = np.random.default_rng(0).normal(size=(len(TUNED), starts)) * 0.1
        free = {n: jnp.asarray(x + c, dtype) for (n, c), x in zip(centre.items(), spread, strict=True)}
        problem = Problem(system, "armse", "yaw_translation")
        return lambda: objective.GRADIENTS[mode](problem, params, free, batches)

    title = f"gradient {mode} {dtype}, 12 parameters, {starts} starts, {trials} trials"
    return Case(title, make, lambda s: f"{s:.3f} s", dtype == "float64")


def slopes_of(mode: str, dtype: str, folder: Path, starts: int, trials: int) -> np.ndarray:
    """Gradients `(parameters, starts)`."""
    case = gradient(mode, dtype, folder, starts, trials)
    with jax.enable_x64(case.double):
        found = case.make()()[1]
    return np.stack([np.asarray(found[name], float) for name in sorted(found)])


def float32_error(folder: Path, starts: int = 18, trials: int = 4) -> tuple[str, dict[str, float]]:
    """How far tangents in float32 are from those in float64, and those from the gradient backward."""
    double, single, backward = (
        slopes_of(mode, dtype, folder, starts, trials)
        for mode, dtype in (("forward", "float64"), ("forward", "float32"), ("reverse", "float64"))
    )
    size = np.linalg.norm(double, axis=0)
    off, between = (np.linalg.norm(x - double, axis=0) / size for x in (single, backward))
    told = (
        f"{starts} starts, {trials} trials: off by {np.median(off):.1e} of the gradient in the median, "
        f"{off.max():.1e} at worst; float64 forward and backward differ by {between.max():.1e} at worst"
    )
    return told, {"median": float(np.median(off)), "worst": float(off.max()), "between": float(between.max())}


def measure(folder: Path, small: bool) -> dict[str, Any]:
    """All of it, printed as it comes."""
    starts = 8 if small else 64
    found: dict[str, Any] = {}
    for case in (vicon(folder), gradient("reverse", "float64", folder, starts)):
        found[case.title] = timed(case, compiled(case))
        print(f"{case.title}: {found[case.title]}", flush=True)
    told, found["float32 tangents"] = float32_error(folder)
    print(f"tangents in float32, {told}", flush=True)
    return found
