"""Headings beside a known disturbance: both sides of the triangle, and which is taken."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.filters import compensation
from pedjax.filters.compensation import Compensation
from tests.reference import alignment as naive

H, COUNT, BESIDE = 21.0, 10_000, np.radians(20.0)


def settings(**changes):
    return parameters.cast(parameters.replace(Compensation(mode="magnitude"), changes), float)


sides = jax.jit(compensation.sides)
chosen = jax.jit(compensation.chosen)


def wrapped(x):
    return np.arctan2(np.sin(x), np.cos(x))


@pytest.fixture(scope="module")
def cases():
    """Disturbances of .05 to .95 of H with any direction: their length, that of the sum, by how much the sum
    is turned, and how wrong a gyroscope is about the yaw (evenly within 20 degrees)."""
    rng = np.random.default_rng(21)
    size, way = rng.uniform(0.05, 0.95, COUNT) * H, rng.uniform(-np.pi, np.pi, COUNT)
    seen = H + size * np.exp(1j * way)
    return size, np.abs(seen), np.angle(seen), rng.uniform(-BESIDE, BESIDE, COUNT)


def resolved(p, cases, sigma=1e-6):
    """What is made of the cases: the innovation that is told and the one of the truth.

    A compass that sees the field turned by `turned` finds the yaw too large by as much (north less azimuth is
    smaller): its innovation is that of the truth less `turned`."""
    size, measured, turned, gyro = (jnp.asarray(x) for x in cases)
    plain = jnp.asarray(wrapped(-gyro - turned))
    like = jnp.zeros(COUNT)
    level = (measured, like + H, size)
    found, added = chosen(p, plain, like + BESIDE**2 / 3, level, like + sigma)
    return np.asarray(found), np.asarray(added), np.asarray(plain), -np.asarray(gyro)


def test_the_truth_is_always_one_of_the_two_sides(cases):
    size, measured, turned, _ = cases
    like = jnp.zeros(COUNT)
    angle = np.asarray(sides(measured, like + H, size, like + 1e-9)[0])
    np.testing.assert_allclose(angle, np.abs(turned), atol=1e-9)  # the sum is turned by + or − this
    expected = [naive.triangle(m, H, d) for m, d in zip(measured[:500], size[:500], strict=True)]
    np.testing.assert_allclose(angle[:500], expected, atol=1e-9)
    turned_foot = np.random.default_rng(22).uniform(-np.pi, np.pi, COUNT)
    x, y = measured * np.cos(turned + turned_foot), measured * np.sin(turned + turned_foot)
    printed = [naive.printed_heading(*z) for z in zip(x, y, np.full(COUNT, H), size, strict=True)]
    right = np.abs(wrapped(printed - turned_foot)) < 1e-6
    print(f"printed arc sines are right in {100 * right.mean():.0f} %")
    assert 0.2 < right.mean() < 0.3


def test_the_nearer_side_is_the_limit(cases):
    """Right wherever the two sides are further apart than the gyroscope is wrong, and never worse than twice
    the gyroscope."""
    size, _, turned, gyro = cases
    found, _, _, truth = resolved(settings(softness=1e-3), cases)
    big = size > 0.1 * H
    error = np.abs(wrapped(found - truth))[big]
    angle, wrong = np.abs(turned)[big], np.abs(gyro)[big]
    clear = angle * (angle - wrong) > 1e-3
    print(f"right in {100 * (error < 1e-6).mean():.0f} %, clear in {100 * clear.mean():.0f} %")
    assert error[clear].max() < 1e-6
    assert (error <= 2 * wrong + 1e-3).all()
    assert 0.75 < (error < 1e-6).mean() < 0.95


def test_a_soft_choice_errs_less_than_a_hard_one(cases):
    rms = {}
    for softness in (1e-3, 1.0):
        found, _, plain, truth = resolved(settings(softness=softness, least=1e-3), cases)
        rms[softness] = np.degrees(np.sqrt(np.mean(wrapped(found - truth) ** 2)))
    rms["none"] = np.degrees(np.sqrt(np.mean(wrapped(plain - truth) ** 2)))
    print({k: round(float(x), 2) for k, x in rms.items()})
    assert rms[1.0] < 0.9 * rms[1e-3]
    assert rms[1e-3] < 0.5 * rms["none"]


def test_the_soft_choice_is_the_mean_of_both_sides(cases):
    """By how likely either is; what the choice adds is the variance of that, and the angle's own."""
    found, added, plain, _ = resolved(settings(least=1e-3), cases, sigma=0.2)
    size, measured, _, _ = cases
    for k in range(300):
        angle = naive.triangle(measured[k], H, size[k])
        own = float(sides(measured[k], H, size[k], 0.2)[1])
        middle, between = naive.expected(plain[k], angle, BESIDE**2 / 3 + own)
        assert naive.wrapped(found[k] - middle) == pytest.approx(0, abs=1e-9)
        assert added[k] == pytest.approx(own + between, rel=1e-9, abs=1e-12)


def test_sides_that_meet_behind_are_one():
    """A disturbance larger than the earth's field may turn it round: both sides are half a turn on, and the
    heading is there, not in front."""
    measured, earth, disturbance = 8.0, 20.0, 28.0
    found, added = chosen(settings(), 0.1, 0.03, (measured, earth, disturbance), 1e-6)
    assert wrapped(found - 0.1 - np.pi) == pytest.approx(0, abs=1e-3)
    assert added < 0.01
    rng = np.random.default_rng(23)
    for _ in range(50):
        disturbance = rng.uniform(1.1, 2.0) * earth
        measured = rng.uniform(disturbance - earth + 0.5, disturbance + earth - 0.5)
        innovation = rng.uniform(-3, 3)
        angle = naive.triangle(measured, earth, disturbance)
        own = float(sides(measured, earth, disturbance, 1e-6)[1])
        middle, between = naive.expected(innovation, angle, 0.5 + own)
        found, added = chosen(settings(), innovation, 0.5, (measured, earth, disturbance), 1e-6)
        assert naive.wrapped(float(found) - middle) == pytest.approx(0, abs=1e-6)
        assert added == pytest.approx(own + between, rel=1e-6, abs=1e-9)


def test_the_angle_s_variance_is_that_of_noisy_lengths():
    """Where the triangle is open; where it closes, of that size at least."""
    rng = np.random.default_rng(24)
    for measured, size in ((18.0, 10.0), (25.0, 8.0), (21.0, 4.0)):
        noisy = measured + 0.1 * rng.normal(size=20000)
        angle = np.asarray(sides(noisy, H + 0 * noisy, size + 0 * noisy, 0 * noisy)[0])
        assert float(sides(measured, H, size, 0.1)[1]) == pytest.approx(angle.var(), rel=0.1)
    for way in (1, -1):  # on a line with it
        noisy = H + way * 6.0 + 0.1 * rng.normal(size=20000)
        angle = np.asarray(sides(noisy, H + 0 * noisy, 6.0 + 0 * noisy, 0 * noisy)[0])
        said = float(sides(H + way * 6.0, H, 6.0, 0.1)[1])
        assert 0.8 * angle.var() < said < 10 * angle.var()


def test_small_disturbances_are_left_alone(cases):
    found, added, plain, _ = resolved(settings(), cases)
    small = cases[0] < 0.1 * H
    assert 300 < small.sum() < 900
    np.testing.assert_allclose(found[small], plain[small], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(added[small], 0.0)
    assert (np.abs(wrapped(found - plain))[~small] > 0).mean() > 0.99
    soft, _, _, _ = resolved(settings(width=0.3), cases)
    between = np.abs(wrapped(soft - plain))[small]
    assert between.max() > 0


@partial(jax.jit, static_argnames="dtype")
def slopes(given, softness, dtype):
    p = parameters.with_leaves(parameters.cast(Compensation(mode="magnitude"), dtype), {"softness": softness})
    p = parameters.with_leaves(p, {"width": jnp.asarray(0.2, dtype)})

    def both(p, given):
        innovation, variance, level, sigma = given
        found, added = compensation.chosen(p, innovation, variance, level, sigma)
        return jnp.sum(found) + jnp.sum(added), (found, added)

    return jax.value_and_grad(both, argnums=(0, 1), has_aux=True)(p, given)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("softness", [1e-3, 1.0, 100.0])
def test_all_is_finite_at_and_beyond_the_triangle_s_limits(dtype, softness):
    """Closed, open by a little or by much, no field at all, and no disturbance."""
    lengths = [(H + d + e, d) for d in (0.0, 1e-3, 6.0, 20.999, 21.0, 30.0) for e in (0, 1e-9, 1e-3, 3.0)]
    lengths += [(abs(H - d) - e, d) for d in (6.0, 21.0, 30.0) for e in (0, 1e-9, 1e-3, 3.0)]
    lengths += [(0.0, 0.0), (0.0, 21.0), (1e-7, 20.0), (80.0, 1.0)]
    measured, size = jnp.asarray(np.maximum(np.transpose(lengths), 0.0), dtype)
    like = jnp.zeros_like(measured)
    for innovation in (0.0, 0.4, np.pi):
        level = (measured, like + H, size)
        given = (like + innovation, like + 1e-6, level, like + jnp.asarray(0.3, dtype))
        for x in jax.tree.leaves(slopes(given, jnp.asarray(softness, dtype), dtype)):
            assert x.dtype == dtype
            assert np.isfinite(x).all()


def test_slopes_of_the_innovation_equal_differences(cases):
    """By the softness, and by what is measured."""
    p = settings(least=1e-3)
    numbers = [jnp.asarray(x[:50]) for x in cases]
    size, measured, turned, gyro = numbers
    like, plain = jnp.zeros(50), -gyro - turned

    @jax.jit
    @jax.value_and_grad
    def total(values):
        q = parameters.with_leaves(p, {"softness": values["softness"]})
        level = measured * values["stretch"], like + H, size
        moved, added = compensation.chosen(q, plain, like + values["variance"], level, like + 0.3)
        return jnp.sum(moved * jnp.arange(50)) + jnp.sum(added)

    values = {"softness": jnp.asarray(0.7), "stretch": jnp.asarray(1.01), "variance": jnp.asarray(0.05)}
    found = total(values)[1]
    for name, x in values.items():
        h = 1e-6 * x
        up, down = (total({**values, name: x + s})[0] for s in (h, -h))
        assert found[name] == pytest.approx(float((up - down) / (2 * h)), rel=1e-5), name
        assert found[name] != 0
