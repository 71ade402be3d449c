"""The alignment of a standing foot against naive loops; what no alignment can do; how sure it is."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.calibration import attitude
from pedjax.calibration.attitude import Align, Earth, Stand
from tests.reference import alignment as naive
from tests.reference import filter as dense

DT, LANES = 0.01, 8
CLOSED = ("triad", "weighted")


def settings(**changes):
    return parameters.cast(parameters.replace(Align(), changes), float)


@partial(jax.jit, static_argnames="method")
def aligned(p, method, stand, earth, first=None):
    return attitude.aligned(p, method, stand, earth, first)


@partial(jax.jit, static_argnames="method")
def followed(p, method, stand, earth, first=None):
    return attitude.path(p, method, stand, earth, first)


class Made(NamedTuple):
    """A stand as both sides take it, the earth's fields, and the true attitudes (K, 3, 3)."""

    stand: Stand
    earth: Earth
    truth: np.ndarray


def made(seed=0, count=300, lanes=LANES, noise=(0.0, 0.0, 0.0), disturbance=None, truth=None):
    """A foot that stands still with any attitude in any field; `disturbance (count, 3, lanes)` in navigation
    axes; noises of force, rate and field."""
    rng = np.random.default_rng(seed)
    shape = count, 3, lanes
    if truth is None:
        truth = np.stack([dense.rotation(x) for x in turns(rng, lanes)])
    numbers = rng.uniform((40.0, 0.9, -np.pi), (55.0, 1.25, np.pi), (lanes, 3)).T
    fields = np.stack([naive.Earth(*x).field() for x in numbers.T], axis=-1)
    seen = fields + (np.zeros(shape) if disturbance is None else disturbance)
    force = np.broadcast_to(9.81 * truth[:, 2].T, shape) + noise[0] * rng.normal(size=shape)
    field = np.einsum("kji,tjk->tik", truth, seen) + noise[2] * rng.normal(size=shape)
    rate = noise[1] * rng.normal(size=shape)
    dt = np.full((count, lanes), DT)
    stand = Stand(*(jnp.asarray(x) for x in (dt, force, rate, field)))
    return Made(stand, Earth(*(jnp.asarray(x) for x in numbers)), truth)


def turns(rng, count):
    """Rotation vectors of rotations evenly over all."""
    q = rng.normal(size=(count, 4))
    q *= np.sign(q[:, :1]) / np.linalg.norm(q, axis=1, keepdims=True)
    return 2 * np.arccos(q[:, :1]) * q[:, 1:] / np.linalg.norm(q[:, 1:], axis=1, keepdims=True)


def one(m, k):
    """A lane as the loops take it."""
    stand = naive.Stand(*(np.asarray(x[..., k]) for x in m.stand))
    return stand, naive.Earth(*(float(x[k]) for x in m.earth))


def split(C, truth):
    """Error of tilt and of heading, degrees."""
    away = np.array([naive.vector(np.asarray(C[..., k]) @ truth[k].T) for k in range(len(truth))])
    tilt = [np.arccos(np.clip(np.asarray(C[2, :, k]) @ truth[k, 2], -1, 1)) for k in range(len(truth))]
    return np.degrees(tilt), np.degrees(away[:, 2])


def about_up(C, other):
    """The angle about up from one to the other, degrees."""
    apart = np.einsum("ijk,ljk->ilk", C, other)
    return np.degrees(np.arctan2(apart[1, 0] - apart[0, 1], apart[0, 0] + apart[1, 1]))


NOISE = (0.05, 0.01, 0.4)


def test_triad_is_exact_for_clean_data():
    m = made(1)
    for method in CLOSED:
        found = aligned(settings(), method, m.stand, m.earth)
        np.testing.assert_allclose(np.moveaxis(found.attitude, -1, 0), m.truth, atol=1e-12)
        np.testing.assert_allclose(found.disturbance, 0.0, atol=1e-11)
        np.testing.assert_allclose(found.field, m.earth.field(), atol=1e-11)
        np.testing.assert_allclose(found.spread, 0.0, atol=1e-7)


def test_the_closed_methods_equal_the_loops():
    rng = np.random.default_rng(2)
    passing = 15 * rng.normal(size=(1, 3, LANES)) * (np.arange(300) > 120)[:, None, None]
    m, p = made(2, noise=NOISE, disturbance=passing), settings()
    weights = attitude.purity(p, m.stand, m.earth)
    for k in range(LANES):
        stand, earth = one(m, k)
        expected = naive.purity(stand, earth, float(p.strength_spread), float(p.dip_spread))
        np.testing.assert_allclose(weights[:, k], expected, rtol=1e-9, atol=1e-15)
        for method, w in (("triad", stand.dt), ("weighted", expected)):
            found = aligned(p, method, m.stand, m.earth)
            C = naive.triad(naive.mean(stand.force, stand.dt), naive.mean(stand.field, w), earth)
            seen = C @ naive.mean(stand.field, w)
            np.testing.assert_allclose(found.attitude[..., k], C, atol=1e-10)
            np.testing.assert_allclose(found.field[:, k], seen, atol=1e-9)
            np.testing.assert_allclose(found.disturbance[:, k], seen - earth.field(), atol=1e-9)
            singles = [naive.triad(*x, earth) for x in zip(stand.force, stand.field, strict=True)]
            np.testing.assert_allclose(found.spread[:, k], naive.spread(singles, C, stand.dt), atol=1e-9)
            tilt = naive.variance(stand.force, stand.dt) / np.sum(naive.mean(stand.force, stand.dt) ** 2)
            assert found.tilt[k] == pytest.approx(tilt, rel=1e-9)
            unrest = naive.variance(stand.field, w)
            assert found.heading[k] == pytest.approx(
                naive.heading_variance(seen, earth, tilt, unrest), rel=1e-7
            )


def test_weights_leave_out_what_passes_by():
    rng = np.random.default_rng(3)
    passing = 20 * rng.normal(size=(1, 3, LANES)) * (np.arange(300) < 200)[:, None, None]
    m = made(3, noise=NOISE, disturbance=passing)
    errors = {x: np.abs(split(aligned(settings(), x, m.stand, m.earth).attitude, m.truth)[1]) for x in CLOSED}
    print({x: np.round(e, 2) for x, e in errors.items()})
    assert np.median(errors["weighted"]) < 0.1 * np.median(errors["triad"])
    assert errors["weighted"].max() < 1.5


def test_weights_sum_to_one_and_padding_has_none():
    m = made(4, noise=NOISE)
    gone = m.stand.dt.at[40:55].set(0.0).at[7, 2].set(0.0)
    weights = attitude.purity(settings(), m.stand._replace(dt=gone), m.earth)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, rtol=1e-12)
    assert not np.asarray(weights)[40:55].any()
    assert weights[7, 2] == 0
    assert (np.asarray(weights)[56:] > 0).all()


def padded(stand, rows=40):
    """With rows of no time, filled with what is not a field."""
    return Stand(
        jnp.concatenate([stand.dt, jnp.zeros((rows, *stand.dt.shape[1:]))]),
        *(jnp.concatenate([x, jnp.full((rows, *x.shape[1:]), 77.0)]) for x in stand[1:]),
    )


@pytest.mark.parametrize("method", attitude.METHODS[1:])
def test_padding_changes_nothing_and_lanes_are_their_own(method):
    m, p = made(5, count=150, noise=NOISE), settings()
    whole = aligned(p, method, m.stand, m.earth)
    for ours, theirs in zip(whole, aligned(p, method, padded(m.stand), m.earth), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)
    keep = jnp.array([3, 3, 1, 3, 3, 3, 3, 3])
    other = Stand(*(x[..., keep] for x in m.stand)), Earth(*(x[keep] for x in m.earth))
    for ours, theirs in zip(whole, aligned(p, method, *other), strict=True):
        np.testing.assert_allclose(ours[..., 1], theirs[..., 2], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(ours[..., 3], theirs[..., 0], rtol=1e-12, atol=1e-12)


def cases(seed, count=200):
    """Quaternions, not all of length 1, unit forces, fields and references (count, ...)."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True) * rng.choice([1.0, 0.9], (count, 1))
    f, b = rng.normal(size=(2, count, 3))
    f /= np.linalg.norm(f, axis=1, keepdims=True)
    m = rng.normal(size=(count, 3)) * [1.0, 0.0, 1.0]
    return q, f, b, m


slope = jax.jit(jax.grad(lambda *x: jnp.sum(attitude.mismatch(*x))))


def test_the_gradient_is_the_corrected_one_and_not_the_printed():
    q, f, b, m = cases(6)
    found = np.asarray(slope(q.T, f.T, b.T, m.T)).T
    rows = zip(q, f, b, m, strict=True)
    wrong = []
    for ours, (q1, f1, b1, m1) in zip(found, rows, strict=True):
        np.testing.assert_allclose(ours, naive.gradient(q1, f1, b1, m1), atol=1e-12)
        h = 1e-6 * np.eye(4)
        half = [0.5 * np.sum(naive.mismatch(q1 + s, f1, b1, m1) ** 2) for s in (*h, *-h)]
        np.testing.assert_allclose(ours, (np.array(half[:4]) - half[4:]) / 2e-6, atol=2e-8)
        halves = naive.printed_jacobian(q1, m1).T, naive.printed_mismatch(q1, f1, b1, m1)
        printed = (
            halves[0] @ naive.mismatch(q1, f1, b1, m1),
            naive.jacobian(q1, m1).T @ halves[1],
        )
        wrong.append([np.linalg.norm(x - ours) / np.linalg.norm(ours) for x in printed])
    print("printed J, printed h: relative error of the gradient", np.median(wrong, axis=0).round(2))
    assert (np.median(wrong, axis=0) > 0.1).all()


def steepest(q, f, b, m, gradient, steps=4000):
    """Gradient descent with small steps, from q."""
    for k in range(steps):
        g = gradient(q, f, b, m)
        q = naive.unit(q - 0.02 / (1 + k / 400) * g / max(np.linalg.norm(g), 1e-6))
    return q


def test_the_printed_reference_leads_elsewhere():
    """From the truth itself: the corrected gradient stays, plus sine of the inclination goes away, and so do
    the printed h and J."""
    rng = np.random.default_rng(7)
    away = {"corrected": [], "sine": [], "printed": []}

    def printed(q, f, b, m):
        return naive.printed_jacobian(q, m).T @ naive.printed_mismatch(q, f, b, m)

    for _ in range(4):
        q, kappa = naive.unit(rng.normal(size=4)), 1.1
        C = naive.matrix(q)
        m = np.array([np.cos(kappa), 0.0, -np.sin(kappa)])
        f, b = C[:, 2], C @ m
        ways = {"corrected": (m, naive.gradient), "sine": (-m * [-1, 0, 1], naive.gradient)}
        ways["printed"] = m, printed
        for name, (reference, way) in ways.items():
            there = naive.matrix(steepest(q, f, b, reference, way, 1500))
            away[name].append(np.degrees(naive.angle(there @ C.T)))
    print({name: np.round(x, 1) for name, x in away.items()})
    assert max(away["corrected"]) < 0.5
    assert min(away["sine"]) > 60
    assert np.median(away["printed"]) > 20


@pytest.mark.parametrize("how", ["data", "fixed"])
@pytest.mark.parametrize("method", attitude.SAMPLEWISE)
def test_samplewise_methods_equal_the_loops(method, how):
    """From TRIAD, and from an attitude that is far off."""
    rng = np.random.default_rng(8)
    passing = 6 * rng.normal(size=(1, 3, LANES)) * (np.arange(300) > 150)[:, None, None]
    m = made(8, noise=NOISE, disturbance=passing)
    p = settings(reference=how)
    elsewhere = np.stack([dense.rotation(x) for x in turns(rng, LANES)])
    seeds = {"triad": None, "elsewhere": jnp.asarray(np.moveaxis(elsewhere, 0, -1))}
    for name, first in seeds.items():
        found, told = (
            followed(p, method, m.stand, m.earth, first),
            aligned(p, method, m.stand, m.earth, first),
        )
        for k in range(4):
            stand, earth = one(m, k)
            start = naive.seeded(stand, earth) if first is None else elsewhere[k]
            ours = np.asarray(found[..., k])
            if method == "gauss_newton":
                expected = naive.gauss_newton(stand, earth, start, float(p.field_weight), how)
            else:
                numbers = float(p.gain), float(p.decay), float(p.softness), how, method == "agda"
                expected = naive.descent(stand, earth, start, *numbers, along=ours)
                whole = naive.descent(stand, earth, start, *numbers)
                np.testing.assert_allclose(ours[:20], whole[:20], atol=1e-9, err_msg=name)
            np.testing.assert_allclose(ours, expected, atol=1e-9, err_msg=name)
            C = naive.middle(ours, stand.dt)
            np.testing.assert_allclose(told.attitude[..., k], C, atol=1e-9)
            np.testing.assert_allclose(told.spread[:, k], naive.spread(ours, C, stand.dt), atol=1e-8)
            last = naive.last_second(stand.dt)
            seen = C @ naive.mean(stand.field, last)
            np.testing.assert_allclose(told.field[:, k], seen, atol=1e-8)
            sway = naive.variance(stand.force, last) / np.sum(naive.mean(stand.force, last) ** 2)
            assert told.tilt[k] == pytest.approx(sway, rel=1e-9)
            unrest = naive.variance(stand.field, last)
            assert told.heading[k] == pytest.approx(
                naive.heading_variance(seen, earth, sway, unrest), rel=1e-6
            )


def test_the_level_seed_is_no_turn_at_all():
    m, p = made(9, noise=NOISE), settings(seed="level")
    eye = jnp.broadcast_to(jnp.eye(3)[..., None], (3, 3, LANES))
    level = followed(p, "gda", m.stand, m.earth)
    np.testing.assert_array_equal(level, followed(settings(), "gda", m.stand, m.earth, eye))
    assert np.abs(level[0] - followed(settings(), "gda", m.stand, m.earth)[0]).max() > 0.5


@pytest.mark.parametrize("how", ["data", "fixed"])
@pytest.mark.parametrize("method", attitude.SAMPLEWISE)
def test_from_anywhere_clean_data_arrive(method, how):
    """Two hundred starts, five seconds. From half a turn about up, where a gradient sees nothing, Gauss and
    Newton do."""
    lanes = 200
    m = made(10, count=500, lanes=lanes)
    rng = np.random.default_rng(10)
    first = np.stack([dense.rotation(x) for x in turns(rng, lanes)])
    if method == "gauss_newton":
        first[0] = naive.turn(np.pi - 1e-3) @ m.truth[0]
    found = aligned(settings(reference=how), method, m.stand, m.earth, jnp.asarray(np.moveaxis(first, 0, -1)))
    away = np.degrees([naive.angle(np.asarray(found.attitude[..., k]) @ m.truth[k].T) for k in range(lanes)])
    print(f"{method}, {how}: 50, 90, 100 %: {np.percentile(away, [50, 90, 100]).round(3)} degrees")
    assert away.max() < 20
    assert np.percentile(away, 90) < 2


def constant(microtesla, count=500, lanes=LANES, seed=11):
    """A level disturbance that is there all the time."""
    way = np.random.default_rng(seed).uniform(-np.pi, np.pi, lanes)
    level = microtesla * np.stack([np.cos(way), np.sin(way), 0 * way])
    return np.broadcast_to(level, (count, 3, lanes))


def test_nobody_can_take_a_constant_disturbance_away():
    """All turn the disturbed field to north, as TRIAD does, so that nothing of it is left across; and none
    tilts, but for a fixed reference."""
    p, m = settings(), made(11, count=500, disturbance=constant(20.0))
    triad = aligned(p, "triad", m.stand, m.earth)
    assert np.median(np.abs(split(triad.attitude, m.truth)[1])) > 10
    for method in attitude.METHODS[1:]:
        found = aligned(p, method, m.stand, m.earth)
        apart, tilt = np.abs(about_up(found.attitude, triad.attitude)), split(found.attitude, m.truth)[0]
        print(f"{method}: {apart.max():.4f} from TRIAD, tilt {tilt.max():.3f} degrees")
        assert apart.max() < 0.1
        assert tilt.max() < 0.3
        across = jnp.cos(m.earth.north) * found.disturbance[1] - jnp.sin(m.earth.north) * found.disturbance[0]
        np.testing.assert_allclose(across, 0.0, atol=1e-9 if method in CLOSED else 0.3, err_msg=method)
    tilted = aligned(settings(reference="fixed"), "gauss_newton", m.stand, m.earth)
    assert np.median(split(tilted.attitude, m.truth)[0]) > 1.5


def test_the_heading_s_variance_is_that_of_single_headings():
    """Of noise alone; the mean of n samples is surer by n than what is said."""
    lanes, sigma_force, sigma_field = 4, 0.05, 0.3
    m = made(13, count=4000, lanes=lanes, noise=(sigma_force, 0.0, sigma_field))
    found = aligned(settings(), "triad", m.stand, m.earth)
    for k in range(lanes):
        stand, earth = one(m, k)
        singles = np.array([naive.triad(*x, earth) for x in zip(stand.force, stand.field, strict=True)])
        away = np.array([naive.vector(C @ m.truth[k].T)[2] for C in singles])
        level = np.cos(earth.inclination) * earth.strength
        known = (np.tan(earth.inclination) * sigma_force / 9.81) ** 2 + (sigma_field / level) ** 2
        assert away.var() == pytest.approx(known, rel=0.1)
        assert found.heading[k] == pytest.approx(away.var(), rel=0.1)
        assert found.spread[1, k] ** 2 == pytest.approx(away[-100:].var(), rel=0.2)


def test_an_odd_field_makes_the_heading_unsure():
    """By as much as half of what is odd; and a heading turned by a random field is within it."""
    earth = naive.Earth(48.0, 1.1, 1.4)
    lanes = Earth(*(jnp.full(5, x) for x in earth))
    stretch = jnp.asarray([1.0, 1.02, 1.05, 1.1, 1.3])
    found = attitude.heading_variance(lanes.field() * stretch, lanes, jnp.full(5, 1e-6), jnp.full(5, 0.01))
    assert (np.diff(found) > 0).all()
    for k, s in enumerate(stretch):
        expected = naive.heading_variance(earth.field() * float(s), earth, 1e-6, 0.01)
        assert found[k] == pytest.approx(expected, rel=1e-6)
    rng = np.random.default_rng(14)
    field = earth.field()[:, None] + 2.0 * rng.normal(size=(3, 20000))
    many = Earth(*(jnp.full(20000, x) for x in earth))
    said = attitude.heading_variance(jnp.asarray(field), many, jnp.zeros(20000), jnp.zeros(20000))
    away = np.angle(np.exp(1j * (np.arctan2(field[1], field[0]) - earth.north)))
    assert np.mean(said) == pytest.approx(np.mean(away**2), rel=0.1)


def test_what_is_left_over_is_blind_to_the_attitude():
    """0 at the sample that the disturbance comes from, for any attitude, and in the same field later."""
    rng = np.random.default_rng(15)
    m = made(15, count=2, disturbance=8 * rng.normal(size=(1, 3, LANES)) + np.zeros((2, 3, LANES)))
    field = m.stand.field[0]
    C = np.stack([dense.rotation(x) for x in turns(rng, LANES)])  # wrong, all of them
    disturbance = jnp.einsum("kij,jk->ik", C, field) - m.earth.field()
    lanes = jnp.asarray(np.moveaxis(C, 0, -1))
    np.testing.assert_allclose(attitude.left_over(field, lanes, disturbance, m.earth), 0.0, atol=1e-9)
    turned = np.stack([dense.rotation(x) for x in turns(rng, LANES)])  # how the foot has turned since
    later = jnp.einsum("kji,jk->ik", turned, field)
    after = jnp.asarray(np.einsum("kij,kjl->ilk", C, turned))
    np.testing.assert_allclose(attitude.left_over(later, after, disturbance, m.earth), 0.0, atol=1e-9)
    other = later + jnp.asarray(3 * rng.normal(size=(3, LANES)))
    found = attitude.left_over(other, after, disturbance, m.earth)
    assert np.abs(found).min() > 1e-3
    for k in range(LANES):
        _, earth = one(m, k)
        expected = naive.left_over(*(np.asarray(x[..., k]) for x in (other, after, disturbance)), earth)
        assert found[k] == pytest.approx(expected, abs=1e-9)


def test_a_field_that_is_only_turned_about_up_is_not_odd():
    rng = np.random.default_rng(16)
    m = made(16, count=1)
    level = np.stack([naive.turn(a) for a in rng.uniform(-3, 3, LANES)], axis=-1)
    up = jnp.asarray(m.truth[:, 2].T)
    turned = jnp.einsum("ijk,jk->ik", level, m.earth.field())
    seen = jnp.einsum("kji,jk->ik", m.truth, turned)
    np.testing.assert_allclose(attitude.oddity(9.81 * up, seen, m.earth), 0.0, atol=1e-9)
    odd = seen + jnp.asarray(4 * rng.normal(size=(3, LANES)))
    found = attitude.oddity(9.81 * up, odd, m.earth)
    for k in range(LANES):
        _, earth = one(m, k)
        expected = naive.oddity(np.asarray(up[:, k]), np.asarray(odd[:, k]), earth)
        assert found[k] == pytest.approx(expected, rel=1e-9)
    assert np.min(found) > 0.1


def test_when_it_has_converged_is_the_first_sample_that_stays():
    rng = np.random.default_rng(17)
    count = 60
    angles = np.exp(-np.linspace(0, 5, count))[:, None] * [2.0, 0.5, 0.01] * rng.choice([-1, 1], (count, 3))
    angles[40, 1] = 0.3  # once more
    angles[-1, 0] = 0.3  # never
    C = np.array([[dense.rotation(np.array([0.3 * a, 0.1 * a, a])) for a in row] for row in angles])
    time = np.cumsum(rng.uniform(0.005, 0.02, (count, 3)), axis=0)
    final = np.broadcast_to(np.eye(3)[..., None], (3, 3, 3))
    lanes = jnp.asarray(np.moveaxis(C, 1, -1))
    found = attitude.converged(lanes, jnp.asarray(time), jnp.asarray(final), 0.1)
    expected = [naive.converged(C[:, k], time[:, k], np.eye(3), 0.1) for k in range(3)]
    np.testing.assert_array_equal(found, expected)
    assert found[0] == np.inf
    assert found[1] == time[41, 1]
    assert found[2] == time[0, 2]


SLOPES = {
    "weighted": ("strength_spread", "dip_spread"),
    "gda": ("gain", "decay", "softness"),
    "agda": ("gain", "decay", "softness"),
    "gauss_newton": ("field_weight",),
}


@pytest.mark.parametrize("method", SLOPES)
def test_slopes_of_the_heading_equal_differences(method):
    """By the numbers of a method. A fixed reference, where Gauss-Newton's weight has a say."""
    rng = np.random.default_rng(18)
    passing = 4 * rng.normal(size=(1, 3, 1)) * (np.arange(60) > 30)[:, None, None]
    m = made(18, count=60, lanes=1, noise=NOISE, disturbance=passing)
    p = settings(reference="fixed")

    @jax.jit
    @jax.value_and_grad
    def heading(values):
        q = parameters.with_leaves(p, values)
        C = attitude.aligned(q, method, m.stand, m.earth).attitude[..., 0]
        return jnp.arctan2(C[1, 0], C[0, 0])

    values = {name: getattr(p, name) for name in SLOPES[method]}
    found = heading(values)[1]
    for name, x in values.items():
        h = 1e-6 * x
        up, down = (heading({**values, name: x + s})[0] for s in (h, -h))
        print(name, float(found[name]))
        assert found[name] == pytest.approx(float((up - down) / (2 * h)), rel=1e-5, abs=1e-12), name
        assert found[name] != 0


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "method", ["weighted", pytest.param("gauss_newton", marks=SLOW), pytest.param("agda", marks=SLOW)]
)
def test_slopes_are_finite_without_force_or_field_and_at_the_pole(method):
    dtype, m = jnp.float32, made(19, count=20, lanes=4)
    force = m.stand.force.at[..., 0].set(0.0)
    field = m.stand.field.at[..., 1].set(0.0).at[..., 2].set(4 * force[..., 2])
    stand = m.stand._replace(force=force, field=field, dt=m.stand.dt.at[:, 3].set(0.0))
    stand, earth = jax.tree.map(lambda x: x.astype(dtype), (stand, m.earth))
    p = parameters.cast(Align(), dtype)

    @jax.jit
    @partial(jax.grad, has_aux=True)
    def slopes(given):
        found = attitude.aligned(given[0], method, *given[1:])
        return sum(jnp.sum(x) for x in found), found

    for x in jax.tree.leaves(slopes((p, stand, earth))):
        assert x.dtype == dtype
        assert np.isfinite(x).all()
