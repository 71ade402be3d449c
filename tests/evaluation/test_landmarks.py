"""Landmark errors against a search for the best alignment, and their slopes where points coincide."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.evaluation.landmarks import ALIGNMENTS, align, landmark_errors
from pedjax.walks import reference_of
from tests.reference import evaluation as oracle

align_jit = jax.jit(align, static_argnums=2)
errors_jit = jax.jit(landmark_errors, static_argnums=2)


@pytest.fixture
def points(rng):
    """A turned, shifted, noisy copy of twelve surveyed points, some with unknown coordinates."""
    truth = rng.normal(0, 8, (12, 3)) * [1, 1, 0.2]
    yaw = 2.1
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    estimate = truth @ turn + [3.0, -4.0, 1.0] + rng.normal(0, 0.3, (12, 3))
    truth[[0, 5], :2] = np.nan
    truth[[1, 5 + 1], 2] = np.nan
    return estimate, truth


@pytest.mark.parametrize("alignment", ALIGNMENTS)
@pytest.mark.parametrize("known", ["all", "some"])
def test_alignment_and_errors_equal_the_search(points, alignment, known):
    estimate, truth = points
    if known == "all":
        truth = np.nan_to_num(truth, nan=1.0)
    laid, _, _ = oracle.align(estimate, truth, alignment)
    reference = reference_of(truth)
    np.testing.assert_allclose(align_jit(estimate, reference, alignment), laid, atol=1e-6)
    expected = oracle.errors(laid, truth, 100.0)
    found = errors_jit(estimate, reference, alignment)
    for name in ("rms_2d", "mean_2d", "max_2d", "final_2d", "rms_3d"):
        assert float(getattr(found, name)) == pytest.approx(expected[name], abs=1e-6), name
    assert float(found.armse) == pytest.approx(expected["armse"], abs=1e-6)


def test_closed_form_is_no_worse_than_any_search(points, rng):
    estimate, truth = points
    found = float(errors_jit(estimate, reference_of(truth), "yaw_translation").rms_2d)
    for _ in range(200):
        yaw, shift = rng.uniform(-np.pi, np.pi), np.array([*rng.normal(0, 6, 2), 0.0])
        tried = oracle.errors(oracle.apply_alignment(estimate, yaw, shift), truth, 1.0)["rms_2d"]
        assert found <= tried + 1e-9


def test_pyshoe_armse_is_the_mean_of_the_rms_over_two_axes(points):
    estimate, truth = points
    truth = np.nan_to_num(truth)
    difference = (estimate - truth)[:, :2]
    expected = np.mean(np.sqrt(np.mean(difference**2, axis=1)))
    assert float(errors_jit(estimate, reference_of(truth), "none").armse) == pytest.approx(expected)


def test_errors_do_not_depend_on_what_is_aligned_away(points):
    estimate, truth = points
    moved = oracle.apply_alignment(estimate, 1.3, np.array([7.0, -2.0, 3.0]))
    for alignment in ("yaw", "yaw_translation"):
        for a, b in zip(
            *(errors_jit(e, reference_of(truth), alignment) for e in (estimate, moved)), strict=True
        ):
            assert float(a) == pytest.approx(float(b), abs=1e-12)


def test_no_known_height_and_no_known_point():
    flat = reference_of(np.array([[0.0, 0.0, np.nan], [1.0, 0.0, np.nan], [0.0, 2.0, np.nan]]))
    estimate = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 2.0], [0.0, 2.0, 3.0]])
    found = errors_jit(estimate, flat, "yaw_translation")
    assert np.isnan(found.rms_3d)
    assert float(found.rms_2d) == pytest.approx(0.0, abs=1e-12)
    nothing = errors_jit(estimate, reference_of(np.full((3, 3), np.nan)), "yaw_translation")
    assert float(nothing.rms_2d) == 0.0


def test_one_point_and_equal_points_fix_no_yaw():
    estimate = np.array([[1.0, 2.0, 3.0]] * 3)
    reference = reference_of(np.array([[4.0, 4.0, 4.0]] * 3))
    for count in (1, 3):
        one = jax.tree.map(lambda x, n=count: x[:n], reference)
        for alignment in ("yaw", "yaw_translation"):
            laid = np.asarray(align_jit(estimate[:count], one, alignment))
            np.testing.assert_allclose(laid, 4.0, atol=1e-12)


def test_padding_weighs_nothing(points):
    estimate, truth = points
    padded = np.concatenate([truth, np.full((5, 3), np.nan)])
    for alignment in ALIGNMENTS:
        alone = errors_jit(estimate, reference_of(truth), alignment)
        more = errors_jit(np.concatenate([estimate, 99 * np.ones((5, 3))]), reference_of(padded), alignment)
        np.testing.assert_allclose(alone, more, rtol=1e-12)


@pytest.mark.parametrize("alignment", ALIGNMENTS)
def test_lanes_equal_one_by_one(points, rng, alignment):
    estimate, truth = points
    many = estimate[..., None, None] + rng.normal(0, 1, (12, 3, 3, 2))
    reference = reference_of(truth)
    together = errors_jit(many, jax.tree.map(lambda x: x[..., None] * jnp.ones(2), reference), alignment)
    for s in range(3):
        for r in range(2):
            alone = errors_jit(many[..., s, r], reference, alignment)
            np.testing.assert_allclose([x[s, r] for x in together], alone, rtol=1e-12)


@pytest.mark.parametrize("alignment", ALIGNMENTS)
@pytest.mark.parametrize("case", ["perfect", "equal", "single", "unknown", "zero"])
def test_slopes_are_finite_where_points_coincide(points, alignment, case):
    estimate, truth = points
    truth = {
        "perfect": estimate,
        "equal": np.ones_like(truth),
        "single": np.where(np.arange(12)[:, None] == 4, truth, np.nan),
        "unknown": np.full_like(truth, np.nan),
        "zero": np.zeros_like(truth),
    }[case]
    estimate = np.zeros_like(estimate) if case == "zero" else estimate

    @partial(jax.jit, static_argnums=0)
    def slopes(name, x):
        return jax.grad(lambda x: getattr(landmark_errors(x, reference_of(truth), alignment), name))(x)

    for name in ("rms_2d", "mean_2d", "armse", *(["rms_3d"] if case != "unknown" else [])):
        assert np.isfinite(slopes(name, jnp.asarray(estimate))).all(), name


def test_slope_of_the_aligned_loss_equals_differences(points):
    estimate, truth = points
    reference = reference_of(truth)

    def loss(x):
        return landmark_errors(x, reference, "yaw_translation").armse

    slope = jax.jit(jax.grad(loss))(jnp.asarray(estimate))
    step = 1e-5
    for k, c in ((0, 0), (3, 1), (7, 0), (5, 1)):
        bump = np.zeros_like(estimate)
        bump[k, c] = step
        up, down = (
            float(errors_jit(estimate + s * bump, reference, "yaw_translation").armse) for s in (1, -1)
        )
        assert float(slope[k, c]) == pytest.approx((up - down) / (2 * step), abs=1e-9)
    assert float(slope[5, 0]) == 0.0  # x and y unknown


def test_what_is_not_a_number_stays_so(points):
    estimate, truth = points
    broken = estimate.copy()
    broken[3, 0] = np.nan
    assert np.isnan(errors_jit(broken, reference_of(truth), "none").rms_2d)
