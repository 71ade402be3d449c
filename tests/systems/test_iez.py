"""IEZ against an independent textbook filter over a minute of walking, and its detector against loops."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.filters.strapdown import ATTITUDE_UPDATES
from pedjax.simulation.scenarios import load_scenario
from tests import tools
from tests.reference import detectors as naive
from tests.reference import filter as oracle

RATE = 100.0


def settings_of(params, walk, **changes):
    """The oracle's settings from the package's parameters, levelled by the same samples."""
    first = round(params.initial.levelling_s * RATE)
    opening = walk.specific_force[:first].mean(axis=0)
    return replace(tools.oracle_settings(params, opening, params.initial.heading), **changes)


def compare(track, walk, params, tolerance=1e-9, **changes):
    stance = track.gates["stance"].weight
    zaru = stance if params.updates.zaru else np.zeros_like(stance)
    expected = oracle.run(
        walk.dt,
        walk.specific_force,
        walk.angular_rate,
        stance,
        zaru,
        settings_of(params, walk, **changes),
    )
    for ours, theirs in tools.ORACLE_NAMES.items():
        np.testing.assert_allclose(
            track.estimate[ours], expected[theirs], atol=tolerance, rtol=0, err_msg=ours
        )
    np.testing.assert_allclose(tools.sigmas(track), np.sqrt(expected["P_diag"]), atol=tolerance, rtol=1e-9)


def shoe_ratio(walk, params):
    """log(statistic / threshold), from loops."""
    own = params.stance.shoe
    found = naive.shoe(
        walk.specific_force,
        walk.angular_rate,
        max(round(own.window_s * RATE), 2),
        own.sigma_accelerometer,
        own.sigma_gyroscope,
        params.gravity,
    )
    return np.log(found / own.threshold)


@pytest.mark.parametrize("method", ATTITUDE_UPDATES)
def test_hard_gate_equals_the_textbook_filter(minute, minute_recording, method):
    params = tools.iez(strapdown__attitude_update=method, initial__heading=0.4, **tools.shoe_sigmas())
    track = pedjax.run(minute_recording, params=params)
    assert track.healthy
    assert 0.2 < track.gates["stance"].weight.mean() < 0.6
    assert set(np.unique(track.gates["stance"].weight)) == {0.0, 1.0}
    compare(track, minute, params)
    np.testing.assert_array_equal(track.gates["stance"].weight, shoe_ratio(minute, params) < 0)


def test_published_defaults_equal_the_textbook_filter(minute, minute_recording):
    params = tools.iez(stance__shoe__threshold=1e8)
    compare(pedjax.run(minute_recording, params=params), minute, params)


def test_angular_rate_updates_and_soft_gate(minute, minute_recording):
    params = tools.iez(
        updates__zaru=True, updates__zero_angular_rate=0.02, gate__width=0.25, **tools.shoe_sigmas()
    )
    track = pedjax.run(minute_recording, params=params)
    weight = 1 / (1 + np.exp(shoe_ratio(minute, params) / 0.25))
    np.testing.assert_allclose(track.gates["stance"].weight, weight, atol=1e-9)
    compare(track, minute, params)


def test_correlated_biases(minute, minute_recording):
    """A first-order Markov bias decays in the model, so its estimate decays too between updates."""
    params = tools.iez(
        process__gyroscope_bias_time=20.0,
        process__accelerometer_bias_time=5.0,
        process__gyroscope_bias=1e-4,
        process__accelerometer_bias=1e-2,
        **tools.shoe_sigmas(),
    )
    compare(pedjax.run(minute_recording, params=params), minute, params)


def test_adaptive_gate(minute, minute_recording):
    params = tools.iez(
        gate__kind="adaptive",
        gate__follow=0.3,
        gate__follow_time=0.8,
        gate__growth=0.5,
        gate__floor=-1.0,
        gate__width=0.25,
        **tools.shoe_sigmas(),
    )
    track = pedjax.run(minute_recording, params=params)
    published = shoe_ratio(minute, params)
    bounded, level, own = np.clip(published, -10, 10), np.zeros(len(published)), params.gate
    now = 0.0
    for k, dt in enumerate(minute.dt):
        now += dt / (dt + own.follow_time) * (bounded[k] - now)
        level[k] = now
    log_ratio = published - own.follow * level
    np.testing.assert_allclose(track.gates["stance"].log_ratio[2:], log_ratio[2:], atol=1e-9)
    np.testing.assert_allclose(
        track.gates["stance"].weight, 1 / (1 + np.exp(log_ratio / own.width)), atol=1e-9
    )
    sigma = params.updates.zero_velocity * (1 + np.exp(bounded - own.floor)) ** own.growth
    compare(track, minute, params, sigma_zupt=sigma)


@pytest.mark.parametrize("width", [0.0, 0.25])
def test_hysteresis_raises_the_threshold_while_still(minute, minute_recording, width):
    params = tools.iez(gate__hysteresis=3.0, gate__width=width, **tools.shoe_sigmas())
    track = pedjax.run(minute_recording, params=params)
    published = shoe_ratio(minute, params)
    weight, still = np.zeros(len(published)), 0.0
    for k, ratio in enumerate(published):
        now = ratio - still * np.log(3.0)
        still = float(now < 0) if width == 0 else 1 / (1 + np.exp(now / width))
        weight[k] = still
    np.testing.assert_allclose(track.gates["stance"].weight, weight, atol=1e-9)
    plain = pedjax.run(minute_recording, params=tools.iez(gate__width=width, **tools.shoe_sigmas()))
    assert track.gates["stance"].weight.sum() > plain.gates["stance"].weight.sum()
    compare(track, minute, params)


def test_adaptive_gate_without_coefficients_is_the_published_one(minute_recording):
    own = tools.shoe_sigmas()
    published = pedjax.run(minute_recording, params=tools.iez(**own))
    adaptive = pedjax.run(minute_recording, params=tools.iez(gate__kind="adaptive", **own))
    np.testing.assert_array_equal(adaptive.gates["stance"].weight, published.gates["stance"].weight)
    np.testing.assert_allclose(adaptive.position, published.position, atol=1e-10)


@pytest.mark.parametrize("detector", ["ared", "amvd", "mag", "mbgtd", "eps"])
def test_stance_of_the_other_detectors(minute, minute_recording, detector):
    params = tools.iez(stance__detector=detector)
    stance, (force, rate) = params.stance, minute[1:3]
    width = max(round(getattr(stance, detector).window_s * RATE), 2)
    limits = stance.eps
    expected = {
        "ared": lambda: naive.ared(rate, width) < stance.ared.threshold,
        "amvd": lambda: naive.amvd(force, width) < stance.amvd.threshold,
        "mag": lambda: (
            naive.mag(force, width, stance.mag.sigma_accelerometer, params.gravity) < stance.mag.threshold
        ),
        "mbgtd": lambda: naive.mbgtd(force, width) < stance.mbgtd.threshold,
        "eps": lambda: (
            naive.eps(force, rate, width)
            < [limits.energy, limits.product, limits.total, limits.rate_variance, limits.rate_energy]
        ).all(axis=1),
    }[detector]()
    track = pedjax.run(minute_recording, params=params)
    np.testing.assert_array_equal(track.gates["stance"].open, expected)
    assert 0.1 < expected.mean() < 0.9


@pytest.mark.parametrize("rule", ["any", "all", "block"])
def test_stance_of_the_other_rules(minute, minute_recording, rule):
    params = tools.iez(stance__detector="ared", stance__rule=rule, stance__ared__window_s=0.05)
    track = pedjax.run(minute_recording, params=params)
    expected = naive.apply_rule(naive.ared(minute.angular_rate, 5), 5, rule) < params.stance.ared.threshold
    np.testing.assert_array_equal(track.gates["stance"].open, expected)


def test_soft_gate_goes_to_the_hard_one(minute_recording):
    own = tools.shoe_sigmas()
    hard = pedjax.run(minute_recording, params=tools.iez(**own))
    away = []
    for width in (0.3, 1e-2, 1e-8):
        soft = pedjax.run(minute_recording, params=tools.iez(gate__width=width, **own))
        away.append(np.abs(soft.position - hard.position).max())
    assert away[0] > away[1] > away[2]
    assert away[2] < 1e-10


def test_straight_through_runs_hard(minute_recording):
    own = tools.shoe_sigmas()
    hard = pedjax.run(minute_recording, params=tools.iez(**own))
    through = pedjax.run(
        minute_recording, params=tools.iez(gate__width=0.25, gate__straight_through=True, **own)
    )
    np.testing.assert_array_equal(through.gates["stance"].weight, hard.gates["stance"].weight)
    np.testing.assert_allclose(through.position, hard.position, atol=1e-10)


def test_walk_is_found(minute, minute_recording):
    """The track follows the truth to a percent of the distance."""
    track = pedjax.run(minute_recording, params=tools.iez(**tools.shoe_sigmas()))
    score = pedjax.evaluate(track, minute_recording)
    assert score.rms_2d_m < 0.5
    assert track.distance == pytest.approx(65.0, rel=0.15)


def test_structure_of_the_parameters_does_not_change_with_values():
    assert jax.tree.structure(tools.iez(gravity=9.8)) == jax.tree.structure(tools.iez())
    assert parameters.specs(tools.iez()).keys() == set(tools.LEAVES)


@pytest.mark.slow
def test_float32_stays_within_a_centimetre_over_ten_minutes():
    recording = pedjax.simulate(replace(load_scenario("demo"), rounds=16), 3).recording
    assert recording.duration > 500.0
    double = pedjax.run(recording)
    with jax.enable_x64(False):
        single = pedjax.run(recording)
    assert single.position.dtype == np.float32
    away = np.linalg.norm(single.position - double.position, axis=1)
    print(
        f"{recording.duration:.0f} s, {double.distance:.0f} m: float32 is off by at most {away.max():.4f} m"
    )
    assert away.max() < 0.01
