"""Six stance detectors against naive loops, for every rule and window."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.detectors import stance
from pedjax.detectors.stance import DETECTORS, RULES, StanceParameters
from pedjax.errors import InputError
from tests.reference import detectors as naive

RATE, GRAVITY, COUNT = 100.0, 9.8029, 41
NEVER = 1e6
"""Times its threshold: what is not a window."""


def chosen(detector, rule="causal", width=5):
    return parameters.replace(
        StanceParameters(), {"detector": detector, "rule": rule, f"{detector}.window_s": width / RATE}
    )


@pytest.fixture(scope="module")
def imu():
    rng = np.random.default_rng(8)
    moving = (np.arange(COUNT) % 17 > 7)[:, None]
    force = (
        np.array([0.4, -0.3, 9.7]) + rng.normal(0, 0.1, (COUNT, 3)) + moving * rng.normal(0, 6, (COUNT, 3))
    )
    rate = rng.normal(0, 0.05, (COUNT, 3)) + moving * rng.normal(0, 3, (COUNT, 3))
    return force, rate


def reference(p, imu, width):
    """Statistic of each trailing window over its threshold, so that EPS has one number too."""
    force, rate = imu
    own = p.chosen()[1]
    if p.detector == "eps":
        limits = [own.energy, own.product, own.total, own.rate_variance, own.rate_energy]
        return (naive.eps(force, rate, width) / limits).max(axis=1)
    found = {
        "shoe": lambda: naive.shoe(
            force, rate, width, p.shoe.sigma_accelerometer, p.shoe.sigma_gyroscope, GRAVITY
        ),
        "ared": lambda: naive.ared(rate, width),
        "amvd": lambda: naive.amvd(force, width),
        "mag": lambda: naive.mag(force, width, p.mag.sigma_accelerometer, GRAVITY),
        "mbgtd": lambda: naive.mbgtd(force, width),
    }[p.detector]()
    return found / own.threshold


@lru_cache
def compiled(width, rules=RULES):
    """Statistic over threshold of all detectors and rules in one program."""

    def one(p, force, rate):
        return stance.statistic(p, force, rate, RATE, GRAVITY) / p.chosen()[0].threshold(p.chosen()[1])

    pairs = [(d, r) for d in DETECTORS for r in rules]
    return jax.jit(lambda f, w: {pair: one(chosen(*pair, width), f, w) for pair in pairs})


@partial(jax.jit, static_argnums=0)
def log_ratio_of(p, force, rate):
    return stance.log_ratio(
        p, jnp.moveaxis(stance.evidence(p, force, rate, RATE), 0, -1), jnp.asarray(GRAVITY)
    )


def matches(found, expected):
    assert np.isfinite(found).all()
    there = np.isfinite(expected)
    np.testing.assert_allclose(found[there], expected[there], rtol=1e-9)
    assert (found[~there] > NEVER).all()


@pytest.mark.parametrize("width", range(2, 8))
@pytest.mark.parametrize("detector", DETECTORS)
def test_detectors_equal_loops(imu, detector, width):
    for rule in RULES:
        p = chosen(detector, rule, width)
        assert stance.window_samples(p, RATE) == width
        found = np.asarray(compiled(width)(*imu)[detector, rule])
        matches(found, naive.apply_rule(reference(p, imu, width), width, rule))


@pytest.mark.parametrize("detector", DETECTORS)
def test_statistic_is_held_against_its_own_threshold(imu, detector):
    p = chosen(detector)
    log_ratio = np.asarray(log_ratio_of(p, *imu))
    expected = naive.apply_rule(reference(p, imu, 5), 5, "causal")
    np.testing.assert_allclose(log_ratio[4:], np.log(expected[4:]), atol=1e-9)
    np.testing.assert_array_equal(log_ratio[4:] < 0, expected[4:] < 1)


def test_padding_changes_nothing_and_is_never_still(imu):
    pairs = [(d, r) for d in DETECTORS for r in RULES]

    def evidence(force, rate, length):
        return {pair: stance.evidence(chosen(*pair, 4), force, rate, RATE, length) for pair in pairs}

    def log_ratios(found):
        return {
            k: stance.log_ratio(chosen(*k, 4), jnp.moveaxis(x, 0, -1), jnp.asarray(GRAVITY))
            for k, x in found.items()
        }

    padded = [np.concatenate([x, np.repeat(x[-1:], 9, axis=0)]) for x in imu]
    whole, alone = jax.jit(evidence)(*padded, COUNT), jax.jit(evidence)(*imu, COUNT)
    padding = jax.jit(log_ratios)({pair: x[COUNT:] for pair, x in whole.items()})
    for pair in pairs:
        np.testing.assert_array_equal(whole[pair][:COUNT], alone[pair])
        assert (np.asarray(padding[pair]) > np.log(NEVER)).all()


@pytest.mark.parametrize(
    ("rule", "causal"), [("causal", True), ("any", False), ("all", False), ("block", False)]
)
def test_only_the_causal_rule_is_causal(imu, rule, causal):
    whole, same = compiled(4)(*imu), []
    for count in (26, 33, 38):
        cropped = compiled(4)(*(x[:count] for x in imu))
        for detector in DETECTORS:
            now, then = (np.asarray(x[detector, rule])[:count] for x in (cropped, whole))
            same.append(np.array_equal(now, then))
            np.testing.assert_array_equal(now[:-3], then[:-3])  # a window ahead at most
    assert all(same) is causal
    if not causal:
        assert f"`{rule}`" in StanceParameters.__doc__


def test_documentation_names_what_is_not_causal():
    assert StanceParameters.__doc__.count("not causal") == 3


def test_last_incomplete_block_is_not_still():
    still = np.tile([0.0, 0.0, GRAVITY], (COUNT, 1)), np.zeros((COUNT, 3))
    found = np.asarray(compiled(5)(*still)["ared", "block"])
    assert (found[:40] < 1).all()
    assert found[40] > NEVER


@lru_cache
def slopes_of_all():
    def total(p, force, rate, gravity):
        found = jnp.moveaxis(stance.evidence(p, force, rate, RATE, 6), 0, -1)
        return jnp.sum(stance.log_ratio(p, found, gravity))

    def each(force, rate, gravity):
        gradient = jax.value_and_grad(total, (0, 1, 2, 3))
        return {
            d: gradient(parameters.cast(chosen(d, "any", 3), force.dtype), force, rate, gravity)
            for d in DETECTORS
        }

    return jax.jit(each)


@pytest.mark.parametrize("value", [0.0, 1e-12, 1e4])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_are_finite_for_dead_and_absurd_sensors(value, dtype):
    signal = jnp.full((8, 3), value, dtype)
    for detector, found in slopes_of_all()(signal, signal, jnp.asarray(GRAVITY, dtype)).items():
        for x in jax.tree.leaves(found):
            assert np.isfinite(x).all(), detector


def test_free_fall_is_not_still_for_shoe():
    fall = np.zeros((COUNT, 3))
    shoe = StanceParameters().shoe
    found = np.asarray(compiled(5)(fall, fall)["shoe", "causal"])
    np.testing.assert_allclose(found[5:], (GRAVITY / shoe.sigma_accelerometer) ** 2 / shoe.threshold)
    assert (found > 1).all()


def test_window_longer_than_the_recording_is_refused(imu):
    with pytest.raises(InputError, match="41 samples, less than the detector's window of 50"):
        stance.evidence(chosen("shoe", width=50), *imu, RATE)


def test_windows_are_lengths_in_seconds():
    p = StanceParameters()
    assert [stance.window_samples(p, r) for r in (200.0, 100.0, 400.0, 1.0)] == [5, 2, 10, 2]
