"""From a threshold to parameters, as their leaves say."""

import pytest

from pedjax import parameters
from pedjax.detection.points import is_searched, moved, searched, unit_of
from pedjax.detectors.field import Magyq, Vector
from pedjax.detectors.stance import Eps, Shoe
from pedjax.errors import InputError
from pedjax.parameters import leaf, setting


def test_one_takes_the_threshold_to_the_bit():
    own = parameters.replace(Shoe(), {"threshold": 3.7e7})
    assert unit_of(own, "shoe") == 3.7e7
    assert moved(own, "shoe", 1.1e6, 3.7e7) == {"threshold": 1.1e6}


def test_several_go_together():
    own = Eps()
    found = moved(own, "eps", 1.7, 1.0)
    assert list(found) == ["energy", "product", "total", "rate_variance", "rate_energy"]
    assert found == {path: 1.7 * getattr(own, path) for path in found}


def test_a_length_beside_a_variance_goes_with_the_root():
    found = moved(Magyq(), "magyq", 24.0, unit_of(Magyq(), "magyq"))
    assert found == {"variance": 24.0, "outlier": pytest.approx(16.0)}


def test_points_are_searched_one_after_the_other():
    own = Vector()
    assert is_searched(own, "vector")
    assert unit_of(own, "vector") == 1.0

    def passing(new):
        ((path, x),) = new.items()
        return int(100 * x) if path == "false_alarm" else int(1000 * x)

    assert searched(own, "vector", passing, 40) == {"false_alarm": pytest.approx(0.4, rel=1e-6)}
    assert searched(own, "vector", passing, 500) == {"change": pytest.approx(0.5, rel=1e-6)}
    assert searched(own, "vector", passing, 10**9) == {"change": 100.0}


def test_roots_and_thresholds_of_ones_own():
    @parameters.parameters
    class Own:
        slope: float = leaf(2.0, unit="1", low=0.1, high=10.0, source="test")
        speed: float = leaf(3.0, unit="m/s", low=0.1, high=10.0, source="test", point=True, moves="root")
        window_s: float = setting(0.1, source="test")

    assert moved(Own(), "own", 36.0, 9.0) == {"speed": 6.0}  # held against speed squared

    @parameters.parameters
    class Without:
        threshold: float = leaf(2.0, unit="1", low=0.1, high=10.0, source="test")

    with pytest.raises(InputError, match="'without' has no operating point"):
        moved(Without(), "without", 1.0, 1.0)
