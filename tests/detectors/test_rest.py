"""The standing start against loops, and what counts as rest."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.detectors.rest import standing_rows, standing_start
from tests import tools
from tests.reference import detectors as naive

HZ = 100.0
measured = jax.jit(standing_start, static_argnums=(2, 3))


def resting(rng, seconds, then=2.0, bias=(0.006, -0.004, 0.003), hz=HZ):
    """A foot that stands, swaying a little, and then moves: rate `(T, 3)` and dt."""
    stands, count = round(seconds * hz), round((seconds + then) * hz)
    sway = 0.002 * np.sin(np.arange(count) / hz)[:, None] * [1.0, -0.5, 0.3]
    noise = rng.normal(0, 0.003, (count, 3))
    moves = rng.normal(0, 1.0, (count, 3)) * (np.arange(count) >= stands)[:, None]
    return np.array(bias) + sway + noise + moves, np.full(count, 1 / hz)


@pytest.mark.parametrize("seconds", [0.0, 0.2, 0.3, 1.1, 6.4, 13.0])
@pytest.mark.parametrize("hz", [100.0, 250.0, 102.0])
def test_equals_loops(rng, seconds, hz):
    rate, dt = resting(rng, seconds, hz=hz)
    mean, spread, windows = naive.standing_start(rate, dt, hz, 10.0)
    found = measured(rate, dt, hz, 10.0)
    assert found.windows == windows
    assert found.rate.shape == (3,)
    np.testing.assert_allclose(found.rate, mean, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.spread, spread, rtol=1e-9, atol=1e-18)


def test_so_much_of_it_as_asked_for(rng):
    rate, dt = resting(rng, 12.0)
    for rest_s, windows in ((10.0, 40), (3.0, 12), (3.2, 12), (0.25, 1), (0.1, 0)):
        assert measured(rate, dt, HZ, rest_s).windows == windows
        assert naive.standing_start(rate, dt, HZ, rest_s)[2] == windows


@pytest.mark.parametrize(
    ("rate", "windows"),
    [
        ([0.0, 0.0, np.radians(0.95)], 8),
        ([0.0, 0.0, np.radians(1.05)], 0),
        (np.radians([1.4, 1.0, -1.5]), 0),
    ],
)
def test_a_steady_turn_is_no_rest(rate, windows):
    assert measured(np.tile(rate, (200, 1)), np.full(200, 0.01), HZ, 10.0).windows == windows


@pytest.mark.parametrize(("deviation", "windows"), [(0.019, 8), (0.021, 0)])
def test_a_trembling_foot_is_none(deviation, windows):
    turns = np.tile([1.0, -1.0], 100)[:, None] * deviation * np.array([0.6, 0.0, 0.8])
    turns[24::25] = 0.0  # an odd window has a mean of zero, too
    assert measured(turns * np.sqrt(25 / 24), np.full(200, 0.01), HZ, 10.0).windows == windows


def test_only_the_leading_rest_counts(rng):
    rate, dt = resting(rng, 6.0, then=0.0)
    rate[130] = 1.0
    found = measured(rate, dt, HZ, 10.0)
    assert found.windows == 5
    np.testing.assert_allclose(found.rate, rate[:125].mean(axis=0), rtol=1e-12)


def test_later_samples_and_padding_change_no_bit(rng):
    rate, dt = resting(rng, 2.0, then=12.0)
    whole = measured(rate, dt, HZ, 10.0)
    assert whole.windows == 8
    for stop in (225, 300, 1100):
        tools.same_bits(measured(rate[:stop], dt[:stop], HZ, 10.0), whole)
    other = rate.copy()
    other[225:] = 1e6
    tools.same_bits(measured(other, dt, HZ, 10.0), whole)
    still = rate[:180]  # padded as a recording is, with its last sample and dt = 0
    alone = measured(still, dt[:180], HZ, 10.0)
    assert alone.windows == 7
    longer = np.concatenate([still, np.repeat(still[-1:], 400, axis=0)])
    steps = np.concatenate([dt[:180], np.zeros(400)])
    tools.same_bits(measured(longer, steps, HZ, 10.0), alone)
    tools.same_bits(measured(longer, np.full(580, 0.01), HZ, 10.0, 180), alone)


def test_in_single_precision(rng):
    rate, dt = resting(rng, 8.0)
    mean, spread, windows = naive.standing_start(rate, dt, HZ, 10.0)
    found = jax.jit(partial(standing_start, rate_hz=HZ, rest_s=10.0))(
        jnp.asarray(rate, jnp.float32), jnp.asarray(dt, jnp.float32)
    )
    assert {x.dtype for x in found} == {jnp.dtype(jnp.float32)}
    assert found.windows == windows
    np.testing.assert_allclose(found.rate, mean, atol=1e-8)
    np.testing.assert_allclose(found.spread, spread, rtol=1e-4)


@pytest.mark.parametrize(("seconds", "rows"), [(0.0, 0), (0.3, 0), (1.1, 75), (2.0, 175), (6.0, 500)])
def test_a_foot_stands_until_the_window_before_it_steps(rng, seconds, rows):
    """Five seconds are asked for; where it steps later, none of them is left out."""
    rate, dt = resting(rng, seconds)
    assert int(standing_rows(rate, dt, HZ, 5.0)) == rows


def test_a_stand_may_sway_where_a_rest_may_not(rng):
    rate, dt = resting(rng, 6.0)
    rate[100:150, 1] += 0.03  # 1.7 deg/s for half a second
    assert float(standing_start(rate, dt, HZ, 5.0).windows) == 4
    assert int(standing_rows(rate, dt, HZ, 5.0)) == 500
    assert int(standing_rows(rate, dt, HZ, 5.0, 300)) == 275
