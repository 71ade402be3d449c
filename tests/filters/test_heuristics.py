"""Heading heuristics against naive loops, and what they find in walks with a known error."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.filters import heuristics, kalman
from pedjax.filters.covariance import STATES
from pedjax.filters.heuristics import FORMS, Axis, Directions, Heuristic, Run, Walked
from tests.reference import filter as dense
from tests.reference import heading as naive

LANES, COUNT = 24, 5
CASES = [
    {"form": "hdr"},
    {"form": "hdr", "hdr.on_curve": "zero"},
    {"form": "slope", "slope.least": 5.5},
    {"form": "integrator", "integrator.softness": 0.3},
    {"form": "hde", "hde.softness": 0.3},
    {"form": "ihde", "ihde.tolerance": 0.4},
    {"form": "mihde", "mihde.tolerance": 0.4},
    *({"form": "von_mises", "directions.count": n} for n in (2, 4, 8)),
]


def name_of(case):
    return " ".join(str(v) for v in case.values())


def chosen(case):
    return parameters.cast(parameters.replace(Heuristic(), case), float)


def blocks(P):
    """A dense covariance `(15, 15, L)` in blocks."""
    return {
        a + b: jnp.asarray(P[3 * i : 3 * i + 3, 3 * j : 3 * j + 3])
        for i, a in enumerate(STATES)
        for j, b in enumerate(STATES)
        if i <= j
    }


def run_of(runs):
    """Sums over straight runs, one for each lane."""
    sums = []
    for run in runs:
        t, y = run["times"] - run["times"][0], run["yaws"] - run["yaws"][0]
        parts = (run["yaws"][0], run["times"][0], len(t), t.sum(), (t * t).sum(), y.sum(), (t * y).sum())
        sums.append((*parts, run["ups"].sum(axis=0)))
    *scalars, up = zip(*sums, strict=True)
    return Run(*(jnp.asarray(x, float) for x in scalars), jnp.asarray(np.stack(up, axis=1)))


def unit(rng, *shape):
    x = rng.normal(size=(3, *shape))
    return x / np.linalg.norm(x, axis=0)


@pytest.fixture(scope="module")
def strides():
    """Random ends of strides: side by side in lanes, and one by one for the loops."""
    rng = np.random.default_rng(21)
    headings = rng.uniform(-np.pi, np.pi, LANES) + rng.normal(0, 0.2, (COUNT, LANES))
    factor = rng.normal(0, 0.15, (15, 20, LANES))
    P = np.einsum("ikl,jkl->ijl", factor, factor)
    given = {
        "seconds": rng.uniform(0.9, 1.3, LANES),
        "straight": rng.uniform(0, 1, LANES),
        "bent": rng.uniform(0, 4, LANES),
        "away": rng.normal(0, 0.2, LANES),
        "known": rng.integers(0, 2, LANES).astype(float),
        "over": rng.integers(0, 4, LANES).clip(0, 1).astype(float),
        "compass": rng.normal(0, 0.3, LANES),
    }
    up = unit(rng, LANES)
    runs = []
    for k in range(LANES):
        n = int(rng.integers(4, 15))
        times = 20.0 + np.cumsum(rng.uniform(0.9, 1.3, n))
        yaws = 1.0 + rng.normal(0, 0.03) * times + rng.normal(0, 0.02, n)
        ups = up[:, k] + rng.normal(0, 0.05, (n, 3))
        runs.append({"times": times, "yaws": yaws, "ups": ups})
    together = Walked(
        tuple(jnp.asarray(x) for x in headings),
        run=run_of(runs),
        up=jnp.asarray(up),
        P=blocks(P),
        **{name: jnp.asarray(x) for name, x in given.items()},
    )
    alone = [
        {name: x[k] for name, x in given.items()}
        | {"headings": list(headings[:, k]), "up": up[:, k], "run": runs[k], "P": P[..., k]}
        for k in range(LANES)
    ]
    return together, alone


@jax.jit
def told(p, seen):
    return FORMS[p.form](p, seen)


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_every_form_equals_the_loops(strides, case):
    p, (together, alone) = chosen(case), strides
    ours = told(p, together)
    theirs = [naive.FORMS[p.form](p, one) for one in alone]
    weight = np.broadcast_to(ours.weight, (LANES,))
    np.testing.assert_allclose(weight, [x.weight for x in theirs], rtol=1e-9, atol=1e-15)
    assert (weight > 0).any()
    if theirs[0].bias is not None:
        assert ours.rows is None
        np.testing.assert_allclose(ours.bias.T, [x.bias for x in theirs], rtol=1e-9, atol=1e-18)
        assert (ours.yaw is None) == (theirs[0].yaw is None)
        if ours.yaw is not None:
            np.testing.assert_allclose(ours.yaw, [x.yaw for x in theirs], rtol=1e-9, atol=1e-15)
        return
    assert ours.bias is None
    assert set(ours.rows.H) == {theirs[0].state}
    H = np.broadcast_to(ours.rows.H[theirs[0].state], (1, 3, LANES))
    np.testing.assert_allclose(H[0].T, [x.H for x in theirs], atol=1e-12)
    np.testing.assert_allclose(ours.rows.innovation[0], [x.innovation for x in theirs], atol=1e-9)
    np.testing.assert_allclose(ours.rows.noise[0, 0], [x.variance for x in theirs], rtol=1e-6)


@jax.jit
@jax.value_and_grad
def value(both, mix):
    """A mix of all numbers that a form gives."""
    found = jax.tree.leaves(FORMS[both[0].form](*both))
    return sum(jnp.sum(jnp.cos(mix + k) * x) for k, x in enumerate(found))


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_slopes_equal_differences(strides, case):
    """By every parameter and all that is known of the stride at once, along random ways."""
    both, rng, h = (chosen(case), strides[0]), np.random.default_rng(3), 1e-6
    _, slopes = value(both, 0.3)
    for _ in range(3):
        way = jax.tree.map(lambda x: (0.01 + np.abs(x)) * rng.normal(size=np.shape(x)), both)
        up, down = (jax.tree.map(lambda x, d, s=s: x + s * d, both, way) for s in (h, -h))
        difference = (value(up, 0.3)[0] - value(down, 0.3)[0]) / (2 * h)
        along = sum(np.sum(x * d) for x, d in zip(*map(jax.tree.leaves, (slopes, way)), strict=True))
        assert along == pytest.approx(float(difference), rel=1e-5, abs=1e-8)
        assert along != 0.0


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_slopes_are_finite_everywhere(case, dtype):
    """Of what is known before the first stride, with opposite headings, and far off."""
    rows = [[0.0] * COUNT, [np.pi, -np.pi] * 2 + [0.0], [0.0, np.pi, 0.0, np.pi, 0.5], [1e3] * COUNT]
    headings = tuple(jnp.asarray(x, dtype) for x in np.transpose(rows))
    for size, unsure in ((0.0, 1e-8), (1.0, 1.0), (3.2, 1e4)):
        like = jnp.full(len(rows), size, dtype)
        vector = jnp.full((3, len(rows)), size, dtype)
        P = blocks(np.tile(unsure * np.eye(15)[..., None], len(rows)).astype(dtype))
        seen = Walked(headings, *(like,) * 5, Run(*(like,) * 7, vector), like, vector, like, P)
        both = parameters.cast(chosen(case), dtype), seen
        found, slopes = value(both, dtype(0.3))
        assert np.isfinite(found)
        for x in jax.tree.leaves(slopes):
            assert np.isfinite(x).all()


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.5, -0.4), (2.5, 1.0)])
def test_the_slope_of_a_straight_run_finds_the_bias(tilt):
    """A body whose gyroscope is off by g: its yaw drifts by c . g, and the row takes that off."""
    rng = np.random.default_rng(2)
    g, dt, every = np.array([2e-4, -3e-4, 5e-4]), 0.05, 20
    truth = estimate = dense.euler_attitude(*tilt, 3.0)  # along x, about; drifts past half a turn
    times, yaws, ups = [], [], []
    for k in range(20 * every):
        w = 0.02 * rng.normal(size=3) if k % every < 10 else 0.0 * g  # it moves, then stands
        truth = truth @ dense.rotation(dt * w)
        estimate = estimate @ dense.rotation(dt * (w + g))
        if k % every == every - 1:
            turn = estimate @ truth.T  # of the filter's heading against the path's
            times.append(k * dt)
            yaws.append(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
            ups.append(estimate[2])
    run = {"times": np.array(times), "yaws": np.array(yaws), "ups": np.array(ups)}
    p = chosen({"form": "slope", "slope.sigma": 0.001})
    like, zero = jnp.zeros(1), jnp.zeros((3, 1))
    P = np.diag(np.repeat([1e-4, 0.01**2, 1.0, 1e-2, 1e-2], 3))[..., None]
    seen = Walked((like,) * 5, like, like, like, like, like, run_of([run]), like + 1, zero, None, blocks(P))
    found = told(p, seen)
    assert found.weight[0] == 1.0
    drift = float(np.mean(ups, axis=0) @ g)
    assert found.rows.innovation[0, 0] == pytest.approx(drift, rel=0.02)
    np.testing.assert_allclose(found.rows.H["g"][0, :, 0], np.mean(ups, axis=0))
    _, correction = kalman.update(seen.P, found.rows, found.weight)
    assert np.mean(ups, axis=0) @ correction["g"][:, 0] == pytest.approx(drift, rel=0.02)


def test_a_slope_that_is_too_steep_or_too_short_is_left_out():
    p = chosen({"form": "slope"})
    times = 1.1 * np.arange(30)
    ups = np.tile([0.0, 0.0, 1.0], (30, 1))
    P = blocks(np.diag(np.repeat([1e-4, 0.002**2, 1.0, 1e-2, 1e-2], 3))[..., None] * np.ones(4))
    kept, steep = 0.004, 0.05
    runs = [
        {"times": times[:n], "yaws": rate * times[:n], "ups": ups[:n]}
        for n, rate in ((30, kept), (30, steep), (11, kept), (12, kept))
    ]
    like, zero = jnp.zeros(4), jnp.zeros((3, 4))
    seen = Walked((like,) * 5, like, like, like, like, like, run_of(runs), like + 1, zero, None, P)
    np.testing.assert_array_equal(told(p, seen).weight, [1, 0, 0, 1])
    np.testing.assert_array_equal(told(p, seen._replace(over=like)).weight, 0)


NONE = Axis(*(jnp.zeros(()),) * 3)


@pytest.mark.parametrize("count", [2, 4, 8])
def test_the_nearest_direction(count):
    headings = np.linspace(-3.13, 3.14, 101)
    for axis in (0.0, 0.3, -2.9):
        p = parameters.replace(Directions(), {"known": "given", "count": count, "axis": axis})
        found, known = heuristics.away_from(p, NONE, jnp.asarray(headings))
        np.testing.assert_allclose(found, [naive.away(x, axis, count) for x in headings], atol=1e-12)
        np.testing.assert_array_equal(known, 1)
        assert np.abs(found).max() <= np.pi / count + 1e-12


@jax.jit
def learn(p, headings, straight, of_yaw):
    def one(axis, stride):
        axis = heuristics.learnt(p, axis, *stride)
        return axis, (axis, heuristics.away_from(p, axis, stride[0]))

    return jax.lax.scan(one, Axis(*(jnp.zeros(()),) * 3), (headings, straight, of_yaw))[1]


@pytest.mark.parametrize("count", [2, 4, 8])
@pytest.mark.parametrize("memory", [1.0, 6.0, 9.0, 30.0])
def test_learning_equals_the_loops(count, memory):
    rng = np.random.default_rng(count)
    headings = np.pi + 2 * np.pi / count * rng.integers(0, count, 60) + rng.normal(0, 0.1, 60)
    headings = np.arctan2(np.sin(headings), np.cos(headings))
    straight = rng.choice([0.0, 0.6, 1.0], 60)
    of_yaw = rng.uniform(0, 0.004, 60)
    p = parameters.cast(parameters.replace(Directions(), {"count": count, "memory": memory}), float)
    axis, (away, known) = jax.tree.map(np.asarray, learn(p, *map(jnp.asarray, (headings, straight, of_yaw))))
    p = jax.tree.map(float, p)
    loop = naive.Directions(p)
    for k in range(60):
        loop.see(headings[k], straight[k], of_yaw[k])
        assert axis.many[k] == pytest.approx(loop.many, abs=1e-12)
        assert known[k] == loop.known()
        if loop.known():
            assert away[k] == pytest.approx(naive.away(headings[k], loop.axis(), count), abs=1e-9)
    assert known[-1] == 1


@pytest.mark.parametrize("count", [2, 4, 8])
@pytest.mark.parametrize("about", [np.pi, np.pi / 2, np.pi / 4, np.pi / 8])
def test_directions_learnt_at_the_cut_of_an_angle(count, about):
    """Strides on either side of half a turn, of their own or of its `count`-th part."""
    headings = about + 0.05 * np.array([1, -1, 1, -1, 1, -1, 0.0, 2.0])
    headings = np.arctan2(np.sin(headings), np.cos(headings))
    p = parameters.cast(parameters.replace(Directions(), {"count": count}), float)
    _, (away, known) = learn(p, jnp.asarray(headings), jnp.ones(8), jnp.zeros(8))
    np.testing.assert_array_equal(known, [0] * 5 + [1] * 3)
    np.testing.assert_allclose(away[5:], [-0.05, 0.0, 0.1], atol=1e-9)


def test_directions_stay_as_first_learnt_or_follow():
    first, later = np.full(6, 0.1), np.full(60, 0.3)
    headings = jnp.asarray(np.concatenate([first, later]))
    for memory, left in ((6.0, 0.2), (12.0, 0.0)):
        p = parameters.cast(parameters.replace(Directions(), {"memory": memory}), float)
        _, (away, _) = learn(p, headings, jnp.ones(66), jnp.zeros(66))
        assert away[6] == pytest.approx(0.2 if memory == 6 else 0.17, abs=0.01)
        assert away[-1] == pytest.approx(left, abs=0.01)


def directed(form, away, **own):
    """The weight of a straight stride so far off a known direction."""
    p = chosen({"form": form, **own})
    like = jnp.zeros_like(jnp.asarray(away))
    P = blocks(np.diag(np.repeat([0.05**2, 1e-4, 1.0, 1e-2, 1e-2], 3))[..., None] * np.ones(len(away)))
    vector = jnp.zeros((3, len(away)))
    known = Walked(
        (like,) * COUNT, like + 1, like + 1, like, jnp.asarray(away), like + 1, Run(*(like,) * 7, vector),
        like, vector, like, P,
    )  # fmt: skip
    return p, told(p, known)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_the_soft_weight_in_its_limits(share):
    """Along a direction, and between two."""
    own = {"von_mises.share": share, "directions.error": 1e-6}
    p, found = directed("von_mises", [0.0, np.radians(45), 0.02], **own)
    spread = p.von_mises.sigma**2 + 0.05**2
    odds = share / (1 - share) * (np.pi / 2) / np.sqrt(2 * np.pi * spread)
    assert found.weight[0] == pytest.approx(odds / (1 + odds), rel=1e-6)
    assert found.weight[1] < 1e-10
    assert found.weight[2] < found.weight[0]
    np.testing.assert_allclose(found.rows.innovation[0], [0.0, -np.radians(45), -0.02])


def test_hde_swings_about_a_direction_unless_it_turns_the_yaw():
    """A yaw that drifts by a bias, an end of a stride each second: the bias moves it back, and on."""
    vector = jnp.zeros((3, 1))
    up, P = vector.at[2].set(1.0), blocks(np.eye(15)[..., None])

    @jax.jit
    def walked(p):
        def stride(state, _):
            off, bias = state  # of the yaw, and what is left of the bias
            like = jnp.ones(1)
            seen = Walked((like,) * COUNT, like, like, 0 * like, off, like, Run(*(like,) * 7, vector), like,
                          up, None, P)  # fmt: skip
            found = FORMS["hde"](p, seen)
            off, bias = off + found.weight * found.yaw, bias - found.weight * found.bias[2]
            return (off + bias, bias), off

        return jax.lax.scan(stride, (jnp.zeros(1), jnp.full(1, 1e-4)), None, length=400)[1][:, 0]

    swings, calm = (walked(chosen({"form": "hde", "hde.turn": turn})) for turn in (0.0, 0.1))
    assert np.abs(swings[-100:]).max() > 0.9 * np.abs(swings).max()
    assert np.abs(calm).max() < 0.5 * np.abs(swings).max()
    assert np.abs(calm[-100:]).max() < 0.2 * np.abs(calm).max()


@pytest.mark.parametrize("form", ["ihde", "von_mises"])
def test_rows_leave_the_yaw_no_surer_than_the_directions_are(form):
    """Many strides exactly along: the variance tends to that of the directions, and never below."""
    p, found = directed(form, [0.0], **{"directions.error": 0.02})
    P = np.diag(np.repeat([0.05**2, 1e-4, 1.0, 1e-2, 1e-2], 3))[..., None]
    one = jax.jit(lambda p, seen: kalman.update(seen.P, FORMS[p.form](p, seen).rows, told(p, seen).weight)[0])
    like, vector = jnp.zeros(1), jnp.zeros((3, 1))
    P, before = blocks(P), []
    for _ in range(300):
        seen = Walked((like,) * COUNT, like, like + 1, like, like, like + 1, Run(*(like,) * 7, vector),
                      like, vector, like, P)  # fmt: skip
        P = one(p, seen)
        before.append(float(P["tt"][2, 2, 0]))
    assert before[-1] >= 0.02**2
    assert before[-1] < 1.2 * 0.02**2
    assert found.weight[0] > 0
