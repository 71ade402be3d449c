"""Rival headings against naive loops, and a filter's turn against dense algebra."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.filters import measurements, rivals
from pedjax.filters.covariance import STATES
from pedjax.filters.covariance import dense as whole
from pedjax.filters.rivals import Look, Rival, RivalParameters
from pedjax.filters.strapdown import Navigation
from tests.reference import filter as dense
from tests.reference import heading as naive

LANES, COUNT = 8, 300


def chosen(**own):
    return parameters.cast(parameters.replace(RivalParameters(), own), float)


@jax.jit
def gone_through(p, looks, dt):
    """All samples `(T, ...)` as a filter goes through them that turns only where a rival takes over."""

    def one(state, sample):
        look, dt = sample
        new, best, over = rivals.judged(p, state, look, dt)
        after = rivals.turned(rivals.left(p, new, best, over, look.of_yaw), over * best.turn)
        return after, (after, best, over)

    first = rivals.none(p, looks.position[0])
    return jax.lax.scan(one, first, (looks, dt))[1]


def looks_at(innovation, noise=0.07, of_yaw=0.03, odd=0.0, now=1.0, position=None):
    """Looks `(T, *L)`, of sigmas in rad."""
    like = np.zeros(np.shape(innovation))
    if position is None:
        position = np.zeros((like.shape[0], 3, *like.shape[1:]))
    numbers = (now, innovation, np.square(noise), np.square(of_yaw), odd)
    now, innovation, noise, of_yaw, odd = (jnp.asarray(like + x) for x in numbers)
    return Look(now, innovation, noise, of_yaw, odd, jnp.asarray(position))


@pytest.mark.parametrize("own", [{}, {"memory": 1.0, "outliers": 0.05, "fresh": 12.0}])
def test_odds_equal_the_loops(own):
    """Over looks that say one thing for a while and then another, some of them odd, some nothing at all."""
    rng = np.random.default_rng(17)
    p = chosen(**own)
    says = np.repeat(rng.choice([0.0, 0.7, -1.5, np.pi], (COUNT // 15, LANES)), 15, axis=0)
    innovation = says + rng.normal(0, 0.07, (COUNT, LANES))
    innovation = np.where(rng.uniform(size=says.shape) < 0.1, rng.uniform(-3, 3, says.shape), innovation)
    innovation = np.arctan2(np.sin(innovation), np.cos(innovation))
    looks = looks_at(
        innovation,
        noise=rng.uniform(0.05, 0.1, says.shape),
        of_yaw=rng.uniform(0.01, 0.2, says.shape),
        odd=rng.normal(0, 3.0, says.shape),
        now=rng.integers(0, 3, says.shape).clip(0, 1),
        position=np.cumsum(rng.normal(size=(COUNT, 3, LANES)), axis=0),
    )
    dt = rng.uniform(0.0, 1.5, COUNT)
    after, best, over = jax.tree.map(np.asarray, gone_through(p, looks, jnp.asarray(dt)))
    p, looks = jax.tree.map(float, p), jax.tree.map(np.asarray, looks)
    turns = 0
    for lane in range(LANES):
        loop = naive.Rivals(p, looks.position[0, :, lane])
        for k in range(COUNT):
            now, *numbers = (float(x[k, lane]) for x in looks[:-1])
            found = loop.see(bool(now), *numbers, looks.position[k, :, lane], dt[k])
            assert over[k, lane] == (found is not None), (lane, k)
            if found is not None:
                turns += 1
                assert best.turn[k, lane] == pytest.approx(found.turn, abs=1e-9)
                assert best.variance[k, lane] == pytest.approx(found.variance, rel=1e-9)
                np.testing.assert_allclose(best.since[k, :, lane], found.since)
                loop.turn(found.turn)
            for ours, theirs in ((after.fresh, loop.fresh), (after.former, loop.former)):
                assert ours.odds[k, lane] == pytest.approx(theirs.odds, abs=1e-8)
                assert ours.variance[k, lane] == pytest.approx(theirs.variance, rel=1e-8)
                assert abs(naive.wrapped(ours.turn[k, lane] - theirs.turn)) < 1e-8
                np.testing.assert_allclose(ours.since[k, :, lane], theirs.since)
    assert turns > LANES


def test_undisturbed_looks_bring_no_rival():
    """Within two sigmas none is even born; of a Gaussian, those that are born never take over."""
    rng = np.random.default_rng(1)
    p, sigma = chosen(), np.hypot(0.07, 0.03)
    noise = rng.normal(0, sigma, (2000, LANES))
    dt = jnp.full(2000, 1.1)
    after, _, over = gone_through(p, looks_at(np.clip(noise, -2 * sigma, 2 * sigma)), dt)
    assert not over.any()
    for rival, start in ((after.fresh, p.fresh), (after.former, p.former)):
        assert (rival.variance > 0.99e4).all()
        np.testing.assert_array_equal(rival.turn, 0.0)
        np.testing.assert_array_equal(rival.odds, -start)
    after, _, over = gone_through(p, looks_at(noise), dt)
    assert not over.any()
    assert (after.fresh.odds < -0.5 * p.fresh).all()


def looks_needed(start, p, off, born, noise, of_yaw, most=50):
    """After how many looks that are all `off` from the filter the odds pass 0, of a rival right on them whose
    first look is what it is `born` of, or which has a variance already."""
    odds, memory, inverse = 0.0, float(p.memory), 0.0 if born is None else 1 / born
    own = naive.likelihood(p, off, noise + of_yaw)[0]
    for k in range(1, most):
        if inverse > 0:
            odds = memory * odds + naive.likelihood(p, 0.0, noise + 1 / inverse)[0] - own
        if odds > start:
            return k
        inverse += 1 / noise
    return most


def test_looks_that_agree_take_over_after_as_many_as_the_odds_say_and_the_former_comes_back():
    """All looks 1 rad off, then as before: the filter turns there, and sooner back."""
    p = chosen(wander=1e-6)
    q, noise, of_yaw = jax.tree.map(float, p), 0.07**2, 0.03**2
    there = looks_needed(q.fresh, q, 1.0, None, noise, of_yaw)
    back = looks_needed(q.former, q, 1.0, of_yaw, noise, of_yaw)
    innovation = np.concatenate([np.zeros(5), np.full(there, 1.0), np.zeros(6), np.full(back, -1.0), [0.0]])
    place = np.arange(len(innovation))[:, None] * np.array([1.4, 0.0, 0.0])
    dt = jnp.full(len(innovation), 1.1)
    after, best, over = gone_through(p, looks_at(innovation, position=place), dt)
    first, second = 4 + there, 4 + there + 6 + back
    print(f"there after {there} looks, back after {back}")
    np.testing.assert_array_equal(np.flatnonzero(over), [first, second])
    assert 5 <= there <= 8
    assert back in (2, 3)
    assert best.turn[first] == pytest.approx(1.0, abs=1e-9)
    assert best.variance[first] == pytest.approx(noise / there, rel=0.05)
    np.testing.assert_allclose(best.since[first], place[5])  # where the looks began to disagree
    assert after.former.turn[first] == pytest.approx(-1.0, abs=1e-9)
    assert best.turn[second] == pytest.approx(-1.0, abs=1e-3)
    np.testing.assert_allclose(best.since[second], place[5])
    odd = gone_through(p, looks_at(innovation, odd=30.0), dt)[2]
    assert not odd.any()  # of a field that is not the earth's


def test_looks_all_over_the_place_turn_nothing():
    """Where every look says something else, no heading is better than the filter's own."""
    rng = np.random.default_rng(5)
    after, _, over = gone_through(
        chosen(), looks_at(rng.uniform(-np.pi, np.pi, (400, LANES))), jnp.full(400, 1.1)
    )
    assert not over.any()
    assert (after.former.variance > 0.99e4).all()


@pytest.mark.parametrize("own", [{"outliers": 0.005}, {"former": 0.1}])
def test_what_is_none_never_takes_over(own):
    """Looks all over the place, with numbers within their bounds: what takes over is a rival."""
    rng = np.random.default_rng(5)
    looks = looks_at(rng.uniform(-np.pi, np.pi, (400, LANES)))
    _, best, over = gone_through(chosen(**own), looks, jnp.full(400, 1.1))
    assert (best.variance[over > 0] < 1e3).all()


def filters(rng):
    """A covariance in blocks, and states, of several filters."""
    factor = rng.normal(size=(15, 20, LANES))
    full = np.einsum("ikl,jkl->ijl", factor, factor)
    P = {
        a + b: jnp.asarray(full[3 * i : 3 * i + 3, 3 * j : 3 * j + 3])
        for i, a in enumerate(STATES)
        for j, b in enumerate(STATES)
        if i <= j
    }
    rows = rng.normal(size=(5, 3, LANES))
    attitude = np.stack([dense.euler_attitude(*rng.uniform(-1.5, 1.5, 3)) for _ in range(LANES)], axis=-1)
    nav = Navigation(
        attitude=jnp.asarray(attitude),
        gyroscope_bias=jnp.asarray(rows[0]),
        position=jnp.asarray(20 * rows[1]),
        velocity=jnp.asarray(rows[2]),
        accelerometer_bias=jnp.asarray(rows[3]),
    )
    like = jnp.zeros(LANES)
    since = jnp.asarray(20 * rows[4])
    best = Rival(jnp.asarray(rng.uniform(-3, 3, LANES)), like + 0.01 * (1 + np.arange(LANES)), like, since)
    return P, nav, best


@jax.jit
def turn_over(P, best, over, nav):
    P, correction = rivals.taken_over(P, best, over, nav.position, nav.velocity)
    return P, correction, measurements.correct(nav, correction)


def test_taking_over_equals_the_dense_filter(rng):
    P, nav, best = filters(rng)
    found, correction, after = turn_over(P, best, jnp.ones(LANES), nav)
    assert set(found) == set(P)
    assert set(correction) == set(STATES)
    full, before = np.asarray(whole(found)), np.asarray(whole(P))
    for k in range(LANES):
        turn, since = float(best.turn[k]), np.asarray(best.since[:, k])
        place, speed = np.asarray(nav.position[:, k]), np.asarray(nav.velocity[:, k])
        expected, there, fast = naive.taken_over(
            before[..., k], turn, float(best.variance[k]), since, place, speed
        )
        np.testing.assert_allclose(full[..., k], expected, atol=1e-9)
        np.testing.assert_allclose(full[..., k], full[..., k].T, atol=1e-12)
        assert np.linalg.eigvalsh(full[..., k]).min() > 0
        np.testing.assert_allclose(after.position[:, k], there, atol=1e-9)
        np.testing.assert_allclose(after.velocity[:, k], fast, atol=1e-9)
        R = dense.rotation(np.array([0.0, 0.0, turn]))
        np.testing.assert_allclose(after.attitude[..., k], R @ np.asarray(nav.attitude[..., k]), atol=1e-8)
        distance = [np.linalg.norm(x - since) for x in (place, there)]
        assert distance[0] == pytest.approx(distance[1])
    for same in ("gyroscope_bias", "accelerometer_bias"):
        np.testing.assert_array_equal(getattr(after, same), getattr(nav, same))


def test_an_error_of_the_rivals_yaw_is_what_is_added(rng):
    """u is how attitude, position and velocity move when the turn is larger: finite differences."""
    P, nav, best = filters(rng)
    h, one = 1e-6, jnp.ones(LANES)
    up, down = (turn_over(P, best._replace(turn=best.turn + s), one, nav)[2] for s in (h, -h))
    wide, narrow = (
        np.asarray(whole(turn_over(P, best._replace(variance=v + 0 * one), one, nav)[0])) for v in (1.0, 0.0)
    )
    for part, name in ((dense.POS, "position"), (dense.VEL, "velocity")):
        moves = (getattr(up, name) - getattr(down, name)) / (2 * h)
        np.testing.assert_allclose((wide - narrow)[part, 2], moves, atol=1e-6)
    np.testing.assert_allclose((wide - narrow)[2, 2], 1.0, atol=1e-9)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_not_taking_over_changes_no_bit(rng, dtype):
    P, nav, best = jax.tree.map(lambda x: x.astype(dtype), filters(rng))
    found, correction, after = turn_over(P, best, jnp.zeros(LANES, dtype), nav)
    for name in P:
        assert found[name].dtype == dtype
        np.testing.assert_array_equal(found[name], P[name])
    for x in correction.values():
        np.testing.assert_array_equal(x, 0.0)
    for name in ("position", "velocity", "gyroscope_bias", "accelerometer_bias", "attitude"):
        np.testing.assert_array_equal(getattr(after, name), getattr(nav, name), err_msg=name)


def test_others_may_be_missing_states(rng):
    """A filter without biases is turned as well."""
    P, nav, best = filters(rng)
    few = {name: x for name, x in P.items() if set(name) <= set("tpv")}
    found, correction = rivals.taken_over(few, best, jnp.ones(LANES), nav.position, nav.velocity)
    assert set(correction) == set("tpv")
    every, _ = rivals.taken_over(P, best, jnp.ones(LANES), nav.position, nav.velocity)
    for name in few:
        np.testing.assert_allclose(found[name], every[name], rtol=1e-12)


def test_padding_moves_no_odds():
    """Samples of no time, and looks that are none."""
    p, one = chosen(), np.full(4, 1.0)
    after, _, over = gone_through(p, looks_at(one, now=0.0), jnp.zeros(4))
    assert not over.any()
    none = rivals.none(p, jnp.zeros(3))
    for ours, theirs in zip(*map(jax.tree.leaves, (after, none)), strict=True):
        np.testing.assert_array_equal(ours, np.broadcast_to(theirs, ours.shape))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_slopes_are_finite_everywhere(dtype):
    """By the numbers and the looks, through a rival that is born and takes over; far off, too."""
    p = parameters.cast(RivalParameters(), dtype)
    cases = np.transpose([[0.0] * 12, [1.0] * 12, [0.0] * 4 + [3.14] * 8, [1.0, -1.0] * 6])
    for noise in (1e-3, 0.07, 3.0):
        looks = jax.tree.map(lambda x: x.astype(dtype), looks_at(cases, noise=noise, of_yaw=noise))
        dt = jnp.ones(12, dtype)

        @partial(jax.grad, argnums=(0, 1))
        def slopes(p, looks, dt=dt):
            after, best, over = gone_through(p, looks, dt)
            return jnp.sum(after.fresh.odds + after.former.turn + over * (best.turn + best.variance))

        for x in jax.tree.leaves(slopes(p, looks)):
            assert np.isfinite(x).all()
