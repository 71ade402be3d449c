"""Looks at the field against a naive foot; the rows of a heading against the attitude truly perturbed."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters, rotations
from pedjax.calibration import Calibration, apply
from pedjax.filters import compass, measurements
from pedjax.filters.compass import Foot, HeadingNoise, Level, Looking
from pedjax.filters.strapdown import still_at_origin
from pedjax.systems import system
from tests.reference import field as naive
from tests.reference import filter as dense

LANES, SMALL = 40, 1e-6
MUNICH = np.array([1.2, 21.2, -43.3])


@pytest.fixture(scope="module")
def poses():
    """Attitudes `(3, 3, L)` with pitches up to 75 degrees, and fields `(3, L)` in navigation axes."""
    rng = np.random.default_rng(12)
    roll, yaw = rng.uniform(-np.pi, np.pi, (2, LANES))
    pitch = np.radians(rng.uniform(-75, 75, LANES))
    attitude = np.asarray(rotations.from_euler(*map(jnp.asarray, (roll, pitch, yaw))))
    return attitude, MUNICH[:, None] + rng.normal(0, 8.0, (3, LANES))


def perturbed(of, row):
    """`row (m, 3, L)` times each unit t, and the central difference of `of(exp([t x]))`, `(3, m, L)` each."""
    found, differences = [], []
    for axis in np.eye(3):
        up, down = (of(dense.rotation(s * SMALL * axis)) for s in (1, -1))
        found.append(np.einsum("ijl,j->il", row, axis))
        differences.append((up - down) / (2 * SMALL))
    return np.stack(found), np.stack(differences)


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def test_azimuth_row_is_the_slope_of_the_true_azimuth(poses):
    _, b = poses

    def azimuth(turn):
        truth = turn @ b
        return wrapped(np.arctan2(truth[1], truth[0]) - np.arctan2(b[1], b[0]))[None]

    found, differences = perturbed(azimuth, np.asarray(measurements.azimuth_row(jnp.asarray(b))))
    np.testing.assert_allclose(found, differences, atol=2e-7)
    level = np.hypot(b[0], b[1])
    tilt = np.hypot(*np.asarray(measurements.azimuth_row(jnp.asarray(b)))[0, :2])
    np.testing.assert_allclose(tilt, np.abs(b[2]) / level, rtol=1e-9)  # a tilt tells by the inclination
    assert np.isfinite(measurements.azimuth_row(jnp.zeros(3))).all()


def test_heading_takes_true_minus_estimated(poses):
    row = measurements.azimuth_row(jnp.asarray(poses[1]))
    rows = measurements.heading(jnp.asarray(0.1), row, jnp.asarray(0.02))
    assert rows.innovation.shape == (1, LANES)
    np.testing.assert_allclose(rows.noise, 4e-4 * np.ones((1, 1, LANES)))
    assert set(rows.H) == {"t"}


def test_same_field_is_the_slope_of_what_is_missing(poses):
    """B_anchor − Ĉ m where the truth is exp([t x]) Ĉ: what the row says for a small t."""
    _, b = poses
    rows = measurements.same_field(jnp.asarray(b), jnp.asarray(b), jnp.asarray(0.3))
    found, differences = perturbed(lambda turn: turn @ b - b, np.asarray(rows.H["t"]))
    np.testing.assert_allclose(found, differences, atol=1e-6)
    t = np.array([0.002, -0.001, 0.003])
    anchor = dense.rotation(t) @ b
    rows = measurements.same_field(jnp.asarray(b), jnp.asarray(anchor), jnp.asarray(0.3))
    np.testing.assert_allclose(rows.innovation, anchor - b)
    np.testing.assert_allclose(
        np.einsum("ijl,j->il", rows.H["t"], t), rows.innovation, atol=2 * np.linalg.norm(b) * (t @ t)
    )
    np.testing.assert_allclose(rows.noise[..., 0], 0.18 * np.eye(3))


def test_field_rate_finds_the_bias(poses):
    """In a steady field z = g x m: exactly H g for the bias error g, and nothing along the field."""
    attitude, b = poses
    rng = np.random.default_rng(4)
    rate, bias, error = (
        rng.normal(0, 1.0, (3, LANES)),
        rng.normal(0, 0.02, (3, 1)),
        rng.normal(0, 0.01, (3, 1)),
    )
    dt = 1e-4
    body = np.einsum("jil,jl->il", attitude, b)
    truth = [
        np.stack([dense.rotation(s * 0.5 * dt * rate[:, k]) @ body[:, k] for k in range(LANES)], axis=1)
        for s in (1, -1)
    ]
    nav = still_at_origin(jnp.asarray(attitude))._replace(gyroscope_bias=jnp.asarray(bias - error))
    rows = measurements.field_rate(
        nav, jnp.asarray(rate + bias), *map(jnp.asarray, truth), jnp.asarray(dt), (0.3, 1e-3)
    )
    np.testing.assert_allclose(rows.innovation, np.einsum("ijl,jm->il", rows.H["g"], error), atol=1e-5)
    np.testing.assert_allclose(rows.innovation, np.cross(error, body, axis=0), atol=1e-5)
    np.testing.assert_allclose(np.einsum("il,il->l", rows.innovation, body), 0, atol=1e-3)
    cross = dense.skew(body[:, 3])
    middle = 2 * (0.3 / dt) ** 2 * np.eye(3) + 1e-6 * cross @ cross.T
    np.testing.assert_allclose(rows.noise[..., 3], middle, rtol=1e-9, atol=1e-6)
    idle = measurements.field_rate(
        nav, jnp.asarray(rate), *map(jnp.asarray, truth), jnp.asarray(0.0), (0.3, 1e-3)
    )
    assert np.isfinite(idle.innovation).all()
    assert np.isfinite(idle.noise).all()


def test_heading_sigma_in_closed_form():
    p = HeadingNoise()
    reference = jnp.array([48.0, 1.1])

    def sigma(b, **changes):
        return float(compass.heading_sigma(parameters.replace(p, changes), jnp.asarray(b), reference))

    none = {"floor": 1e-4, "field": 1e-4, "tilt": 1e-6}
    level, down = 20.0, -40.0
    b = [12.0, 16.0, down]
    assert sigma(b, **none | {"floor": 0.07}) == pytest.approx(0.07, rel=1e-5)
    assert sigma(b, **none | {"field": 0.3}) == pytest.approx(0.3 / level, rel=1e-4)
    assert sigma(b, **none | {"tilt": 0.01}) == pytest.approx(0.01 * 2, rel=1e-4)  # tan of the inclination
    odd = np.hypot(np.hypot(level, down) / 48.0 - 1, np.arctan2(-down, level) - 1.1)
    assert sigma(b, **none | {"oddity": 3.0}) == pytest.approx(3 * odd, rel=1e-6)
    parts = [p.floor, p.field / level, p.tilt * 2]
    assert sigma(b) == pytest.approx(np.linalg.norm(parts), rel=1e-6)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("b", [[0.0, 0.0, 0.0], [0.0, 0.0, -48.0], [1e-9, 0.0, -48.0]])
def test_heading_sigma_is_finite_without_a_horizontal_field(b, dtype):
    p = parameters.cast(parameters.replace(HeadingNoise(), {"oddity": 1.0}), dtype)
    for reference in ([48.0, 1.1], [1e-6, 0.0]):
        found, slope = jax.value_and_grad(compass.heading_sigma, (0, 1))(
            p, jnp.asarray(b, dtype), jnp.asarray(reference, dtype)
        )
        assert np.isfinite(found)
        assert found > 0.5
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slope))


DT = 0.01


@partial(jax.jit, static_argnames=("looking", "steps"))
def watch(looking, level, attitude, force, mag, dt, still, variance=None, steps=3):
    """All samples `(T, ...)` of one foot, as the filter's step goes through them."""

    def one(state, foot):
        return compass.look(looking, level, state, foot)

    variance = jnp.zeros_like(dt) if variance is None else variance
    samples = Foot(attitude, variance, force, mag, dt, still)
    return jax.lax.scan(one, compass.first(attitude[0], steps), samples)


def stances(*lengths, count=None):
    """Stance and movement in turn, in samples: first still."""
    found = np.concatenate([np.full(n, 1.0 - k % 2) for k, n in enumerate(lengths)])
    return found if count is None else np.pad(found, (0, count - len(found)))


def turning(count, seed=2):
    """A tumbling foot: attitudes, forces at rest with noise, and the steady field it sees."""
    rng = np.random.default_rng(seed)
    attitude = [np.eye(3)]
    for _ in range(count - 1):
        attitude.append(attitude[-1] @ dense.rotation(rng.normal(0, 0.05, 3)))
    attitude = np.stack(attitude)
    force = np.einsum("tji,j->ti", attitude, [0.0, 0.0, 9.8]) + rng.normal(0, 0.2, (count, 3))
    mag = np.einsum("tji,j->ti", attitude, MUNICH) + rng.normal(0, 0.5, (count, 3))
    return attitude, force, mag


def looked(still, dt=DT, **settings):
    """Samples `(K,)` at which a foot looks."""
    count = len(still)
    foot = turning(count)
    p = parameters.replace(Looking(), settings)
    given = (*foot, np.full(count, dt), still)
    end, now = watch(p, Level(), *(jnp.asarray(x, float) for x in given))
    assert end.many == now.sum()
    return np.flatnonzero(now)


def test_one_look_in_each_stance():
    still = stances(40, 40, 30, 40, 60, 40)
    found = looked(still)
    np.testing.assert_array_equal(found, [11, 80 + 11, 150 + 11])


def test_a_stance_that_is_too_short_is_not_looked_at():
    still = stances(40, 40, 9, 40, 30, 40)
    np.testing.assert_array_equal(looked(still), [11, 129 + 11])
    assert not len(looked(stances(0, 40, 9, 40, 9, 40)))


def test_flicker_does_not_begin_a_stance():
    """A gap shorter than the movement that ends a stance: one look, after as much stillness in all."""
    still = stances(6, 10, 30, 12, 30, 40, 30)
    np.testing.assert_array_equal(looked(still, gap_s=0.15), [16 + 5, 128 + 11])
    # a shorter gap ends it
    np.testing.assert_array_equal(looked(still, gap_s=0.09), [16 + 11, 58 + 11, 128 + 11])


def test_every_still_sample():
    still = stances(5, 3, 4)
    np.testing.assert_array_equal(looked(still, per="sample", settle_s=0.0), np.flatnonzero(still))
    # the first moments of a stance are left out, and with them all of a short one
    still = stances(12, 20, 4)
    np.testing.assert_array_equal(looked(still, per="sample", settle_s=0.05), np.arange(4, 12))


def test_a_window_of_samples_lies_within_one_stance():
    """Looks are counted anew once the foot has moved long enough to end the stance; those of steps go on."""

    def follow(still, **settings):
        count = len(still)
        given = (*turning(count), np.full(count, DT), still)
        end, _ = watch(parameters.replace(Looking(), settings), Level(), *(jnp.asarray(x) for x in given))
        return float(end.follow), float(end.many)

    every = {"per": "sample", "settle_s": 0.0}
    assert follow(stances(12, 5, 4), **every) == (16, 16)  # a gap is not the end
    assert follow(stances(12, 20, 4), **every) == (4, 16)
    assert follow(stances(12, 20), **every) == (0, 12)
    assert follow(stances(30, 20, 30, 20, 30)) == (3, 3)


def test_padding_does_not_look():
    assert not len(looked(stances(40), dt=0.0))
    assert not len(looked(stances(40), dt=0.0, per="sample"))


CALIBRATED = {"offset_x": 3.0, "offset_y": -2.0, "xx": 1.1, "xy": 0.05, "yy": 0.93}


@pytest.mark.parametrize("per", ["step", "sample"])
@pytest.mark.parametrize("levelling", ["force", "attitude"])
@pytest.mark.parametrize("soft", [False, True])
def test_looks_equal_a_naive_foot(per, levelling, soft):
    rng = np.random.default_rng(9)
    still = stances(30, 45, 28, 6, 20, 45, 8, 45, 30, 45, 40)
    if soft:
        still = np.clip(np.abs(still - rng.uniform(0, 0.4, len(still))), 0, 1)
    count = len(still)
    dt = rng.uniform(0.008, 0.012, count)
    foot = turning(count)
    p = parameters.replace(Looking(), {"per": per, "levelling": levelling})
    level = parameters.replace(Level(), CALIBRATED)
    variance = np.cumsum(rng.uniform(0.0, 1e-4, count))
    end, now = watch(p, level, *(jnp.asarray(x) for x in (*foot, dt, still, variance)))
    other = naive.Foot(
        naive.MagneticSettings(
            per=per,
            levelling=levelling,
            offset=np.array([3.0, -2.0]),
            soft=np.array([[1.1, 0.05], [0.05, 0.93]]),
        ),
        foot[0][0],
    )
    saw = [other.see(*(x[k] for x in (*foot, dt, still, variance))) for k in range(count)]
    np.testing.assert_array_equal(now, saw)
    assert sum(saw) >= 4
    for ours, theirs in zip(end.window, other.looks[-4:], strict=True):
        np.testing.assert_allclose(ours.field, theirs.field, atol=1e-9)
        assert ours.yaw == pytest.approx(theirs.yaw, abs=1e-9)
        assert ours.time == pytest.approx(theirs.time, abs=1e-9)
        assert ours.variance == theirs.variance
    assert end.many == len(other.looks)
    assert end.follow == other.together


@pytest.mark.parametrize("levelling", ["force", "attitude"])
def test_a_foot_at_rest_sees_the_field_of_the_place(poses, levelling):
    """Whatever its attitude; levelled by the force, the yaw alone is the attitude's."""
    attitude, _ = poses
    force = np.einsum("jil,j->il", attitude, [0.0, 0.0, 9.8])
    mag = np.einsum("jil,j->il", attitude, MUNICH)

    def seen(attitude):
        up = force if levelling == "force" else attitude[2]
        return np.asarray(compass.levelled(jnp.asarray(attitude), jnp.asarray(up), jnp.asarray(mag), Level()))

    np.testing.assert_allclose(seen(attitude), np.tile(MUNICH[:, None], LANES), atol=1e-9)
    t = SMALL * np.array([20.0, -10.0, 30.0])
    wrong = seen(np.einsum("ij,jkl->ikl", dense.rotation(-t), attitude))
    expected = dense.rotation(-t if levelling == "attitude" else np.array([0.0, 0.0, -t[2]])) @ MUNICH
    # the least rotation has no part about up: of an error of the attitude its own turn about up is left
    np.testing.assert_allclose(wrong, np.tile(expected[:, None], LANES), atol=1e-7)


def test_what_points_down_is_finite():
    down = jnp.asarray(dense.euler_attitude(np.pi, 0.0, 0.3))
    slope = jax.jacfwd(compass.levelled, argnums=(0, 2))(down, down[2], jnp.asarray(MUNICH), Level())
    assert all(np.isfinite(x).all() for x in slope)


@pytest.mark.parametrize("how", ["force", "attitude"])
def test_looks_are_turned_with_the_attitude(how):
    foot = turning(60)
    still = stances(20, 20, 20)
    end, _ = watch(Looking(), Level(), *(jnp.asarray(x) for x in (*foot, np.full(60, DT), still)))
    t = np.array([0.01, -0.02, 0.1])
    turn = dense.rotation(t if how == "attitude" else np.array([0.0, 0.0, 0.1]))
    after = compass.turned(end, jnp.asarray(t), how)
    for old, new in zip(end.window, after.window, strict=True):
        np.testing.assert_allclose(new.field, turn @ np.asarray(old.field), atol=1e-12)
        assert float(new.yaw) == pytest.approx(float(old.yaw) + 0.1, abs=1e-12)
    same = compass.turned(end, jnp.zeros(3), how)
    np.testing.assert_array_equal(same.window[-1].field, end.window[-1].field)


def test_looking_has_finite_slopes_where_nothing_was_seen():
    foot = [jnp.asarray(x) for x in turning(30)]

    def total(level, still):
        end, _ = watch(Looking(), level, *foot, jnp.full(30, DT), still)
        return sum(jnp.sum(look.field) + look.yaw for look in end.window) + end.clock.seconds

    level = parameters.cast(Level(), float)
    for still in (jnp.zeros(30), jnp.ones(30)):
        for x in jax.tree.leaves(jax.grad(total, (0, 1))(level, still)):
            assert np.isfinite(x).all()


def test_the_body_calibration_is_the_calibrations(rng):
    made = Calibration(*(rng.normal(size=shape) for shape in ((3,), (3, 3), (2,), (2, 2))), level_ahead=1)
    known = system("ma2018").defaults()
    whole = "compass.body."
    found = compass.calibrated_by(known, made)
    assert found["compass.level.ahead"] == "y"
    paths = {k.removeprefix(whole): v for k, v in found.items() if k.startswith(whole)}
    assert paths.keys() == parameters.specs(compass.Body()).keys()
    body = parameters.cast(parameters.with_leaves(compass.Body(), paths), float)
    raw = rng.normal(size=(5, 3)) * 40
    np.testing.assert_allclose(compass.in_body(body, jnp.asarray(raw.T)).T, apply(made, raw), atol=1e-12)
