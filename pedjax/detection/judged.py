"""What detectors say and what is true."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pedjax.detection.bands import Banded, Labelled, compare
from pedjax.detection.curves import Roc, Wanted
from pedjax.detection.points import Reached
from pedjax.recording import Recording


class Judged(NamedTuple):
    """What detectors say of recordings and what is true of them, `given` by window or by sample.

    `params` are those of the detectors; `entries` tell of each recording, `definition` how it was labelled;
    `at_point(detector, curve, wanted)` gives what a detector changes of `params` at a point of its curve.
    """

    params: Any
    recordings: Sequence[Recording]
    given: Labelled
    entries: list[dict[str, float]]
    definition: dict[str, float]
    at_point: Callable[[str, Roc, Wanted], Reached]

    def curves(self, *, upto: float = 0.1, seed: int = 0, draws: int = 2000) -> dict[str, dict[str, Banded]]:
        """ROC with its band by part and detector, see `bands.compare`."""
        return compare(self.given, draws=draws, seed=seed, upto=upto)
