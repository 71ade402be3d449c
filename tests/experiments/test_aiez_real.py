"""Recorded walks: no walk is reported with what it helped to choose."""

import numpy as np

from experiments.aiez.real import halvings


def test_a_walk_has_no_say_in_its_own_error():
    """Where it is made far better by one set, the choice for it stays as it was: the other half's."""
    errors = np.random.default_rng(4).uniform(1, 2, (7, 6))
    ways, found = halvings(errors)
    assert ways.shape == found.shape == (1 + 10, 6)  # of six walks, three; either half says the same
    np.testing.assert_array_equal(ways[0], [True, False] * 3)
    assert (ways.sum(axis=1) == 3).all()
    assert len({tuple(way) for way in ways[1:]}) == 10
    for walk in range(6):
        better = errors.copy()
        better[3, walk] -= 1e3  # it would choose set 3 for itself
        again = halvings(better)[1]
        same = np.isin(found[:, walk], errors[3, walk])
        np.testing.assert_array_equal(again[~same, walk], found[~same, walk])


def test_every_half_has_the_others_best():
    errors = np.array([[1.0, 5.0, 1.0, 5.0], [5.0, 1.0, 5.0, 1.0]])
    np.testing.assert_array_equal(halvings(errors)[1][0], [5.0, 5.0, 5.0, 5.0])
