"""The walker's motion: signals are the exact derivatives of the path, and stand still where they say so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.errors import InputError
from pedjax.simulation.footsteps import GAITS, Leg, _path, footsteps
from pedjax.simulation.motion import GRAVITY, MOUNTINGS, at, motion, standing

MIXED = (
    Leg(points=((0.0, 0.0), (8.0, 0.0), (8.0, 3.0))),
    Leg(kind="turn", angle=90.0),
    Leg(kind="stairs", steps=4),
    Leg(kind="side", distance=0.9),
    Leg(kind="elevator", climb=3.0, seconds=5.0),
    Leg(circle=1.5),
)


@pytest.fixture(scope="module")
def plan():
    return footsteps(MIXED, seed=3)


def skew(x):
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def integrated(made, step):
    """Classical Runge-Kutta over steps of two samples: position, velocity and attitude at the end."""
    force, rate, g = made.specific_force, made.angular_rate, np.array([0, 0, GRAVITY])
    c, v, p = made.attitude[0], made.velocity[0], made.position[0]
    for k in range(0, len(force) - 2, 2):
        slopes, state = [], (c, v)
        for i, part in ((k, 0.5), (k + 1, 0.5), (k + 1, 1.0), (k + 2, 0.0)):
            slopes.append((state[0] @ skew(rate[i]), state[0] @ force[i] - g, state[1]))
            state = (c + part * step * slopes[-1][0], v + part * step * slopes[-1][1])
        weighted = [sum(w * s[n] for w, s in zip((1, 2, 2, 1), slopes, strict=True)) / 6 for n in range(3)]
        c, v, p = c + step * weighted[0], v + step * weighted[1], p + step * weighted[2]
        left, _, right = np.linalg.svd(c)
        c = left @ right
    return c, v, p


@pytest.mark.slow
@pytest.mark.parametrize("mounting", sorted(MOUNTINGS))
def test_integrating_the_signals_returns_the_path(plan, mounting):
    """Under a millimetre and a hundredth of a degree per minute; at 1200 Hz Runge-Kutta itself is 0.8 mm off
    for a foot, at 2400 and 4800 Hz 3 micrometres."""
    rate = 2400.0
    time = np.arange(0.0, plan.seconds, 1 / rate)
    made = motion(plan.walker, time, mounting)
    c, _, p = integrated(made, 2 / rate)
    last = (len(time) - 1) // 2 * 2
    minutes = plan.seconds / 60
    assert np.linalg.norm(p - made.position[last]) < 1e-3 * minutes
    cosine = (np.trace(c.T @ made.attitude[last]) - 1) / 2
    assert np.degrees(np.arccos(min(cosine, 1.0))) < 0.01 * minutes


def test_velocity_is_the_slope_of_the_path(plan):
    time = np.linspace(5.0, 15.0, 301)
    made, ahead, behind = (motion(plan.walker, time + d) for d in (0.0, 1e-5, -1e-5))
    np.testing.assert_allclose((ahead.position - behind.position) / 2e-5, made.velocity, atol=1e-6)


def test_attitudes_are_rotations(plan):
    for mounting in MOUNTINGS:
        c = motion(plan.walker, np.linspace(0.0, plan.seconds, 400), mounting).attitude
        np.testing.assert_allclose(
            np.einsum("tij,tkj->tik", c, c), np.broadcast_to(np.eye(3), c.shape), atol=1e-12
        )


def test_nothing_jumps(plan):
    """Specific force is continuous: ten times as many samples, ten times smaller steps."""
    steps = []
    for rate in (2000.0, 20000.0):
        time = np.arange(6.0, 10.0, 1 / rate)
        steps.append(np.abs(np.diff(motion(plan.walker, time).specific_force, axis=0)).max())
    assert steps[1] < 0.12 * steps[0]


def test_a_standing_foot_hardly_moves(plan):
    time = np.arange(0.0, plan.seconds, 0.005)
    made, still = motion(plan.walker, time), standing(plan.walker, time)
    carried = np.abs(made.velocity[:, 2]) > 0.1  # in the elevator
    speed = np.linalg.norm(made.velocity, axis=1)
    assert speed[still & ~carried].max() < 0.1
    assert speed[~still].max() > 3.0
    assert 0.2 < still[(time > 5) & (time < 15)].mean() < 0.45


def test_the_elevator_carries_everything(plan):
    time = np.array([0.5, plan.seconds - 0.5])
    for mounting in MOUNTINGS:
        height = motion(plan.walker, time, mounting).position[:, 2]
        assert height[1] - height[0] == pytest.approx(3.0 + 4 * 0.16, abs=0.02)


def test_the_thigh_swings_by_about_22_degrees():
    walk = footsteps((Leg(points=((0.0, 0.0), (20.0, 0.0))),), seed=0)
    time = np.arange(6.0, 12.0, 0.01)
    c = motion(walk.walker, time, "pocket").attitude
    pitch = np.degrees(-np.arcsin(c[:, 2, 0]))
    assert 17 < 0.5 * (pitch.max() - pitch.min()) < 28


def test_the_waist_walks_evenly():
    walk = footsteps((Leg(points=((0.0, 0.0), (20.0, 0.0))),), seed=0)
    made = motion(walk.walker, np.arange(6.0, 12.0, 0.01), "waist")
    assert made.velocity[:, 0].mean() == pytest.approx(GAITS["walk"].speed, rel=0.05)
    assert made.velocity[:, 0].std() < 0.25
    assert 0.01 < np.ptp(made.position[:, 2]) < 0.08


def test_walks_repeat_by_seed():
    legs = (Leg(points=((0.0, 0.0), (5.0, 0.0))),)
    one, again, other = (footsteps(legs, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.walker.left.end, again.walker.left.end)
    assert not np.array_equal(one.walker.left.end, other.walker.left.end)


@pytest.mark.parametrize("gait", sorted(GAITS))
def test_every_gait_walks(gait):
    walk = footsteps((Leg(points=((0.0, 0.0), (12.0, 0.0)), gait=gait),), seed=4)
    time = np.arange(2.0, walk.seconds - 2.0, 0.005)
    made = motion(walk.walker, time)
    assert np.isfinite(made.specific_force).all()
    assert np.linalg.norm(made.angular_rate, axis=1).max() < 25
    assert walk.route[-1, 0] == pytest.approx(12.0, abs=0.02)


def test_arcs_that_touch_turn_smoothly():
    """Corners that need all of each side, as far as rounding lets them."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        radius, turns = rng.uniform(0.5, 6.0), np.radians(rng.uniform(20, 120, 12)) * np.resize([1, -1], 12)
        backs = np.concatenate([[1.0], radius * np.tan(abs(turns) / 2), [1.0]])
        heading = np.concatenate([[0.3], 0.3 + np.cumsum(turns)])
        sides = (backs[:-1] + backs[1:])[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        points = np.concatenate([np.zeros((1, 2)), np.cumsum(sides, axis=0)])
        path = _path(Leg(points=tuple(map(tuple, points)), radius=radius), np.zeros(2), "arcs")
        assert abs(np.diff(path[:, 2])).max() < 0.0101 / radius + 0.006 / radius
        assert path[-1, 2] - path[0, 2] == pytest.approx(turns.sum(), abs=1e-6)


@pytest.mark.parametrize(
    ("leg", "message"),
    [
        (Leg(points=((0.0, 0.0), (5.0, 0.0)), speed=-1.0), "speed = -1 m/s must lie between"),
        (Leg(points=((0.0, 0.0),)), "points must be two or more"),
        (Leg(points=((0.0, 0.0), (0.0, 0.0))), "are the same"),
        (Leg(points=((0.0, 0.0), (5.0, 0.0), (0.0, 0.1))), "turns back by 179 degrees"),
        (Leg(points=((0.0, 0.0), (5.0, 0.0), (5.0, 5.0)), radius=0.2), "more than a foot can"),
        (Leg(points=((0.0, 0.0), (5.0, 0.0), (5.0, 1.0)), radius=2.0), "need 2.00 m for a radius of 2 m"),
        (Leg(kind="crawl"), "kind 'crawl' is unknown"),
        (Leg(points=((0.0, 0.0), (5.0, 0.0)), gait="wlak"), "did you mean 'walk'"),
        (Leg(kind="elevator", climb=50.0, seconds=2.0), "too fast"),
        (Leg(kind="stairs", steps=3, rise=0.5), "rise of at most"),
        (Leg(kind="stand"), "seconds = 0 must be positive"),
    ],
)
def test_what_a_foot_cannot_do_is_refused(leg, message):
    with pytest.raises(InputError, match=message):
        footsteps((leg,), seed=0)


def test_walkers_side_by_side_are_walkers_one_by_one():
    """A batch of walkers is a `vmap` over the arrays that they are made of."""
    plans = [footsteps([Leg(points=((0.0, 0.0), (6.0, 0.0)))], seed) for seed in range(3)]
    walkers = jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *(p.walker for p in plans))
    time = jnp.linspace(1.0, 6.0, 40)
    lever, gravity = jnp.asarray(MOUNTINGS["foot"]), jnp.asarray(9.81)

    def walked(walker):
        return jax.vmap(lambda t: at(t, walker, "foot", lever, gravity))(time)

    together = jax.jit(jax.vmap(walked))(walkers)
    assert not np.allclose(together.position[0], together.position[1])
    for k, plan in enumerate(plans):
        alone = motion(plan.walker, np.asarray(time), "foot", 9.81)
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_allclose(a[k], b, atol=1e-9)
