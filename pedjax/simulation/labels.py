"""Labels that cannot be wrong: where the field that a foot stood in was quasi-static."""

from __future__ import annotations

import numpy as np

from pedjax.simulation.truth import SensorTruth


def stance_middles(stance: np.ndarray) -> np.ndarray:
    """The middle sample of every stance in `(T,)`."""
    begin, end = stance_edges(stance)
    return (begin + end) // 2


def stance_edges(stance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first sample of every stance in `(T,)`, and the first after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stance, [False]]).astype(int)))
    return edges[::2], edges[1::2]


def largest_changes(field: np.ndarray, steps: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Of the fields `(K, 3)` µT of all stances: by how much, in µT and rad, the field and its horizontal
    direction changed at most in one of the last `steps` steps, `(K,)` each; inf in the first ones."""
    moved = np.linalg.norm(np.diff(field, axis=0), axis=1)
    heading = np.abs(np.diff(np.unwrap(np.arctan2(field[:, 1], field[:, 0]))))
    found = np.full((2, len(field)), np.inf)
    if len(field) > steps:
        both = np.stack([moved, heading])
        found[:, steps:] = np.lib.stride_tricks.sliding_window_view(both, steps, axis=1).max(axis=2)
    return found[0], found[1]


def quasi_static(
    truth: SensorTruth, steps: int = 3, field_uT: float = 3.0, heading_deg: float = 5.0
) -> tuple[np.ndarray, np.ndarray]:
    """Time `(K,)` s of each stance, and whether the field was quasi-static over the last `steps` of them.

    It was where, in each of those steps, from one stance to the next, the field in navigation axes changed by
    less than `field_uT` microtesla and its horizontal direction by less than `heading_deg` degrees. The
    definition is the kit's own: Ma 2018 draws a ROC (Fig. 8) without saying what its reference labels are.
    With 1 µT and 2 degrees hardly a step indoors is quasi-static for a foot (0.2 % in simulated buildings,
    none on recorded loops, where the field changes by 7 to 19 µT from stride to stride).
    The first `steps` stances have no whole window and are not quasi-static.
    """
    middles = stance_middles(truth.stance)
    moved, heading = largest_changes(truth.magnetic_field[middles], steps)
    return truth.time[middles], (moved < field_uT) & (heading < np.radians(heading_deg))
