"""Steps of a sensor in the pocket: on a filter that only turns, and on the inertial one."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters, rotations
from pedjax.aids import STEPS, aided
from pedjax.filters import covariance
from pedjax.filters.filter import Filter, still_mean
from pedjax.filters.inertial import INERTIAL
from pedjax.lanes import align, lane_shape, matmul
from pedjax.parameters import leaf
from pedjax.preparing import prepare
from pedjax.system import Need
from pedjax.walks import walk
from tests import tools

BRIEF = 2400
"""Samples of the first strides, some 18 of them."""


class Turning(NamedTuple):
    position: jax.Array
    attitude: jax.Array


@parameters.parameters
class TurningParameters:
    sigma: jax.Array = leaf(
        0.1, unit="rad", low=1e-3, high=1.0, source="test",
        meaning="Standard deviation of the attitude, which nothing changes.",
    )  # fmt: skip


def _start(p, opening):
    force = still_mean(opening, opening.force)
    shape = lane_shape(p, force[0])
    nothing = jnp.zeros((3, *shape))
    attitude = rotations.levelled(align(force, 1, len(shape)) + nothing, nothing[0])
    return Turning(nothing, attitude), covariance.diagonal({"t": p.sigma + nothing})


def _predict(p, estimate, P, sample):
    turned = matmul(estimate.attitude, rotations.exp(sample.dt * sample.rate))
    return estimate._replace(attitude=turned), P


def _correct(estimate, correction):
    turned = matmul(rotations.exp(correction["t"]), estimate.attitude)
    return Turning(estimate.position + correction["p"], turned)


TURNS = Filter("turns", TurningParameters, lambda p: 1.0, _start, _predict, _correct, (("attitude", "t"),))
"""Attitude by the gyroscope, a position that nothing predicts, and a covariance without one."""

WALKER = aided("pocket_walker", TURNS, (STEPS,), role="pocket")
INERTIAL_WALKER = aided("inertial_walker", INERTIAL, (STEPS,), role="pocket")
BARE = aided("bare_pocket", INERTIAL, (), role="pocket")


@pytest.fixture(scope="module")
def worn(pocket):
    return walk(pocket.recording, needs=(Need("pocket"),))


def told(system, worn, count=None, **changes):
    """Parameters and inputs of the first samples."""
    count = count or len(worn)
    values = {f"steps.{name}": x for name, x in changes.items()}
    p = parameters.cast(parameters.replace(system.defaults(), values), float)
    part = replace(worn, sensors={"pocket": worn.imu.crop(0, count)})
    return p, prepare(system, p, part, float, count)


def over(system, p, inputs):
    return tools.scan(system, p, inputs.samples, system.start(p, None, inputs.opening))[1]


def mean_step(pocket):
    """Half the mean length of the right foot's strides, m."""
    swings = pocket.plan.walker.right
    true = np.asarray(swings.lands) < pocket.plan.seconds
    return 0.5 * np.linalg.norm(np.asarray(swings.end - swings.start)[true, :2], axis=1).mean()


@pytest.mark.parametrize("ahead", ["x", "learned"])
def test_a_made_walk_is_as_long_as_it_is_and_goes_where_it_goes(pocket, worn, ahead):
    out = over(WALKER, *told(WALKER, worn, ahead=ahead, length=float(mean_step(pocket))))
    assert (out.status == 0).all()
    place = np.asarray(out.estimate.position)
    path = np.sum(np.hypot(*np.diff(pocket.plan.route, axis=0).T))
    gone = np.sum(np.linalg.norm(np.diff(place, axis=0), axis=1))
    assert gone == pytest.approx(path, rel=0.03)
    assert gone == pytest.approx(float(np.sum(out.more["stride_length"])), rel=1e-9)
    np.testing.assert_array_equal(place[:, 2], 0.0)
    first, last = place[3000] - place[0], place[-1] - place[-2500]  # eastward, then northward
    for leg, yaw in ((first, 0.0), (last, 90.0)):
        assert np.degrees(np.arctan2(leg[1], leg[0])) == pytest.approx(yaw, abs=5.0)


def test_only_the_ends_of_strides_move_it(worn):
    """By twice the length, along the mean of the way the walker faced since the last."""
    p, inputs = told(WALKER, worn, BRIEF, length=0.6)
    out = over(WALKER, p, inputs)
    weight, swung = (np.asarray(x) for x in (out.gates["step"].weight, out.more["swing"]))
    ends = np.flatnonzero(inputs.samples.own["steps"].ends)
    assert 14 < len(ends) < 22
    np.testing.assert_array_equal(np.flatnonzero(weight), np.flatnonzero(swung > p.steps.threshold))
    assert set(np.flatnonzero(weight)) <= set(ends)
    ratio = np.asarray(out.gates["step"].log_ratio)
    np.testing.assert_allclose(ratio[ends], np.log(p.steps.threshold / swung[ends]), rtol=1e-9)
    assert (np.delete(ratio, ends) == 10.0).all()
    np.testing.assert_array_equal(out.more["strides"], np.cumsum(weight))
    x = np.asarray(out.estimate.attitude)[:, :2, 0]
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    moved = np.diff(np.asarray(out.estimate.position), axis=0, prepend=np.zeros((1, 3)))
    since = 0
    for k in ends:
        mean = x[since : k + 1].sum(axis=0)
        expected = 1.2 * weight[k] * mean / np.linalg.norm(mean)
        np.testing.assert_allclose(moved[k, :2], expected, atol=1e-6)
        since = k + 1
    assert not np.delete(moved, ends, axis=0).any()


def test_each_model_gives_its_length(worn):
    p, inputs = told(WALKER, worn, BRIEF)
    own = inputs.samples.own["steps"]
    ends = np.flatnonzero(over(WALKER, p, inputs).gates["step"].weight)
    swung, bounce = own.stride.swing[ends], own.stride.bounce[ends]
    expected = {
        "constant": 0.0 * swung + 0.6,
        "affine": 0.6 + 1.1 * (swung - np.radians(40)),
        "weinberg": 0.3 * bounce**0.25,
    }
    for model, length in expected.items():
        p, _ = told(WALKER, worn, BRIEF, model=model, length=0.6, per_swing=1.1, weinberg=0.3)
        out = over(WALKER, p, inputs)
        np.testing.assert_allclose(out.more["stride_length"][ends], 2 * length, rtol=1e-7)
    idle = {model: parameters.tunable(told(WALKER, worn, BRIEF, model=model)[0].steps) for model in expected}
    assert idle == {
        "constant": ("threshold", "length"),
        "affine": ("threshold", "length", "per_swing"),
        "weinberg": ("threshold", "weinberg"),
    }


@pytest.mark.parametrize("ahead", ["y", "z"])
def test_another_axis_may_point_ahead(worn, ahead):
    """Turn the sensor so that this axis is where x was: the same track."""
    p, inputs = told(WALKER, worn, BRIEF)
    plain = over(WALKER, p, inputs)
    turn = np.roll(np.eye(3), {"y": 1, "z": 2}[ahead], axis=0)  # a rotation of the axes into each other
    imu = worn.imu
    turned = replace(imu, specific_force=imu.specific_force @ turn.T, angular_rate=imu.angular_rate @ turn.T)
    p, other = told(WALKER, replace(worn, sensors={"pocket": turned}), BRIEF, ahead=ahead)
    out = over(WALKER, p, other)
    yaw = plain.estimate.attitude[0] @ np.linalg.inv(out.estimate.attitude[0] @ turn)
    np.testing.assert_allclose(out.estimate.position @ yaw.T, plain.estimate.position, atol=1e-6)


def test_a_correction_of_the_position_alone_suits_the_inertial_filter(worn):
    p, inputs = told(INERTIAL_WALKER, worn, BRIEF)
    bare, plain = told(BARE, worn, BRIEF)
    out, alone = over(INERTIAL_WALKER, p, inputs), over(BARE, bare, plain)
    apart = np.asarray(out.estimate.position - alone.estimate.position)
    ends = np.flatnonzero(out.gates["step"].weight)
    gone = np.linalg.norm(np.diff(apart, axis=0, prepend=np.zeros((1, 3))), axis=1)
    np.testing.assert_allclose(gone[ends], 1.4, rtol=1e-6)
    np.testing.assert_allclose(np.delete(gone, ends), 0.0, atol=1e-9)
    np.testing.assert_allclose(out.estimate.velocity, alone.estimate.velocity, rtol=1e-9)


@pytest.mark.parametrize("ahead", ["x", "learned"])
def test_causal_and_in_chunks_to_the_bit(worn, ahead):
    p, inputs = told(WALKER, worn, BRIEF, ahead=ahead)
    out = over(WALKER, p, inputs)
    p, short = told(WALKER, worn, 1500, ahead=ahead)
    tools.same_bits(jax.tree.map(lambda x: x[:1500], out), over(WALKER, p, short))
    tools.assert_chunks_equal_the_whole(WALKER, p, inputs, 1234)


def test_lanes_are_as_each_alone(worn):
    lengths, limits = jnp.array([0.5, 0.7, 0.9]), jnp.array([0.1, 0.5, 0.9])
    p, inputs = told(WALKER, worn, BRIEF, width=0.2)
    many = over(
        WALKER, parameters.with_leaves(p, {"steps.length": lengths, "steps.threshold": limits}), inputs
    )
    for k in range(3):
        one = over(
            WALKER,
            parameters.with_leaves(p, {"steps.length": lengths[k], "steps.threshold": limits[k]}),
            inputs,
        )
        np.testing.assert_allclose(many.estimate.position[..., k], one.estimate.position, atol=1e-9)
        np.testing.assert_allclose(many.gates["step"].weight[..., k], one.gates["step"].weight, atol=1e-12)


LEAVES = {
    "constant": ("length", "threshold", "width"),
    "affine": ("length", "per_swing", "threshold"),
    "weinberg": ("weinberg", "threshold"),
}


def last_place(p, inputs):
    """Square of the distance to the last position, as a function of leaves, with its slopes."""

    @jax.jit
    @jax.value_and_grad
    def far(values):
        out = over(WALKER, parameters.with_leaves(p, values), inputs)
        return jnp.sum(out.estimate.position[-1] ** 2)

    return far


@pytest.mark.parametrize("model", LEAVES)
def test_slopes_through_soft_strides_equal_differences(worn, model):
    p, inputs = told(WALKER, worn, BRIEF, model=model, width=0.4, threshold=0.6)
    far = last_place(p, inputs)
    values = {f"steps.{name}": jnp.asarray(getattr(p.steps, name)) for name in LEAVES[model]}
    slopes = far(values)[1]
    for path, x in values.items():
        h = 1e-6
        up, down = (float(far({**values, path: x + s})[0]) for s in (h, -h))
        assert slopes[path] == pytest.approx((up - down) / (2 * h), rel=1e-5), path
        assert abs(slopes[path]) > 1e-3, path


def test_slopes_through_hard_strides(worn):
    """By the length as ever, by the threshold none; with a soft slope behind a hard value, one."""
    p, inputs = told(WALKER, worn, BRIEF)
    values = {"steps.length": p.steps.length, "steps.threshold": p.steps.threshold}
    distance, slopes = last_place(p, inputs)(values)
    assert slopes["steps.length"] == pytest.approx(2 * float(distance) / 0.7, rel=1e-6)
    assert slopes["steps.threshold"] == 0.0
    p, _ = told(WALKER, worn, BRIEF, width=0.4, straight_through=True)
    same, slopes = last_place(p, inputs)(values)
    assert same == distance
    assert slopes["steps.threshold"] < 0
