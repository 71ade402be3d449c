"""Field detectors against true labels: what a foot saw, the statistic of every window, and the ROC."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.detectors.field import FieldParameters, Look, log_ratio
from pedjax.errors import InputError
from pedjax.running import Track


class FieldLooks(NamedTuple):
    """What a foot saw, look by look: `time (K,)` s, `field (K, 3)` µT in navigation axes, `yaw (K,)` rad."""

    time: np.ndarray
    field: np.ndarray
    yaw: np.ndarray


def looks_of(track: Track) -> FieldLooks:
    """The looks of a run of a magnetic system."""
    if "look" not in track.more:
        raise InputError(f"{track.name}: the system '{track.system}' does not look at the field; use ma2018")
    at = np.flatnonzero(track.more["look"] > 0)
    return FieldLooks(track.time[at], track.more["magnetic_field"][at], track.euler[at, 2])


@partial(jax.jit, static_argnames="steps")
def _ratios(p: FieldParameters, looks: FieldLooks, steps: int, north: float) -> jax.Array:
    count = looks.time.shape[0] - steps
    window = tuple(
        Look(looks.field[k : k + count].T, looks.yaw[k : k + count], looks.time[k : k + count])
        for k in range(steps + 1)
    )
    return log_ratio(p, window, jnp.asarray(north))


def field_ratios(
    p: FieldParameters, detector: str, looks: FieldLooks, north: float = np.pi / 2
) -> np.ndarray:
    """Log of statistic over threshold `(K,)` at each look, causal; inf where there is no whole window."""
    chosen = parameters.replace(p, {"detector": detector})
    found = np.full(len(looks.time), np.inf)
    if len(looks.time) > p.window:
        given = FieldLooks(*(jnp.asarray(x) for x in looks))
        found[p.window :] = np.asarray(_ratios(chosen, given, p.window, north))
    return found


def labels_at(time: np.ndarray, label_time: np.ndarray, label: np.ndarray) -> np.ndarray:
    """The label `(K,)` of the stance nearest to each time `(K,)` s."""
    after = np.clip(np.searchsorted(label_time, time), 1, len(label_time) - 1)
    nearer = np.abs(label_time[after] - time) < np.abs(label_time[after - 1] - time)
    return label[np.where(nearer, after, after - 1)]
