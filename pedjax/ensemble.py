"""An ensemble: many parameter sets over many recordings in one program, of which only scores are kept."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import parameters
from pedjax.errors import InputError
from pedjax.evaluation.landmarks import Errors, landmark_errors
from pedjax.filtering import scan_points
from pedjax.packing import Batch, Walk, walk
from pedjax.recording import Clock, Recording
from pedjax.running import check_walk
from pedjax.system import System

LOSSES = {"armse": "pyshoe_armse", "rms_2d": "rms_2d", "mean_2d": "mean_2d", "rms_3d": "rms_3d"}
"""What can be minimised, and its name among the errors."""


class Problem(NamedTuple):
    """What a loss is made of: the static parts of a tuning or sweep."""

    system: System
    loss: str
    alignment: str


class Scores(NamedTuple):
    """Of each parameter set on each recording, `(S, R)`: `errors` in m, whether the run stayed `healthy`,
    and `stance`, the mean weight of its zero-velocity updates."""

    errors: Errors
    healthy: Array
    stance: Array


def scores(problem: Problem, params: Any, values: dict[str, Array], batch: Batch) -> Scores:
    """Run the sets `values[path] (S,)` over all recordings of the batch; to be jitted by the caller."""
    lanes = {path: value[..., None] for path, value in values.items()}
    points = scan_points(problem.system, parameters.with_leaves(params, lanes), batch.packed, batch.slots)
    errors = landmark_errors(batch.estimates(points), batch.reference, problem.alignment)
    return Scores(errors, batch.healthy(points), batch.stance(points))


@partial(jax.jit, static_argnames="problem")
def losses(problem: Problem, params: Any, values: dict[str, Array], batch: Batch) -> Array:
    """Loss of each recording for parameter sets `values[path] (S,)`: `(S, R)` in m, inf where unhealthy."""
    found = scores(problem, params, values, batch)
    value = getattr(found.errors, LOSSES[problem.loss])
    return jnp.where(found.healthy & jnp.isfinite(value), value, jnp.inf)


def walks_for(
    system: System,
    params: Any,
    recordings: Sequence[Recording],
    sensor: str,
    clock: Clock | None,
    loss: str,
) -> list[Walk]:
    """Recordings ready for a filter, refused where they are too short or have nothing to score."""
    walks = []
    for recording in recordings:
        found = walk(recording, sensor, clock)
        check_walk(system, params, found)
        needed = 3 if loss == "rms_3d" else 2
        count = int(np.isfinite(found.position[:, :needed]).all(axis=1).sum())
        if count < 2:
            axes = "x, y and z" if needed == 3 else "x and y"
            raise InputError(
                f"{recording.name}: loss '{loss}' needs at least two landmarks (or dense truth) "
                f"with known {axes}; it has {count}"
            )
        walks.append(found)
    return walks
