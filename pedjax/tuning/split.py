"""Which recordings are tuned on and which are held back, by a rule that cannot be bent afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pedjax.errors import InputError
from pedjax.identity import walk_fingerprint
from pedjax.recording import Recording


def split(
    recordings: Sequence[Recording], fraction: float = 0.5, seed: int = 0
) -> tuple[list[int], list[int]]:
    """Indices of the recordings to tune on (that `fraction` of them) and of those held back.

    Sorted by name, then shuffled by the seed: the order of the command line does not matter, and the same
    walk twice, or a disturbed copy of it, lands on one side.
    """
    if not 0 < fraction < 1:
        raise InputError(f"the fraction to tune on is {fraction:g}; it must lie between 0 and 1")
    groups: dict[str, list[int]] = {}
    prints = [walk_fingerprint(recording) for recording in recordings]
    for i in sorted(range(len(recordings)), key=lambda i: (recordings[i].name, prints[i])):
        groups.setdefault(prints[i], []).append(i)
    distinct = list(groups.values())
    if len(distinct) < 2:
        raise InputError("a held-back part needs at least two different recordings")
    order = np.random.default_rng(seed).permutation(len(distinct))
    count = min(max(round(fraction * len(distinct)), 1), len(distinct) - 1)
    first = sorted(i for g in order[:count] for i in distinct[g])
    return first, sorted(set(range(len(recordings))) - set(first))


def refuse_overlap(tuned_on: Sequence[str], held_back: Sequence[Recording]) -> None:
    """Refuse to report a held-back error for a recording that was tuned on, itself or as a disturbed copy (by
    fingerprint), and for any disturbed copy: nobody measured what it holds."""
    for recording in held_back:
        if recording.copy_of:
            raise InputError(
                f"{recording.name} is a disturbed copy: its error is no held-back error; hold back the "
                "recording it was made of"
            )
        if walk_fingerprint(recording) in tuned_on:
            raise InputError(
                f"{recording.name} was tuned on: its error is no held-back error; take it off one list"
            )
