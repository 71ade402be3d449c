"""Where the data follow the model, the covariance tells the size of the errors: NEES inside its 95 % band."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from pedjax import rotations
from pedjax.filters import covariance, kalman, strapdown
from pedjax.filters.covariance import ProcessNoise
from pedjax.filters.kalman import Rows
from pedjax.filters.measurements import correct
from pedjax.lanes import eye

WALKS, STEPS, DT, GRAVITY = 300, 1200, 0.01, 9.81
NOISE = ProcessNoise(*(jnp.asarray(x) for x in (2e-3, 0.02, 2e-5, 2e-4, 50.0, 80.0)))
FIRST = {"t": 0.01, "g": 0.003, "p": 0.02, "v": 0.02, "a": 0.03}
SIGMA = 0.02  # m/s, of a velocity measured every fourth sample


def one(x):
    return jnp.full((3, WALKS), x)


@jax.jit
def monte_carlo(key, scale):
    """Errors and covariances after twelve seconds of 300 walks whose noises are `scale` times the model's."""
    first, noise = jax.random.split(key)
    draws = {
        s: scale * FIRST[s] * jax.random.normal(k, (3, WALKS))
        for s, k in zip(FIRST, jax.random.split(first, 5), strict=True)
    }
    start = jnp.broadcast_to(jnp.eye(3)[..., None], (3, 3, WALKS))
    truth = strapdown.Navigation(start, draws["g"], one(0.0), one(0.0), draws["a"])
    estimate = strapdown.Navigation(
        jnp.einsum("ijl,jkl->ikl", rotations.exp(-draws["t"]), start),
        one(0.0),
        -draws["p"],
        -draws["v"],
        one(0.0),
    )
    P = covariance.diagonal({s: one(x) for s, x in FIRST.items()})

    def step(carry, k):
        truth, estimate, P = carry
        keys = jax.random.split(jax.random.fold_in(noise, k), 5)
        white = [scale * jax.random.normal(key, (3, WALKS)) for key in keys]
        t = k * DT
        rate = jnp.stack([0.8 * jnp.sin(3 * t), 1.1 * jnp.cos(2 * t), 0.6 * jnp.sin(1.3 * t)])[:, None] + one(
            0.0
        )
        push = jnp.stack([3 * jnp.sin(4 * t), 2 * jnp.cos(3 * t), jnp.sin(5 * t)])[:, None] + one(0.0)
        force = jnp.einsum("jil,jl->il", truth.attitude, push + jnp.array([0.0, 0.0, GRAVITY])[:, None])
        keep = jnp.exp(-DT / NOISE.gyroscope_bias_time), jnp.exp(-DT / NOISE.accelerometer_bias_time)
        read_rate = rate + truth.gyroscope_bias + NOISE.gyroscope / jnp.sqrt(DT) * white[0]
        read_force = force + truth.accelerometer_bias + NOISE.accelerometer / jnp.sqrt(DT) * white[1]
        truth, _, _ = strapdown.mechanise(truth, force, rate, jnp.asarray(DT), jnp.asarray(GRAVITY))
        truth = truth._replace(
            gyroscope_bias=keep[0] * truth.gyroscope_bias + NOISE.gyroscope_bias * jnp.sqrt(DT) * white[2],
            accelerometer_bias=keep[1] * truth.accelerometer_bias
            + NOISE.accelerometer_bias * jnp.sqrt(DT) * white[3],
        )
        estimate, middle, force_n = strapdown.mechanise(
            estimate, read_force - estimate.accelerometer_bias, read_rate - estimate.gyroscope_bias,
            jnp.asarray(DT), jnp.asarray(GRAVITY),
        )  # fmt: skip
        F = covariance.inertial_transition(middle, force_n, jnp.asarray(DT), NOISE)
        P = covariance.predict(P, F, covariance.inertial_noise(NOISE, jnp.asarray(DT), force_n[0]))
        estimate = estimate._replace(
            gyroscope_bias=keep[0] * estimate.gyroscope_bias,
            accelerometer_bias=keep[1] * estimate.accelerometer_bias,
        )
        seen = truth.velocity + SIGMA * white[4]
        rows = Rows(seen - estimate.velocity, SIGMA**2 * eye(3, seen[0]), {"v": None})
        P, correction = kalman.update(P, rows, jnp.where(k % 4 == 0, 1.0, 0.0))
        return (truth, correct(estimate, correction), P), None

    (truth, estimate, P), _ = jax.lax.scan(step, (truth, estimate, P), jnp.arange(STEPS))
    turned = jnp.einsum("ijl,kjl->ikl", truth.attitude, estimate.attitude)
    error = jnp.concatenate(
        [
            jax.vmap(rotations.log, in_axes=2, out_axes=1)(turned),
            truth.gyroscope_bias - estimate.gyroscope_bias,
            truth.position - estimate.position,
            truth.velocity - estimate.velocity,
            truth.accelerometer_bias - estimate.accelerometer_bias,
        ]
    )
    return error, covariance.dense(P)


def nees(error, P, which):
    e, block = np.asarray(error)[which].T, np.asarray(P)[which, which].transpose(2, 0, 1)
    return np.einsum("li,lij,lj->l", e, np.linalg.inv(block), e)


PARTS = {
    "attitude": slice(0, 3), "gyroscope bias": slice(3, 6), "position": slice(6, 9), "velocity": slice(9, 12),
    "accelerometer bias": slice(12, 15), "everything": slice(0, 15),
}  # fmt: skip


@pytest.fixture(scope="module")
def honest():
    return monte_carlo(jax.random.key(1), 1.0)


@pytest.mark.parametrize("part", sorted(PARTS))
def test_the_covariance_is_honest(honest, part):
    found = nees(*honest, PARTS[part])
    size = PARTS[part].stop - PARTS[part].start
    low, high = chi2.ppf([0.025, 0.975], size * WALKS) / WALKS
    assert low < found.mean() < high


def test_noise_that_the_model_does_not_know_is_seen():
    found = nees(*monte_carlo(jax.random.key(2), 1.3), PARTS["everything"])
    assert found.mean() > chi2.ppf(0.9999, 15 * WALKS) / WALKS
