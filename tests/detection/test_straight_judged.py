"""Straight-walking detectors on a walk that is straight first and goes round in a circle then."""

import numpy as np
import pytest

from pedjax import parameters
from pedjax.aids import ZERO_VELOCITY, aided
from pedjax.detection import Wanted, judge_straight
from pedjax.detection.straight import straight_walk
from pedjax.errors import InputError
from pedjax.filters.inertial import INERTIAL
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import simulate
from pedjax.systems import SYSTEMS

IEZ = SYSTEMS["iez"]
PARAMS = parameters.replace(IEZ.defaults(), {"heuristic.straight.strides": 3})


@pytest.fixture(scope="module")
def made():
    turn = np.linspace(0, 2 * np.pi, 25)
    circle = tuple((20.0 + 5 * np.sin(a), 5 - 5 * np.cos(a)) for a in turn)
    scenario = Scenario(
        name="line and circle",
        rate_hz=100.0,
        standing_s=2.0,
        legs=(Leg(points=((0.0, 0.0), (20.0, 0.0))), Leg(points=circle, spline=True)),
        sensors={"foot": "xsens_mtw"},
        field={"kind": "munich"},
        landmarks=((10.0, 0.0), (20.0, 10.0)),
    )
    walked = simulate(scenario, 1)
    return walked.recording, walked.truth["foot"]


def test_windows_and_what_is_true_of_them(made):
    walk = straight_walk(*made, "iez", PARAMS)
    assert walk.headings.shape == (4, len(walk.bent))
    first, last = walk.headings[:, 3], walk.bent[-4:]
    assert np.abs(first).max() < 0.15  # along x
    np.testing.assert_allclose(last, 2 * 1.35 / 5.0, atol=0.15)  # half a window is two strides of the circle
    assert walk.bent[:8].max() < np.radians(5)


def test_a_circle_is_told_from_a_line(made):
    judged = judge_straight(IEZ, PARAMS, [made])
    assert 0.2 < judged.entries[0]["straight_fraction"] < 0.6
    curves = judged.curves(draws=50)["all"]
    assert set(curves) == {"change", "spread"}
    for name, found in curves.items():
        assert found.auc.value > 0.95, name
    reached = judged.at_point("spread", curves["spread"].roc, Wanted(0.9, "detection"))
    assert reached.p_detection >= 0.9
    assert reached.parameters["heuristic.straight.detector"] == "spread"
    assert 0.005 < reached.parameters["heuristic.straight.angle"] < 0.4


def test_who_cannot_be_asked(made):
    bare = aided("bare", INERTIAL, (ZERO_VELOCITY,))
    with pytest.raises(InputError, match="the system 'bare' has no heading heuristic"):
        judge_straight(bare, bare.defaults(), [made])
    rushing = parameters.replace(PARAMS, {"heuristic.straight.shortest": 9.0})
    with pytest.raises(InputError, match="there is no window of 4 strides in a row"):
        straight_walk(*made, "iez", rushing)
