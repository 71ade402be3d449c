"""The one table of scores: what a run is judged by, minimised by, and what its column is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

from jax import Array

from pedjax.errors import InputError, suggest
from pedjax.evaluation.heading import heading_rms
from pedjax.evaluation.landmarks import Reference, landmark_errors

Known = Literal["xy", "xyz", "attitude"]


class ScoreKind(NamedTuple):
    """A score, lower being better.

    `of(estimates, reference, alignment) -> (*L)` takes fields of the estimate by name at the scored points,
    `(K, ..., *L)`, and a reference that broadcasts against them; `keep` says which fields it needs, `known`
    what must be known of the points.
    """

    name: str
    unit: str
    title: str
    of: Callable[[Mapping[str, Array], Reference, str], Array]
    keep: tuple[str, ...] = ("position",)
    known: Known = "xy"

    @property
    def column(self) -> str:
        """What it is called in tables: its name and its unit."""
        return f"{self.name}_{self.unit}"


def _landmark(name: str, title: str, known: Known = "xy") -> ScoreKind:
    def of(estimates: Mapping[str, Array], reference: Reference, alignment: str) -> Array:
        found: Array = getattr(landmark_errors(estimates["position"], reference, alignment), name)
        return found

    return ScoreKind(name, "m", title, of, known=known)


def _heading(estimates: Mapping[str, Array], reference: Reference, alignment: str) -> Array:
    return heading_rms(estimates["attitude"], reference)


SCORES: dict[str, ScoreKind] = {
    kind.name: kind
    for kind in (
        _landmark("armse", "mean over points of the RMS over x and y (PyShoe's ARMSE)"),
        _landmark("rms_2d", "horizontal RMS"),
        _landmark("mean_2d", "horizontal mean"),
        _landmark("max_2d", "largest horizontal error"),
        _landmark("final_2d", "horizontal error at the last point"),
        _landmark("rms_3d", "RMS in space", "xyz"),
        ScoreKind(
            "heading_rms", "deg", "RMS of the heading, the best constant taken off", _heading,
            ("attitude",), "attitude",
        ),
    )
}  # fmt: skip
"""Score by name."""


def register_loss(kind: ScoreKind) -> ScoreKind:
    """Make a loss of your own known by its name: to `tune`, `sweep` and their configs."""
    SCORES[kind.name] = kind
    return kind


def score_kind(name: str) -> ScoreKind:
    """The score of that name; an unknown one is an `InputError` with a suggestion."""
    if name not in SCORES:
        raise InputError(f"loss '{name}' is unknown{suggest(name, SCORES)}")
    return SCORES[name]


def unit_of(column: str) -> str:
    """The unit of a score's column, its last part: m of `armse_m`."""
    return column.rpartition("_")[2]


def is_score(column: str) -> bool:
    """Whether a column of a table is a score."""
    return any(column == kind.column for kind in SCORES.values())


def told_with(loss: str) -> tuple[ScoreKind, ...]:
    """The scores that a sweep by that loss writes: its own, and all that need nothing more than it and
    positions."""
    kept = {"position", *score_kind(loss).keep}
    return tuple(
        kind
        for kind in SCORES.values()
        if kind.name == loss or (set(kind.keep) <= kept and kind.known != "attitude")
    )
