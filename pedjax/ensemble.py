"""An ensemble: many parameter sets over many recordings in one program, of which only scores are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax import parameters
from pedjax.errors import InputError
from pedjax.evaluation.landmarks import onto
from pedjax.evaluation.scores import score_kind, told_with
from pedjax.filtering import Kernel, points, tangent_points
from pedjax.packing import Batch, Batches
from pedjax.recording import Clock, Recording
from pedjax.system import System
from pedjax.walks import Sensors, Walk, check_walk, walk


class Problem(NamedTuple):
    """What a loss is made of: the static parts of a tuning or sweep."""

    system: System
    loss: str
    alignment: str


class Scores(NamedTuple):
    """Of each parameter set on each recording, `(S, R)`: `errors` by name in the unit of each, the `status`
    (0: healthy to the end), and the mean weight of each of the `gates`."""

    errors: dict[str, Array]
    status: Array
    gates: dict[str, Array]


def scores(
    problem: Problem,
    params: Any,
    values: dict[str, Array],
    batch: Batch,
    loss_only: bool = False,
    kernel: Kernel = "auto",
) -> Scores:
    """Run the sets `values[path] (S,)` over all recordings of the batch, and tell all scores that go with the
    problem's loss, or `loss_only`; to be jitted by the caller. Differentiable only where `kernel` is
    `never`."""
    lanes = {path: value[..., None] for path, value in values.items()}
    chosen = score_kind(problem.loss)
    kinds = (chosen,) if loss_only else told_with(problem.loss)
    keep = tuple(dict.fromkeys(name for kind in kinds for name in kind.keep))
    params = parameters.with_leaves(params, lanes)
    found_points = points(problem.system, params, batch.packed, batch.slots, keep, kernel)
    found = batch.estimates(found_points)
    reference = onto(batch.reference, found_points.status.ndim - 1)
    errors = {kind.name: kind.of(found, reference, problem.alignment) for kind in kinds}
    return Scores(errors, batch.status(found_points), batch.gates(found_points))


@partial(jax.jit, static_argnames=("problem", "kernel"))
def losses(
    problem: Problem, params: Any, values: dict[str, Array], batches: Batches, kernel: Kernel = "never"
) -> Array:
    """Loss of each recording for parameter sets `values[path] (S,)`: `(S, R)`, inf where unhealthy."""
    each = []
    for batch in batches.parts:
        found = scores(problem, params, values, batch, loss_only=True, kernel=kernel)
        value = found.errors[problem.loss]
        each.append(jnp.where((found.status == 0) & jnp.isfinite(value), value, jnp.inf))
    return batches.joined(each)


def in_blocks(of: Callable[[dict[str, Array]], Any], values: dict[str, Array], used: ArrayLike) -> Any:
    """What `of` gives for blocks of sets `values[path] (B, S)`, one after the other, the first `used` of
    them: a tree of `(B, ...)`, zero for the others."""

    def one(i: Array, whole: Any) -> Any:
        found = of(jax.tree.map(lambda x: x[i], values))
        return jax.tree.map(lambda x, y: x.at[i].set(y), whole, found)

    blocks = next(iter(values.values())).shape[0]
    like = jax.eval_shape(of, jax.tree.map(lambda x: x[0], values))
    empty = jax.tree.map(lambda x: jnp.zeros((blocks, *x.shape), x.dtype), like)
    return jax.lax.fori_loop(0, used, one, empty)


def losses_along(
    problem: Problem, params: Any, values: dict[str, Array], moves: dict[str, Array], batch: Batch
) -> tuple[Array, Array]:
    """Loss `(S, R)` of parameter sets, inf where unhealthy, and its slope as `values[path] (S,)` move by
    `moves[path] (S,)`: tangents beside the states."""
    kind = score_kind(problem.loss)
    sets = parameters.with_leaves(params, {path: x[..., None] for path, x in values.items()})
    along = {path: x[..., None] for path, x in moves.items()}
    found, moved = tangent_points(problem.system, sets, along, batch.packed, batch.slots, kind.keep)
    reference = onto(batch.reference, found.status.ndim - 1)

    def loss(kept: dict[str, Array]) -> Array:
        return kind.of(batch.estimates(found._replace(kept=kept)), reference, problem.alignment)

    value, slope = jax.jvp(loss, (found.kept,), (moved,))
    return jnp.where((batch.status(found) == 0) & jnp.isfinite(value), value, jnp.inf), slope


_KNOWN = {"xy": (2, "x and y"), "xyz": (3, "x, y and z")}


def walks_for(
    system: System,
    params: Any,
    recordings: Sequence[Recording],
    sensors: Sensors,
    clock: Clock | None,
    loss: str,
) -> list[Walk]:
    """Recordings ready for a filter, refused where they are too short or have nothing to score."""
    kind = score_kind(loss)
    walks = []
    for recording in recordings:
        found = walk(recording, sensors, clock, needs=system.needs, headings=kind.known == "attitude")
        check_walk(system, params, found)
        if kind.known == "attitude":
            count, what = len(found.index), "dense truth with the orientation of its sensor, at two points"
        else:
            needed, axes = _KNOWN[kind.known]
            count = int(np.isfinite(found.position[:, :needed]).all(axis=1).sum())
            what = f"at least two landmarks (or dense truth) with known {axes}"
        if count < 2:
            raise InputError(f"{recording.name}: loss '{loss}' needs {what}; it has {count or 'none'}")
        walks.append(found)
    return walks
