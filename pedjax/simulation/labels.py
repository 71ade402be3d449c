"""Labels that cannot be wrong: where the field that a foot stood in was quasi-static."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pedjax.simulation.world import SensorTruth


def stance_middles(stance: np.ndarray) -> np.ndarray:
    """The middle sample of every stance in `(T,)`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stance, [False]]).astype(int)))
    return np.array([(a + b) // 2 for a, b in zip(edges[::2], edges[1::2], strict=True)], int)


def quasi_static(
    truth: SensorTruth, steps: int = 3, field_uT: float = 3.0, heading_deg: float = 5.0
) -> tuple[np.ndarray, np.ndarray]:
    """Time `(K,)` s of each stance, and whether the field was quasi-static over the last `steps` of them.

    It was where, in each of those steps, from one stance to the next, the field in navigation axes changed by
    less than `field_uT` microtesla and its horizontal direction by less than `heading_deg` degrees. The
    definition is the kit's own: Ma 2018 draws a ROC (Fig. 8) without saying what its reference labels are.
    With 1 µT and 2 degrees hardly a step indoors is quasi-static for a foot (0.2 % in simulated buildings,
    none on recorded loops, where the field changes by 10 to 18 µT from stride to stride).
    The first `steps` stances have no whole window and are not quasi-static.
    """
    middles = stance_middles(truth.stance)
    field = truth.magnetic_field[middles]
    moved = np.linalg.norm(np.diff(field, axis=0), axis=1)
    heading = np.unwrap(np.arctan2(field[:, 1], field[:, 0]))
    calm = (moved < field_uT) & (np.abs(np.diff(heading)) < np.radians(heading_deg))
    label = np.zeros(len(middles), bool)
    for k in range(steps, len(middles)):
        label[k] = calm[k - steps : k].all()
    return truth.time[middles], label
