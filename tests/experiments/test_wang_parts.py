"""What the experiments of Wang 2018 count and score."""

import numpy as np
import pytest

from experiments.wang import observability
from experiments.wang.alignment import auc
from experiments.wang.made import EARTH
from pedjax.simulation.earth import homogeneous


@pytest.mark.parametrize(("measured", "rank"), observability.WANTED.items())
def test_a_standing_foot_tells_so_many_of_fifteen_states(measured, rank):
    assert observability.rank(measured) == rank


def test_five_is_the_rank_of_nine_states():
    assert observability.rank(("zero velocity",), observability.NINE) == 5


def test_the_area_counts_pairs():
    bad, good = np.array([3.0, 1.0, 5.0]), np.array([0.0, 2.0])
    pairs = np.mean([b > g for b in bad for g in good])
    assert auc(bad, good) == pytest.approx(pairs)


def test_the_field_that_is_looked_up_is_the_simulated_one():
    munich = np.asarray(homogeneous("munich"))
    assert np.linalg.norm(munich) == pytest.approx(EARTH["compass.strength"], rel=1e-6)
    dip = np.arctan2(-munich[2], np.hypot(munich[0], munich[1]))
    assert dip == pytest.approx(EARTH["compass.inclination"], rel=1e-6)
    assert munich[0] == pytest.approx(0.0, abs=1e-9)
