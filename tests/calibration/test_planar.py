"""Planar calibration against closed forms, Ma's table 1, an independent reference; degenerate loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.calibration import planar
from tests.calibration.common import PLANAR, assert_slopes, jit, sloped, soft
from tests.reference import calibration as reference

OFFSET, ETA, TAU, LONG = np.array([137.95, 75.26]), 0.973, 0.896, 400.0  # mGs and rad, Ma's table 1


def loop(count, rng=None, noise=0.0, phase=0.0, eta=ETA, tau=TAU):
    angles = phase + 2 * np.pi * np.arange(count) / count
    points = reference.ellipse(angles, (LONG, tau * LONG), eta, OFFSET)
    return points + (0.0 if rng is None else noise * rng.normal(size=points.shape))


def axis_error(found, true):
    """Angle between two axes."""
    return np.abs(np.angle(np.exp(2j * (found - true)))) / 2


def worst_heading(offset, matrix, eta=ETA, tau=TAU):
    """Largest error in deg of the heading round the true ellipse, less its mean."""
    angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    points = reference.ellipse(angles, (LONG, tau * LONG), eta, OFFSET)
    x, y = ((points - np.asarray(offset)) @ np.asarray(matrix).T).T
    apart = np.exp(1j * (np.arctan2(y, x) - angles))
    return np.rad2deg(np.abs(np.angle(apart / apart.mean())).max())


@pytest.mark.parametrize("eta", [0.4, 0.973, 1.9, 2.8, -0.6, -2.0, 0.0, np.pi / 2])
def test_conic_is_recovered_in_every_quadrant(eta):
    found = PLANAR["lsq"](loop(24, phase=0.3, eta=eta))
    np.testing.assert_allclose(found.offset, OFFSET, rtol=1e-9)
    np.testing.assert_allclose(found.tau, TAU, rtol=1e-9)
    assert axis_error(found.eta, eta) < 1e-9
    np.testing.assert_allclose(found.radius, LONG * np.sqrt(TAU), rtol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found.matrix), 1.0, rtol=1e-9)
    assert found.residual < 1e-9 * LONG
    assert found.ellipse
    assert found.enough
    assert worst_heading(found.offset, found.matrix, eta=eta) < 1e-7


@pytest.mark.parametrize("method", ["minmax", "soft"])
@pytest.mark.parametrize("eta", [0.4, 1.9, 2.8, -0.6, -2.0])
def test_minmax_is_right_in_every_quadrant(method, eta):
    """With points at the axes and at the extremes nothing is lost; soft at a low temperature."""
    extremes = [np.arctan2(TAU * np.tan(eta), 1.0), np.arctan2(-TAU, np.tan(eta))]
    at = np.array([0, np.pi / 2, *(-e for e in extremes[:1]), extremes[1]])
    at = np.concatenate([at, at + np.pi, np.linspace(0, 2 * np.pi, 12)])
    points = reference.ellipse(at, (LONG, TAU * LONG), eta, OFFSET)
    found = PLANAR["minmax"](points) if method == "minmax" else soft(points, 1e-3)
    expected = reference.ma(points)
    np.testing.assert_allclose(found.offset, expected[0], atol=0.01)
    assert axis_error(found.eta, expected[1]) < 0.02
    assert abs(found.tau - expected[2]) < 1e-4


def test_minmax_is_the_paper_with_atan2(rng):
    for _ in range(20):
        points = loop(15, rng, 4.0, rng.uniform(0, 6), eta=rng.uniform(-3, 3))
        found = PLANAR["minmax"](points)
        offset, eta, tau, matrix = reference.ma(points)
        np.testing.assert_allclose(found.offset, offset, rtol=1e-12)
        np.testing.assert_allclose(found.matrix, matrix, atol=1e-12)
        np.testing.assert_allclose(found.tau, tau, rtol=1e-12)
        assert axis_error(found.eta, eta) < 1e-12
        corrected = np.linalg.norm((points - offset) @ matrix.T, axis=1)
        np.testing.assert_allclose(found.radius, np.hypot(*(points - offset).T).min(), rtol=1e-12)
        np.testing.assert_allclose(found.residual, np.sqrt(np.mean((corrected - found.radius) ** 2)))


def test_printed_arc_sine_mirrors_half_of_all_loops(rng):
    """Noise-free loops of 24 stances, Eq. 8 with each function: heading errors in deg."""
    right, printed = [], []
    for _ in range(200):
        points = loop(24, phase=rng.uniform(0, 2 * np.pi))
        for worst, arc_sine in ((right, False), (printed, True)):
            offset, _, _, matrix = reference.ma(points, arc_sine)
            worst.append(worst_heading(offset, matrix))
    assert max(right) < 1.0
    assert 0.3 < np.mean(np.array(printed) > 4.0) < 0.7


def test_conic_equals_the_reference(rng):
    for _ in range(10):
        points = loop(14, rng, 4.0, rng.uniform(0, 6), eta=rng.uniform(-3, 3))
        found = PLANAR["lsq"](points)
        centre, w = reference.conic(points)
        np.testing.assert_allclose(found.offset, centre, rtol=1e-9)
        np.testing.assert_allclose(found.matrix @ found.matrix / found.radius**2, w, rtol=1e-7, atol=1e-15)


def test_table_one_of_ma():
    """Two loops of 15 stances (24 deg) with 4 mGs of noise, 300 walks: what share of them is within 4 mGs,
    3 deg and 0.03, and how far the heading is off."""
    rng = np.random.default_rng(11)
    errors = {name: [] for name in PLANAR}
    for _ in range(300):
        phase = rng.uniform(0, 2 * np.pi)
        points = np.concatenate([loop(15, rng, 4.0, phase), loop(15, rng, 4.0, phase + 0.2)])
        for name, fit in PLANAR.items():
            found = fit(points) if name != "soft" else soft(points, 10.0)
            errors[name].append(
                [
                    np.linalg.norm(found.offset - OFFSET),
                    np.rad2deg(axis_error(found.eta, ETA)),
                    abs(found.tau - TAU),
                    worst_heading(found.offset, found.matrix),
                ]
            )
    share = {name: (np.array(e)[:, :3] < [4.0, 3.0, 0.03]).mean(axis=0) for name, e in errors.items()}
    heading = {name: np.array(e)[:, 3].mean() for name, e in errors.items()}
    assert (share["lsq"] >= [0.99, 0.93, 0.99]).all(), share
    assert heading["lsq"] < 0.5 < heading["minmax"], heading
    assert share["lsq"][1] > share["minmax"][1] + 0.3, share
    assert heading["soft"] < heading["minmax"], heading


def test_what_acts_in_stance_only_needs_the_walked_loop(rng):
    """Ma's Fig. 7: floor and shoe add an offset and stretch the level field in stance. A calibration from
    free turning, exact as it is, knows nothing of them."""
    yaw = np.linspace(0, 4 * np.pi, 31)[:-1]
    clean = 250 * np.stack([np.sin(yaw), np.cos(yaw)], axis=1)
    stance = clean @ np.array([[1.0, 0.04], [0.04, 0.9]]) + [40.0, -30.0] + 4 * rng.normal(size=clean.shape)
    found = PLANAR["lsq"](stance)

    def worst(points):
        apart = np.exp(1j * (np.arctan2(*points.T) - yaw))
        return np.rad2deg(np.abs(np.angle(apart / apart.mean())).max())

    assert worst((stance - found.offset) @ found.matrix.T) < 5.0
    assert worst(stance) > 2 * worst((stance - found.offset) @ found.matrix.T)
    assert worst(stance) > 10.0


def test_soft_becomes_minmax_as_the_temperature_falls(rng):
    points = loop(13, rng, 4.0)
    hard = PLANAR["minmax"](points)
    apart = []
    for temperature in (10.0, 1.0, 0.1):
        found = soft(points, temperature)
        apart.append(
            float(np.abs(found.matrix - hard.matrix).max() + np.abs(found.offset - hard.offset).max())
        )
    assert apart[0] > apart[1] > apart[2]
    np.testing.assert_allclose(soft(points, 1e-3).matrix, hard.matrix, atol=1e-6)
    np.testing.assert_allclose(soft(points, 1e-3).offset, hard.offset, atol=1e-6)


@pytest.mark.parametrize("method", list(PLANAR))
def test_weights(rng, method):
    points = loop(14, rng, 4.0)
    plain = PLANAR[method](points)
    double = PLANAR[method](points, weights=np.full(14, 2.0))
    for a, b in zip(plain, double, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    if method == "lsq":
        twice = PLANAR["lsq"](np.concatenate([points, points[:3]]))
        weighted = PLANAR["lsq"](points, weights=np.array([2.0] * 3 + [1.0] * 11))
        np.testing.assert_allclose(weighted.offset, twice.offset, rtol=1e-9)
        assert not np.allclose(weighted.offset, plain.offset, rtol=1e-4)


def test_single_precision():
    points = loop(20, np.random.default_rng(2), 4.0)
    for name, fit in PLANAR.items():
        single, double = fit(points.astype(np.float32)), fit(points)
        assert single.offset.dtype == single.matrix.dtype == jnp.float32
        np.testing.assert_allclose(single.offset, double.offset, rtol=3e-5, err_msg=name)
        np.testing.assert_allclose(single.matrix, double.matrix, atol=1e-4, err_msg=name)


def flat(found):
    parts = (
        found.offset,
        found.matrix.ravel(),
        jnp.stack([found.radius, found.eta, found.tau, found.residual]),
    )
    return jnp.concatenate(parts), found


SLOPES = {
    "lsq": sloped(lambda x, w: flat(planar.lsq(x, w))),
    "minmax": sloped(lambda x, w: flat(planar.minmax(x, w))),
    "soft": sloped(lambda x, w: flat(planar.soft(x, 20.0, w))),
}


@pytest.mark.parametrize("method", ["lsq", "soft"])
def test_slopes(rng, method):
    assert_slopes(SLOPES[method], loop(20, rng, 6.0), 10, rng)


def test_slope_by_temperature(rng):
    points = loop(20, rng, 6.0)
    value = jit(jax.value_and_grad(lambda t: jnp.sum(flat(planar.soft(points, t))[0])))
    h = 1e-3
    expected = (value(20.0 + h)[0] - value(20.0 - h)[0]) / (2 * h)
    np.testing.assert_allclose(value(20.0)[1], expected, rtol=1e-6)


ARC = np.linspace(-2, 2, 20)
ODD = {
    "circle": reference.ellipse(np.linspace(0, 6, 20), (20.0, 20.0), 0.0, np.zeros(2)),
    "line": np.stack([ARC, 0.5 * ARC], axis=1),
    "constant": np.tile([2.0, 3.0], (20, 1)),
    "zero": np.zeros((20, 2)),
    "hyperbola": 10 * np.stack([np.cosh(ARC), np.sinh(ARC)], axis=1),
    "one point": np.concatenate([[[3.0, 4.0]], np.full((19, 2), np.nan)]),
    "nothing": np.full((20, 2), np.nan),
}
USABLE = {"circle": (True, True), "hyperbola": (False, True)}


@pytest.mark.parametrize("case", list(ODD))
@pytest.mark.parametrize("method", list(PLANAR))
def test_degenerate_loops(case, method):
    points = ODD[case]
    known = np.isfinite(points).all(axis=1).astype(float)
    (value, found), slopes = SLOPES[method](points, known, np.ones(10))
    assert np.isfinite(value)
    assert all(np.isfinite(s).all() for s in slopes)
    if case in USABLE:
        assert bool(found.enough)
        if method == "lsq":
            assert bool(found.ellipse) == USABLE[case][0]
    else:
        assert not found.enough


def test_a_hyperbola_falls_back_on_the_best_circle():
    points = ODD["hyperbola"]
    found = PLANAR["lsq"](points)
    design = np.column_stack([2 * points, np.ones(len(points))])
    expected = np.linalg.lstsq(design, np.sum(points**2, axis=1), rcond=None)[0]
    np.testing.assert_allclose(found.offset, expected[:2], atol=1e-8)
    np.testing.assert_allclose(found.matrix, np.eye(2))
    np.testing.assert_allclose(found.radius, np.sqrt(expected[2] + expected[:2] @ expected[:2]))
    assert (float(found.tau), float(found.eta)) == (1.0, 0.0)


@pytest.mark.parametrize("covered", [360, 300, 200, 90])
def test_gap(covered):
    angles = np.deg2rad(np.linspace(-170, -170 + covered, 37)[:-1])
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    padded = np.concatenate([points, np.zeros((3, 2))])
    found = planar.azimuth_gap(jnp.asarray(padded), jnp.asarray([1.0] * 36 + [0.0] * 3))
    np.testing.assert_allclose(np.rad2deg(found), 360 - covered + covered / 36, rtol=1e-9)
