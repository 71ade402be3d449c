"""Fits at the edge: refusals, warnings, the choice of a method, a walked loop from its samples."""

import dataclasses

import numpy as np
import pytest

from pedjax.calibration import clouds, fitting
from pedjax.errors import InputError
from pedjax.recording import Inertial, Stream
from tests.calibration.common import directions, table_one
from tests.reference.calibration import attitudes, earth, ellipse, turn

RNG = np.random.default_rng(8)
GOOD = 0.1 * table_one(RNG, 60, 1.0)


def cloud(field, force=None, quiet=None):
    time = np.arange(len(field)) / 10.0
    return clouds.Cloud("spin", time, np.asarray(field, float), force, quiet)


def loop(points, turn=None):
    points = np.column_stack([points, np.full(len(points), -40.0)])
    turn = np.linspace(0, 2 * np.pi, len(points)) if turn is None else turn
    return fitting.Loop(points, turn)


ROUND = ellipse(np.linspace(0, 2 * np.pi, 17)[:-1], (20.0, 18.0), 0.5, np.array([3.0, -2.0]))


def test_a_good_cloud_needs_no_words():
    fit = fitting.fit_cloud(cloud(GOOD), strength=48.0, form="upper")
    assert fit.warnings == ()
    assert fit.method == "algebraic + refined"
    m = (GOOD - fit.calibration.hard_iron) @ fit.calibration.matrix.T
    np.testing.assert_allclose(np.linalg.norm(m, axis=1).mean(), 48.0, rtol=1e-4)
    assert fit.calibration.hard_iron.dtype == np.float64
    assert np.abs(np.tril(fit.calibration.matrix, -1)).max() == 0
    np.testing.assert_array_equal(fit.calibration.level_matrix, np.eye(2))


@pytest.mark.parametrize(
    ("field", "said"),
    [
        (GOOD[:8], "8 samples of the field are too few, this method needs 9"),
        (np.where(np.arange(60)[:, None] == 7, np.nan, GOOD), "are not numbers, the first is number 7"),
        (np.tile(GOOD[0], (60, 1)), "are the same; turn the sensor"),
    ],
)
def test_clouds_that_are_refused(field, said):
    with pytest.raises(InputError, match="spin: ") as error:
        fitting.fit_cloud(cloud(field))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("field", "said"),
    [
        (48 * directions(RNG, 60) * [1, 1, 0.05], "nearly in a plane"),
        (5 * directions(RNG, 60), "is not the earth's"),
        (48 * directions(RNG, 60) * RNG.uniform(0.8, 1.2, (60, 1)), "not the same everywhere"),
        (np.column_stack([RNG.normal(size=(60, 2)) * 3, np.full(60, 40.0) + RNG.normal(size=60)]), "cover"),
    ],
)
def test_clouds_that_are_warned_of(field, said):
    lines = fitting.fit_cloud(cloud(field)).warnings
    assert any(said in line for line in lines), lines


def test_no_ellipsoid_is_said():
    turn, up = (a.ravel() for a in np.meshgrid(np.linspace(0, 6, 10), np.linspace(-1, 1, 6)))
    waist = 20 * np.column_stack([np.cosh(up) * np.cos(turn), np.cosh(up) * np.sin(turn), np.sinh(up)])
    fit = fitting.fit_cloud(cloud(waist), refined=False)
    assert any("no ellipsoid" in line for line in fit.warnings)
    np.testing.assert_allclose(fit.calibration.matrix, np.eye(3), atol=1e-9)


def spun(rotation, seconds, noise=0.05):
    """A cloud of 60 attitudes in other axes than the accelerometer's, the first `seconds` at rest."""
    rng = np.random.default_rng(2)
    c = attitudes(rng, 60)
    field = np.einsum("nji,j->ni", c, earth(0.0, 1.1, 48.0)) @ rotation + noise * rng.normal(size=(len(c), 3))
    return cloud(field, np.einsum("nji,j->ni", c, [0, 0, 9.81]), np.arange(60) < 10 * seconds)


def test_alignment_is_applied_where_it_is_sure():
    rotation = turn(0.03, -0.05, 0.1)
    fit = fitting.fit_cloud(spun(rotation, 6))
    assert fit.diagnostics["aligned"]
    np.testing.assert_allclose(fit.calibration.matrix @ rotation.T, np.eye(3), atol=0.003)
    np.testing.assert_allclose(fit.diagnostics["inclination_deg"], np.rad2deg(1.1), atol=0.1)
    plain = fitting.fit_cloud(spun(rotation, 6), aligned=False)
    np.testing.assert_allclose(plain.calibration.matrix, plain.calibration.matrix.T)
    assert "aligned" not in plain.diagnostics


def test_alignment_is_left_out_where_it_is_not():
    short = fitting.fit_cloud(spun(np.eye(3), 2))
    assert any("at rest for 2.0 s" in line for line in short.warnings)
    wild = spun(np.eye(3), 6)
    shaken = clouds.Cloud(
        "spin", wild.time, wild.field, wild.force + RNG.normal(size=wild.force.shape), wild.quiet
    )
    fit = fitting.fit_cloud(shaken)
    assert not fit.diagnostics["aligned"]
    assert any("not aligned" in line for line in fit.warnings)
    np.testing.assert_allclose(fit.calibration.matrix, fit.calibration.matrix.T)


def test_quiet_samples_are_those_at_rest():
    time = np.arange(2000) / 200.0
    force = np.tile([0, 0, 9.81], (2000, 1))
    moving = (time > 4) & (time < 6)
    force[moving] += np.random.default_rng(0).normal(0, 3, (moving.sum(), 3))
    found = clouds.cloud("x", Stream(time[::4], np.ones((500, 3))), Stream(time, force))
    assert found.quiet[(found.time > 0.3) & (found.time < 3.7)].all()
    assert not found.quiet[(found.time > 4.05) & (found.time < 5.95)].any()
    assert not found.quiet[[0, -1]].any()


def test_a_loop():
    fit = fitting.fit_loop("walk", loop(ROUND), strength=21.0)
    assert fit.warnings == ()
    np.testing.assert_allclose(fit.calibration.level_offset, [3.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(fit.extra["corrected"], axis=1), 21.0, rtol=1e-9)
    np.testing.assert_allclose(fit.diagnostics["tau"], 0.9)
    np.testing.assert_array_equal(fit.calibration.matrix, np.eye(3))


@pytest.mark.parametrize(
    ("points", "method", "said"),
    [
        (ROUND[:4], "lsq", "4 stances are too few, this method needs 5"),
        (ROUND[:3], "minmax", "3 stances are too few, this method needs 4"),
        (np.outer(np.arange(9.0), [1, 2]), "lsq", "lie on a line"),
        (np.tile(ROUND[0], (9, 1)), "lsq", "all 9 stances are the same"),
        (np.where(np.arange(16)[:, None] == 3, np.nan, ROUND), "lsq", "the first is number 3"),
    ],
)
def test_loops_that_are_refused(points, method, said):
    with pytest.raises(InputError) as error:
        fitting.fit_loop("walk", loop(points), method)
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("points", "turn", "said"),
    [
        (ROUND[:10], None, "less than 270"),
        (ROUND, np.linspace(0, 4.5, 16), "not closed: the walk turns by 258 deg"),
        (ROUND * RNG.uniform(0.7, 1.3, (16, 1)), None, "was not the same along the walk"),
        (np.stack([np.cosh(x := np.linspace(-2, 2, 16)), np.sinh(x)], 1), None, "on no ellipse"),
    ],
)
def test_loops_that_are_warned_of(points, turn, said):
    lines = fitting.fit_loop("walk", loop(points, turn)).warnings
    assert any(said in line for line in lines), lines


def test_choice():
    flat = cloud(48 * directions(RNG, 60) * [1, 1, 0.05])
    mixed = cloud(48 * directions(RNG, 60) * RNG.uniform(0.7, 1.3, (60, 1)))
    cases = [
        (cloud(GOOD), loop(ROUND), "algebraic", "in one field"),
        (flat, loop(ROUND), "lsq", "in a plane (flatness 0.00"),
        (mixed, loop(ROUND), "lsq", "fits no single ellipsoid"),
        (flat, None, "algebraic", "no walk"),
        (flat, loop(ROUND[:3]), "algebraic", "no walk"),
        (cloud(GOOD[:5]), loop(ROUND), "lsq", "too few"),
    ]
    for field, walked, method, why in cases:
        chosen, reason = fitting.choose(field, walked)
        assert chosen == method
        assert why in reason


def walk(steps=12, rate=100.0):
    """A foot that stands level for 0.5 s, pitches while it turns by 30 deg, and so on."""
    still, swing = round(0.5 * rate), round(0.5 * rate)
    yaw, pitch = [0.0], [0.0]
    for _ in range(steps):
        yaw += [yaw[-1]] * still + list(yaw[-1] + np.deg2rad(30) * np.linspace(0, 1, swing + 1)[1:])
        pitch += [0.0] * still + list(0.8 * np.sin(np.linspace(0, 2 * np.pi, swing + 1)[1:]))
    yaw += [yaw[-1]] * still
    pitch += [0.0] * still
    c = np.array([turn(0.1, p, y) for y, p in zip(yaw, pitch, strict=True)])
    delta = np.einsum("nji,njk->nik", c[:-1], c[1:])
    axial = 0.5 * np.stack(
        [delta[:, 2, 1] - delta[:, 1, 2], delta[:, 0, 2] - delta[:, 2, 0], delta[:, 1, 0] - delta[:, 0, 1]], 1
    )
    size = np.linalg.norm(axial, axis=1, keepdims=True)
    axial *= np.where(size > 1e-9, np.arcsin(size) / np.maximum(size, 1e-12), 1.0)
    angular = np.concatenate([np.zeros((1, 3)), axial * rate])
    lift = np.abs(np.gradient(pitch)) * 100
    force = np.einsum("nji,nj->ni", c, np.column_stack([lift, 0 * lift, 9.81 + lift]))
    field = np.einsum("nji,j->ni", c, earth(0.0, 1.1, 48.0))
    time = np.arange(len(yaw)) / rate
    return Inertial(time, np.full(len(time), 1 / rate), force, angular, field)


def test_a_walk_becomes_a_loop():
    imu = walk()
    found = fitting.walk_loop(imu)
    assert len(found.points) == 13
    np.testing.assert_allclose(np.diff(found.turn), np.deg2rad(30), atol=1e-3)
    level = 48 * np.cos(1.1)
    np.testing.assert_allclose(np.hypot(*found.points[:, :2].T), level, rtol=1e-3)
    np.testing.assert_allclose(found.points[:, 2], -48 * np.sin(1.1), atol=0.1)
    fit = fitting.fit_loop("walk", found)
    assert fit.warnings == ()
    np.testing.assert_allclose(fit.calibration.level_offset, 0, atol=0.02)
    np.testing.assert_allclose(fit.strength, level, rtol=1e-3)


def test_a_sensor_with_its_x_axis_up_has_another_axis_ahead():
    """The same walk in other axes: what was x is y now, and ahead."""
    imu, plain = walk(), fitting.walk_loop(walk())
    axes = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turned = dataclasses.replace(
        imu,
        specific_force=imu.specific_force @ axes.T,
        angular_rate=imu.angular_rate @ axes.T,
        magnetic_field=imu.magnetic_field @ axes.T,
    )
    found = fitting.walk_loop(turned)
    assert (plain.ahead, found.ahead) == (0, 1)
    np.testing.assert_allclose(found.points, plain.points, atol=1e-9)
    np.testing.assert_allclose(found.turn, plain.turn, atol=1e-9)
    assert fitting.fit_loop("walk", found).calibration.level_ahead == 1


def test_a_walk_without_stance_or_field():
    imu = walk()
    assert len(fitting.walk_loop(imu, threshold=1e-9).points) == 0
    bare = Inertial(imu.time, imu.dt, imu.specific_force, imu.angular_rate)
    with pytest.raises(InputError, match="no magnetometer"):
        fitting.walk_loop(bare)
