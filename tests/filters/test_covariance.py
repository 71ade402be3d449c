"""The blockwise covariance against dense matrices, its signs against the INS, and what it can observe."""

from itertools import combinations_with_replacement

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import rotations
from pedjax.filters import covariance, kalman, measurements, strapdown
from pedjax.filters.covariance import STATES, ProcessNoise
from pedjax.filters.kalman import Rows
from pedjax.filters.strapdown import Navigation
from pedjax.lanes import eye, matvec
from tests.reference import filter as oracle

GRAVITY = 9.81
NOISE = ProcessNoise(6e-4, 0.03, 1e-4, 2e-3, 30.0, 60.0)
FOREVER = NOISE._replace(gyroscope_bias_time=np.inf, accelerometer_bias_time=np.inf)
SETTINGS = oracle.Settings(
    gyroscope=NOISE.gyroscope,
    accelerometer=NOISE.accelerometer,
    gyroscope_bias=NOISE.gyroscope_bias,
    accelerometer_bias=NOISE.accelerometer_bias,
)
update = jax.jit(kalman.update)


def propagated(P, attitude, force_n, dt, noise):
    """A step of the inertial filter's covariance."""
    F = covariance.inertial_transition(attitude, force_n, dt, noise)
    return covariance.predict(P, F, covariance.inertial_noise(noise, dt, force_n[0]))


predict = jax.jit(propagated)


def dense_transition(F, like, states=STATES):
    """The dense `(3n, 3n, *L)` transition that `predict` applies blockwise."""
    one = eye(3, like) * jnp.ones_like(like)

    def whole(row, column):
        if column not in F[row]:
            return jnp.zeros_like(one)
        matrix = F[row][column]
        if matrix is None:
            return one
        return matrix if matrix.ndim == one.ndim else matrix * one

    rows = [jnp.concatenate([whole(a, b) for b in states], axis=1) for a in states]
    return jnp.concatenate(rows, axis=0)


@jax.jit
def transition(attitude, force_n, dt, noise):
    """Its F, dense."""
    F = covariance.inertial_transition(attitude, force_n, dt, noise)
    return dense_transition(F, force_n[0])


def random_spd(rng, lanes=(), size=15):
    """Dense `(size, size, *L)` with standard deviations over three decades."""
    a = rng.normal(size=(*lanes, size, size)) * np.logspace(-2, 1, size)[:, None]
    return np.moveaxis(a @ np.swapaxes(a, -1, -2), (-2, -1), (0, 1))


def blocks(P, states=STATES):
    """The upper blocks of a dense matrix."""
    at = {s: slice(3 * i, 3 * i + 3) for i, s in enumerate(states)}
    return {a + b: jnp.asarray(P[at[a], at[b]]) for a, b in combinations_with_replacement(states, 2)}


def scaled(found, expected, tolerance):
    """Compare in units of the standard deviations."""
    d = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(d, d), expected / np.outer(d, d), atol=tolerance)


def test_dense_and_blocks_are_inverse(rng):
    P = random_spd(rng)
    np.testing.assert_array_equal(covariance.dense(blocks(P)), P)
    found = np.concatenate([covariance.variances(blocks(P), s) for s in STATES])
    np.testing.assert_array_equal(found, np.diag(P))
    for row in STATES:
        for column in STATES:
            i, j = 3 * STATES.index(row), 3 * STATES.index(column)
            np.testing.assert_array_equal(covariance.block(blocks(P), row, column), P[i : i + 3, j : j + 3])


def test_transition_is_the_textbook_one(rng):
    c, f = oracle.rotation(rng.normal(size=3)), rng.normal(0, 10, 3)
    expected = oracle.transition(c, f, 0.02, NOISE.accelerometer_bias_time, NOISE.gyroscope_bias_time)
    np.testing.assert_allclose(transition(c, f, 0.02, NOISE), expected, atol=1e-15)


def test_predict_is_f_p_f_transpose_plus_q(rng):
    lanes = 4
    P = random_spd(rng, (lanes,))
    c = np.stack([oracle.rotation(v) for v in rng.normal(size=(lanes, 3))], axis=-1)
    f, dt = rng.normal(0, 10, (3, lanes)), rng.uniform(0.005, 0.02, lanes)
    found = np.asarray(covariance.dense(predict(blocks(P), c, f, dt, NOISE)))
    for lane in range(lanes):
        F = np.asarray(transition(c[..., lane], f[:, lane], dt[lane], NOISE))
        expected = F @ P[..., lane] @ F.T + oracle.process_noise(dt[lane], SETTINGS)
        scaled(found[..., lane], expected, 1e-13)
    np.testing.assert_array_equal(found, np.swapaxes(found, 0, 1))


def test_no_time_changes_nothing(rng):
    P = random_spd(rng)
    found = predict(blocks(P), jnp.eye(3), jnp.array([1.0, 2.0, 9.8]), jnp.zeros(()), NOISE)
    np.testing.assert_array_equal(covariance.dense(found), P)


MADE_UP = {
    "rotation and bias": (
        {"e": {"e": "matrix", "b": "matrix"}, "b": {"b": "number"}},
        ("e",),
    ),
    "biases in front": (
        {"b": {"b": "number"}, "e": {"e": None, "b": "matrix"}},
        ("b", "e"),
    ),
    "numbers and identities": (
        {"x": {"x": None}, "y": {"y": None, "x": "number"}, "z": {"z": "number"}, "u": {"u": "number"}},
        ("y", "z"),
    ),
    "whole rows": (
        {
            "q": {"q": "matrix"},
            "r": {"q": "number", "r": "number"},
            "s": {"q": None, "r": "matrix", "s": None},
        },
        ("q", "r", "s"),
    ),
    "the last copied": ({"p": {"p": "matrix"}, "c": {"p": None}}, ("p",)),
    "white noise": ({"p": {"p": None, "w": "number"}, "w": {}}, ("w",)),
}
"""Transitions by blocks of states that the inertial filter has not, and which have a noise."""


def drawn(rng, kind, lanes):
    """F with blocks of those kinds."""
    draw = {
        "matrix": lambda: jnp.asarray(rng.normal(size=(3, 3, *lanes))),
        "number": lambda: jnp.asarray(rng.uniform(0.5, 1.0, lanes)),
        None: lambda: None,
    }
    return {row: {column: draw[what]() for column, what in of.items()} for row, of in kind.items()}


@pytest.mark.parametrize("lanes", [(), (4,), (2, 3)])
@pytest.mark.parametrize("case", MADE_UP)
def test_predict_of_any_states_is_f_p_f_transpose_plus_q(rng, case, lanes):
    kind, noisy = MADE_UP[case]
    states, size = "".join(kind), 3 * len(kind)
    P, F = random_spd(rng, lanes, size), drawn(rng, kind, lanes)
    root = {s: rng.normal(size=(*lanes, 3, 3)) for s in noisy}
    Q = {s: np.moveaxis(x @ np.swapaxes(x, -1, -2), (-2, -1), (0, 1)) for s, x in root.items()}
    found = jax.jit(covariance.predict)(blocks(P, states), F, Q)
    assert found.keys() == blocks(P, states).keys()
    found = np.asarray(covariance.dense(found, states))
    whole = np.asarray(dense_transition(F, jnp.zeros(lanes), states))
    assert whole.shape == (size, size, *lanes)
    for lane in np.ndindex(*lanes):
        at = (slice(None), slice(None), *lane)
        for i, row in enumerate(states):
            for j, column in enumerate(states):
                given = F[row].get(column, 0.0)
                if kind[row].get(column) == "matrix":
                    wanted = given[at]
                else:
                    number = 1.0 if given is None else np.broadcast_to(given, lanes)[lane]
                    wanted = number * np.eye(3)
                np.testing.assert_array_equal(whole[at][3 * i : 3 * i + 3, 3 * j : 3 * j + 3], wanted)
        expected = whole[at] @ P[at] @ whole[at].T
        for s, noise in Q.items():
            own = slice(3 * states.index(s), 3 * states.index(s) + 3)
            expected[own, own] += noise[at]
        scaled(found[at], expected, 1e-13)
    np.testing.assert_array_equal(found, np.swapaxes(found, 0, 1))


@pytest.mark.parametrize("case", MADE_UP)
def test_update_and_downdate_of_any_states(rng, case):
    states = "".join(MADE_UP[case][0])
    size = 3 * len(states)
    P = random_spd(rng, (), size)
    parts = {states[-1]: rng.normal(size=(2, 3)), states[0]: rng.normal(size=(2, 3))}
    H = np.zeros((2, size))
    for s, matrix in parts.items():
        H[:, 3 * states.index(s) : 3 * states.index(s) + 3] = matrix
    R, z, weight = np.diag([0.4, 0.7]), rng.normal(size=2), 0.3
    rows = Rows(jnp.asarray(z), jnp.asarray(R), {s: jnp.asarray(m) for s, m in parts.items()})
    expected, dx = dense_update(P, H, R, z, weight)
    seen = kalman.whiten(blocks(P, states), rows, jnp.asarray(weight))
    for found, correction in (
        update(blocks(P, states), rows, weight),
        kalman.downdate(blocks(P, states), seen, jnp.asarray(weight)),
    ):
        assert set(covariance.states_of(found)) == set(states)
        scaled(np.asarray(covariance.dense(found, states)), expected, 1e-10)
        together = np.concatenate([correction[s] for s in states])
        np.testing.assert_allclose(together, dx, rtol=1e-9, atol=1e-11)
        for i, s in enumerate(states):
            sigma = np.sqrt(np.diag(expected)[3 * i : 3 * i + 3])
            np.testing.assert_allclose(covariance.sigma(found, s), sigma, rtol=1e-9)
    assert bool(covariance.is_positive(blocks(P, states)))
    broken = blocks(P, states)
    broken[2 * states[-1]] = -broken[2 * states[-1]]
    assert not bool(covariance.is_positive(broken))
    nis = float(kalman.normalised_innovation(blocks(P, states), rows))
    assert nis == pytest.approx(z @ np.linalg.solve(H @ P @ H.T + R, z), rel=1e-9)


def dense_update(P, H, R, z, weight):
    """Joseph form with R / w, in float64 and with a solve."""
    noise = R / weight
    K = np.linalg.solve(H @ P @ H.T + noise, H @ P).T
    A = np.eye(len(P)) - K @ H
    return A @ P @ A.T + K @ noise @ K.T, K @ z


MEASUREMENTS = {
    "zero velocity": lambda rng: {"v": None},
    "zero rate": lambda rng: {"g": None},
    "heading": lambda rng: {"t": rng.normal(size=(1, 3))},
    "mixed": lambda rng: {
        "t": rng.normal(size=(2, 3)),
        "p": rng.normal(size=(2, 3)),
        "a": rng.normal(size=(2, 3)),
    },
    "identity and more": lambda rng: {"p": None, "t": rng.normal(size=(3, 3))},
}


@pytest.mark.parametrize("kind", MEASUREMENTS)
@pytest.mark.parametrize("weight", [1.0, 0.3, 1e-4])
def test_update_is_the_dense_weighted_joseph_update(rng, kind, weight):
    P, parts = random_spd(rng), MEASUREMENTS[kind](rng)
    size = next((len(m) for m in parts.values() if m is not None), 3)
    root = rng.normal(size=(size, size))
    R, z = root @ root.T + 0.1 * np.eye(size), rng.normal(size=size)
    H = np.zeros((size, 15))
    for state, matrix in parts.items():
        i = 3 * STATES.index(state)
        H[:, i : i + 3] = np.eye(3) if matrix is None else matrix
    rows = Rows(
        jnp.asarray(z), jnp.asarray(R), {s: None if m is None else jnp.asarray(m) for s, m in parts.items()}
    )
    found, correction = update(blocks(P), rows, weight)
    expected, dx = dense_update(P, H, R, z, weight)
    scaled(np.asarray(covariance.dense(found)), expected, 1e-10)
    np.testing.assert_allclose(np.concatenate([correction[s] for s in STATES]), dx, rtol=1e-9, atol=1e-11)
    S = H @ P @ H.T + R
    nis = float(kalman.normalised_innovation(blocks(P), rows))
    assert nis == pytest.approx(z @ np.linalg.solve(S, z), rel=1e-9)


def test_weight_zero_is_no_update(rng):
    P, nav = random_spd(rng), strapdown.still_at_origin(jnp.eye(3))
    nav = nav._replace(velocity=jnp.array([1.0, 2.0, 3.0]))
    found, correction = update(blocks(P), measurements.zero_velocity(nav, jnp.asarray(0.01)), 0.0)
    np.testing.assert_array_equal(covariance.dense(found), P)
    assert all((np.asarray(x) == 0).all() for x in correction.values())


def navigation(rng):
    return Navigation(
        jnp.asarray(oracle.rotation(rng.normal(size=3))),
        *(jnp.asarray(rng.normal(0, s, 3)) for s in (0.1, 5, 2, 0.3)),
    )


def minus(truth, estimate):
    """The error of an estimate in the filter's convention: truth = estimate ⊞ error."""
    turned = rotations.log(truth.attitude @ estimate.attitude.T)
    return jnp.concatenate([turned, *(a - b for a, b in zip(truth[1:], estimate[1:], strict=True))])


def plus(nav, error):
    return measurements.correct(nav, {s: error[3 * i : 3 * i + 3] for i, s in enumerate(STATES)})


def one_step(nav, force, rate, dt):
    return strapdown.mechanise(nav, force - nav.accelerometer_bias, rate - nav.gyroscope_bias, dt, GRAVITY)


@jax.jit
def perturbed(nav, force, rate, dt, error):
    """The error after steps (T, ...) of an INS whose truth starts that error away."""

    def body(pair, sample):
        return tuple(one_step(nav, *sample)[0] for nav in pair), None

    (truth, estimate), _ = jax.lax.scan(body, (plus(nav, error), nav), (force, rate, dt))
    return minus(truth, estimate)


@jax.jit
def product(nav, force, rate, dt):
    def body(carry, sample):
        nav, F = carry
        nav, middle, force_n = one_step(nav, *sample)
        return (nav, transition(middle, force_n, sample[2], FOREVER) @ F), None

    return jax.lax.scan(body, (nav, jnp.eye(15)), (force, rate, dt))[0][1]


def by_differences(nav, *samples):
    size = 1e-5
    columns = [
        (perturbed(nav, *samples, size * e) - perturbed(nav, *samples, -size * e)) / (2 * size)
        for e in np.eye(15)
    ]
    return np.stack(columns, axis=1)


def strong_motion(rng, count, dt):
    t = dt * np.arange(count)[:, None]
    force = np.array([0.0, 0.0, GRAVITY]) + 15 * np.sin(7 * t + rng.uniform(0, 6, 3))
    return force, 6 * np.sin(9 * t + rng.uniform(0, 6, 3)), np.full(count, dt)


def largest_block_difference(found, expected):
    """Relative to each block of the expected; where that is zero, absolute."""
    worst = 0.0
    for i in range(0, 15, 3):
        for j in range(0, 15, 3):
            there = expected[i : i + 3, j : j + 3]
            size = np.linalg.norm(there) if np.abs(there).max() > 1e-9 else 1.0
            worst = max(worst, np.linalg.norm(found[i : i + 3, j : j + 3] - there) / size)
    return worst


def test_transition_is_the_perturbed_minus_the_true_ins(rng):
    """Over a second of strong motion every block has the INS's sign and size: what is left shrinks with dt,
    and both go to one limit."""
    nav, seed = navigation(rng), rng.integers(1 << 30)
    F, found = [], []
    for count in (100, 200, 400):
        samples = strong_motion(np.random.default_rng(seed), count, 1.0 / count)
        F.append(np.asarray(product(nav, *samples)))
        found.append(by_differences(nav, *samples))
    left = [largest_block_difference(a, b) for a, b in zip(F, found, strict=True)]
    assert left[0] > 1.9 * left[1] > 3.6 * left[2]
    assert left[2] < 0.01
    assert largest_block_difference(2 * F[2] - F[1], 2 * found[2] - found[1]) < 3e-4


def test_one_step_agrees_to_first_order_in_dt(rng):
    nav = navigation(rng)
    left = []
    for dt in (1e-2, 5e-3):
        samples = strong_motion(np.random.default_rng(1), 1, dt)
        difference = by_differences(nav, *samples) - np.asarray(product(nav, *samples))
        left.append(np.abs(difference).max())
        assert left[-1] < dt**2 * np.linalg.norm(samples[0])  # what is left out is -dt²/2 [f×] and smaller
    assert left[1] == pytest.approx(left[0] / 4, rel=0.05)


def test_repair_removes_the_attitude_error(rng):
    """With the sign turned (Ma's Eq. 39) it would double."""
    truth = navigation(rng)
    error = jnp.asarray(rng.normal(0, 0.01, 3))
    estimate = truth._replace(attitude=rotations.exp(error).T @ truth.attitude)
    first_order = 0.5 * (truth.attitude @ estimate.attitude.T - estimate.attitude @ truth.attitude.T)
    seen = jnp.stack([first_order[2, 1], first_order[0, 2], first_order[1, 0]])
    zero = jnp.zeros(3)

    def size(nav):
        return float(jnp.linalg.norm(minus(truth, nav)[:3]))

    repaired = measurements.correct(estimate, {"t": seen, "g": zero, "p": zero, "v": zero, "a": zero})
    doubled = measurements.correct(estimate, {"t": -seen, "g": zero, "p": zero, "v": zero, "a": zero})
    assert size(repaired) < size(estimate) / 100
    assert size(doubled) == pytest.approx(2 * size(estimate), rel=1e-3)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2, np.pi])
def test_zero_velocity_shrinks_a_tilt_error_in_every_heading(heading):
    """At rest with exact sensors: 2 degrees of tilt error leave within a second, wherever the foot points."""
    c = jnp.asarray(oracle.euler_attitude(0.1, 0.5, heading))
    tilted = rotations.exp(jnp.array([0.03, -0.02, 0.0])) @ c
    deviations = {s: jnp.full(3, x) for s, x in zip(STATES, (0.05, 1e-8, 1e-5, 1e-5, 1e-8), strict=True)}

    @jax.jit
    def still(nav, P):
        def body(carry, _):
            nav, P = carry
            nav, middle, force_n = strapdown.mechanise(nav, GRAVITY * c[2], jnp.zeros(3), 0.01, GRAVITY)
            noise = FOREVER._replace(gyroscope=1e-6, accelerometer=1e-4)
            P = propagated(P, middle, force_n, jnp.asarray(0.01), noise)
            P, correction = kalman.update(P, measurements.zero_velocity(nav, jnp.asarray(1e-3)), 1.0)
            return (measurements.correct(nav, correction), P), None

        return jax.lax.scan(body, (nav, P), None, length=100)[0]

    nav, P = still(strapdown.still_at_origin(tilted), covariance.diagonal(deviations))
    left = np.asarray(rotations.log(c @ nav.attitude.T))
    assert np.linalg.norm(left[:2]) < np.hypot(0.03, 0.02) / 100
    assert bool(covariance.is_positive(P))


def ranks(states, **rows):
    """Observability of a resting sensor from `transition` and stacked rows."""
    c = oracle.euler_attitude(0.1, 0.4, 0.7)
    F = np.asarray(transition(c, np.array([0.0, 0.0, GRAVITY]), 1.0, FOREVER))
    index = np.concatenate([3 * STATES.index(s) + np.arange(3) for s in states])
    H = np.zeros((0, 15))
    for state, matrix in rows.items():
        part = np.zeros((len(matrix), 15))
        part[:, 3 * STATES.index(state) : 3 * STATES.index(state) + 3] = matrix
        H = np.vstack([H, part])
    F, H = F[np.ix_(index, index)], H[:, index]
    return oracle.observability_rank([F] * len(index), [H] * len(index))


def test_observability_of_a_resting_foot():
    velocity, up = np.eye(3), np.array([[0.0, 0.0, 1.0]])
    assert ranks("tgpva", v=velocity) == 8
    assert ranks("tgpva", v=velocity, t=up) == 10
    assert ranks("tgpva", v=velocity, t=up, p=np.eye(3)) == 13
    assert ranks("tpv", v=velocity) == 5


def test_rows_of_the_updates(rng):
    nav, rate = navigation(rng), jnp.asarray(rng.normal(size=3))
    rows = measurements.zero_velocity(nav, jnp.asarray(0.1))
    np.testing.assert_array_equal(rows.innovation, -nav.velocity)
    np.testing.assert_allclose(rows.noise, 0.01 * np.eye(3))
    rows = measurements.zero_angular_rate(nav, rate, jnp.asarray(0.2))
    np.testing.assert_array_equal(rows.innovation, rate - nav.gyroscope_bias)
    np.testing.assert_allclose(rows.noise, 0.04 * np.eye(3))
    assert rows.H == {"g": None}


def test_positive_flag(rng):
    P = blocks(random_spd(rng, (2,)))
    assert np.asarray(covariance.is_positive(P)).all()
    for broken in (-1.0, np.nan):
        bad = {**P, "vv": P["vv"].at[1, 1, 0].set(broken)}
        np.testing.assert_array_equal(covariance.is_positive(bad), [False, True])


def test_mechanised_force_is_turned_by_the_mean_attitude(rng):
    nav, rate, force = navigation(rng), jnp.asarray(rng.normal(0, 5, 3)), jnp.asarray(rng.normal(0, 9, 3))
    after, middle, force_n = strapdown.mechanise(nav, force, rate, 0.01, GRAVITY)
    np.testing.assert_allclose(middle, 0.5 * (nav.attitude + after.attitude), atol=1e-15)
    np.testing.assert_allclose(force_n, matvec(middle, force), atol=1e-14)
