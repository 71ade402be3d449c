"""The naive filters of a sensor in a pocket: slopes by differences, batch least squares, a made walk."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from tests.reference import pocket
from tests.reference.alignment import angle, vector
from tests.reference.filter import rotation, skew
from tests.reference.pocket import UP, Magnetic, PocketSettings, PocketStart, Settings, Start, Walk

EARTH = np.array([3.0, 20.5, -43.3])  # 48 uT
BIAS = np.deg2rad([-0.1, 0.1, -0.1])
RATE_HZ = 20.0
HARD_IRON = np.array([2.0, -1.5, 1.0])


def slope(function, size, step=1e-5):
    """Central differences at zero."""
    columns = []
    for i in range(size):
        x = step * np.eye(size)[i]
        columns.append((function(x) - function(-x)) / (2 * step))
    return np.column_stack(columns)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def some(rng):
    """An attitude, a rate, a bias and a field."""
    return pocket.matrix(np.array([0.4, -0.3, 2.0])), rng.normal(size=3), BIAS, rng.normal(size=3) * 30


# ---- geometry


def test_angles_and_matrix_are_inverse():
    e = np.array([0.4, -0.9, 2.8])
    np.testing.assert_allclose(pocket.angles(pocket.matrix(e)), e, atol=1e-14)
    np.testing.assert_allclose(pocket.tilt(9.81 * pocket.matrix(e).T @ UP), e[:2], atol=1e-14)


def test_slopes_of_angles_and_turns():
    e = np.array([0.4, -0.9, 2.8])
    found = slope(lambda x: vector(pocket.matrix(e + x) @ pocket.matrix(e).T), 3)
    np.testing.assert_allclose(pocket.turning(e), found, atol=1e-9)
    for u in (np.array([0.3, -0.8, 0.5]), np.array([2e-5, 0.0, -3e-5]), np.zeros(3)):
        found = slope(lambda x, u=u: vector(rotation(u).T @ rotation(u + x)), 3)
        np.testing.assert_allclose(pocket.right_jacobian(u), found, atol=1e-9)
    f = np.array([3.0, -4.0, 7.0])
    np.testing.assert_allclose(pocket.tilt_slope(f), slope(lambda x: pocket.tilt(f + x), 2 + 1), atol=1e-9)


# ---- slopes of steps and rows


def test_euler_step_has_its_slopes(some):
    C, rate, b, _ = some
    dt, e = 0.1, pocket.angles(C)
    s = Settings(gyroscope=0.3, bias_time=5.0)

    def step(x):
        new, bias, *_ = pocket.predicted("euler", pocket.matrix(e + x[:3]), b + x[3:], rate, dt, s)
        return np.concatenate([pocket.angles(new), bias])

    new, _, F, Q = pocket.predicted("euler", C, b, rate, dt, s)
    np.testing.assert_allclose(F, slope(step, 6), atol=1e-9)
    J = slope(lambda u: pocket.angles(new @ rotation(u)), 3)
    np.testing.assert_allclose(Q[:3, :3], 0.3**2 * dt * J @ J.T, atol=1e-9)


def true_of(C, x):
    return rotation(x) @ C


def test_twin_step_has_its_slopes_but_for_the_square_of_a_step(some):
    C, rate, b, _ = some
    worst = []
    for dt in (0.02, 0.01):
        new, _, F, _ = pocket.predicted("twin", C, b, rate, dt, Settings())

        def step(x, dt=dt, new=new):
            there = pocket.predicted("twin", true_of(C, x[:3]), b + x[3:], rate, dt, Settings())
            return np.concatenate([vector(there[0] @ new.T), there[1] - b])

        worst.append(np.abs(F - slope(step, 6)).max() / dt)
    assert worst[0] < np.linalg.norm(rate) ** 2 * 0.02**2 / 10
    assert worst[0] / worst[1] == pytest.approx(4, rel=0.05)


def test_pocket_step_has_its_slopes_but_for_the_square_of_a_step(some):
    C, rate, b, _ = some
    f, v, s, dt = np.array([2.0, -1.0, 11.0]), np.array([0.3, 0.2, -0.1]), PocketSettings(bias_time=5.0), 0.01
    new, v_new, b_new, F, _ = pocket.pocket_predicted(C, v, b, f, rate, dt, s)

    def step(x):
        C_x, v_x, b_x, *_ = pocket.pocket_predicted(true_of(C, x[:3]), v + x[3:6], b + x[6:9], f, rate, dt, s)
        return np.concatenate([vector(C_x @ new.T), v_x - v_new, b_x - b_new])

    exact = slope(step, 9)
    np.testing.assert_allclose(F[:9, :9][:, :6], exact[:, :6], atol=1e-8)
    np.testing.assert_allclose(F[:3, 6:9], exact[:3, 6:], atol=1e-6)
    assert np.abs(exact[3:6, 6:]).max() < 10 * dt**2  # left out: the bias on speed, within the step
    assert F[3:6, 6:9].any() == 0
    np.testing.assert_allclose(F[9:, 9:], np.eye(6))


def test_gravity_rows_have_their_slopes(some):
    C, *_ = some
    f = 9.81 * C.T @ UP
    for chart, size in (("twin", 3), ("euler", 2)):
        rows = pocket.gravity_rows(chart, C, f, Settings())
        np.testing.assert_allclose(rows.z, 0, atol=1e-12)

        def seen(x, chart=chart):
            truth = true_of(C, x) if chart == "twin" else pocket.matrix(pocket.angles(C) + x)
            return pocket.gravity_rows(chart, C, 9.81 * truth.T @ UP, Settings()).z

        np.testing.assert_allclose(rows.H, slope(seen, 3), atol=1e-8)
        assert rows.H.shape == (size, 3)


def test_differential_rows_have_their_slopes(some):
    _, rate, b, m = some
    dt, n = 0.01, np.array([0.4, -0.7, 0.2])
    rows = pocket.differential_rows(m, m, rate, b, dt, np.array([0.3, 0.1]))

    def now(x):
        return rotation((rate - b - x) * dt).T @ m

    np.testing.assert_allclose(rows.H, slope(now, 3), atol=1e-7)
    noise = slope(lambda x: now(-x), 3) * 0.3 / np.sqrt(dt)  # rate less its noise
    R = noise @ noise.T + 2 * 0.1**2 / dt * np.eye(3)
    np.testing.assert_allclose(rows.R, R, atol=0.03 * R.max())  # where the field was, not where it is
    rows = pocket.averaged_rows(m, m, n, rate, b, dt, 0.3)

    def with_noise(x):
        return rotation((rate - b - x[:3]) * dt).T @ (m - n - x[3:6]) + x[6:]

    np.testing.assert_allclose(rows.H, slope(with_noise, 9), atol=1e-7)
    np.testing.assert_allclose(rows.z, m - with_noise(np.zeros(9)), atol=1e-12)


@pytest.mark.parametrize("chart", ["euler", "twin"])
def test_rows_of_a_known_field_have_their_slopes(some, chart):
    C, _, _, m = some
    rows = pocket.known_rows(C, m, EARTH, 0.1, 0.01)

    def seen(x):
        truth = true_of(C, x) if chart == "twin" else pocket.matrix(pocket.angles(C) + x)
        return truth.T @ EARTH

    np.testing.assert_allclose(pocket.onto(chart, C, rows.H), slope(seen, 3), atol=1e-7)


def test_pocket_rows_have_their_slopes(some):
    C, _, _, m = some
    rows = pocket.pocket_rows(C, HARD_IRON, EARTH, m, 0.1, 0.01)

    def seen(x):
        return true_of(C, x[:3]).T @ (EARTH + x[12:]) + HARD_IRON + x[9:12]

    np.testing.assert_allclose(rows.H, slope(seen, 15), atol=1e-7)
    np.testing.assert_allclose(rows.z, m - seen(np.zeros(15)))


# ---- the printed turn


def test_static_field_has_no_innovation_turned_the_right_way():
    dt, rate = 0.01, np.array([2.2, 0.3, 0.1])
    C, turn = np.eye(3), rotation(rate * dt)
    field = np.array([1.0, 20.0, -43.0])
    right, printed = [], []
    for _ in range(100):
        before, C = C.T @ field, C @ turn
        now = C.T @ field
        right.append(np.linalg.norm(now - pocket.carried(before, rate, np.zeros(3), dt)[0]))
        printed.append(np.linalg.norm(now - pocket.printed_carried(before, rate, np.zeros(3), dt)))
    assert max(right) < 1e-12
    assert np.median(printed) == pytest.approx(2.1, abs=0.1)  # twice the turn of a sample


# ---- updates


def test_weight_divides_the_noise(rng):
    A, H = rng.normal(size=(5, 5)), rng.normal(size=(2, 5))
    P, R, z, w = A @ A.T, np.diag([2.0, 3.0]), rng.normal(size=2), 0.3
    x, new = pocket.update(P, pocket.Rows(z, H, R), w)
    information = np.linalg.inv(P) + w * H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(new, np.linalg.inv(information), atol=1e-12)
    np.testing.assert_allclose(x, w * new @ H.T @ np.linalg.inv(R) @ z, atol=1e-12)


def test_gates():
    assert pocket.opened(0.29, 0.3, 0.0) == 1
    assert pocket.opened(0.3, 0.3, 0.0) == 0
    assert pocket.opened(0.3, 0.3, 0.2) == 0.5
    assert pocket.opened(0.6, 0.3, 0.5) == pytest.approx(0.2)
    assert pocket.opened(0.0, 0.3, 0.2) == 1
    assert pocket.opened(np.nan, 0.3, 0.2) == 0
    field = np.outer([40, 41, 43, 43, 43, np.nan, 43, 43, 43], [0, 0, 1.0])
    np.testing.assert_array_equal(pocket.steady(field, 3, 2.5, 0.0), [1, 1, 0, 1, 1, 0, 0, 0, 1])


def test_averaged_noise_is_that_of_batch_least_squares(rng):
    """Bias alone, of readings so clean that all is linear."""
    count, dt, sigma, gyroscope, spread = 40, 0.02, 1e-4, 1e-6, 1e-4
    walk, C, rate, b = [], np.eye(3), rng.normal(size=(count, 3)), spread * rng.normal(size=3)
    for w in rate:
        C = C @ rotation((w + gyroscope / np.sqrt(dt) * rng.normal(size=3)) * dt)
        walk.append(C.T @ EARTH + sigma / np.sqrt(dt) * rng.normal(size=3))
    field = np.array(walk)
    made = Walk(np.full(count, dt), np.zeros((count, 3)), rate + b, field)
    start = Start(np.eye(3), np.zeros(3), np.diag([1e-6] * 3 + [spread**2] * 3))
    own = Settings(gyroscope=gyroscope, bias=0.0)
    run = pocket.twin(made, own, Magnetic("averaged", noise=sigma, threshold=10.0), start)

    Hs, zs, mix = [], [], np.zeros((3 * (count - 1), 3 * count))
    R = np.zeros((3 * (count - 1),) * 2)
    for k in range(1, count):
        A, at = rotation(made.rate[k] * dt), slice(3 * k - 3, 3 * k)
        cross = skew(A.T @ field[k - 1])
        Hs.append(-dt * cross @ pocket.right_jacobian(made.rate[k] * dt))
        zs.append(field[k] - A.T @ field[k - 1])
        mix[at, 3 * k - 3 : 3 * k], mix[at, 3 * k : 3 * k + 3] = -A.T, np.eye(3)
        R[at, at] = gyroscope**2 * dt * cross @ cross.T
    R += sigma**2 / dt * mix @ mix.T
    H, z = np.vstack(Hs), np.concatenate(zs)
    P = np.linalg.inv(np.eye(3) / spread**2 + H.T @ np.linalg.solve(R, H))
    np.testing.assert_allclose(run.P[3:6, 3:6], P, rtol=0.01, atol=0.01 * P.max())
    np.testing.assert_allclose(run.bias[-1], P @ H.T @ np.linalg.solve(R, z), atol=0.01 * np.sqrt(P.max()))
    assert np.trace(P) < 2 * spread**2
    white = pocket.twin(made, own, Magnetic("differential", noise=sigma, threshold=10.0), start)
    assert np.trace(white.P[3:6, 3:6]) > 2 * np.trace(P)


# ---- a made walk


class Made:
    """A thigh that swings and turns slowly, with a step's pushes and, for 8 s, a disturbance that changes."""

    def __init__(self, seconds, hard_iron=False, mid=False, noisy=True, disturbed=True, seed=7):
        rng, dt = np.random.default_rng(seed), 1 / RATE_HZ
        count = round(seconds * RATE_HZ)
        t = dt * np.arange(count + 1)
        swing = 2 * np.pi * 0.95 * t
        roll, pitch = (np.deg2rad(22) * np.sin(swing + x) for x in (0.0, 1.0))
        yaw = 0.4 + 0.1 * t + 0.5 * np.sin(0.3 * t)
        C = [pocket.matrix(np.array(e)) for e in zip(roll, pitch, yaw, strict=True)]
        self.rate = np.array([vector(a.T @ b) / dt for a, b in pairwise(C)])
        self.first, self.C = C[0], np.array(C[1:])
        speed = np.outer(np.sin(swing) ** 8, [0.0, 0.2, 0.4])  # a push once a step
        self.v = speed[1:]
        pushes = np.diff(speed, axis=0) / dt
        self.disturbed = disturbed & (t[1:] > 20) & (t[1:] < 28)
        self.field = EARTH + np.outer(self.disturbed * 15 * np.cos(2 * np.pi * t[1:]), UP)
        unrest = noisy / np.sqrt(dt)
        force, field = [], []
        for k in range(count):
            at = (C[k] + C[k + 1]) / 2 if mid else C[k + 1]
            force.append(np.linalg.solve(at, pushes[k] + 9.81 * UP) + noisy * 0.1 * rng.normal(size=3))
            field.append(C[k + 1].T @ self.field[k] + HARD_IRON * hard_iron)
        field = np.array(field) + 0.05 * unrest * rng.normal(size=(count, 3))
        rate = self.rate + BIAS + 1e-3 * unrest * rng.normal(size=(count, 3))
        self.walk = Walk(np.full(count, dt), np.array(force), rate, field)

    def away(self, attitudes):
        return np.array([vector(a @ b.T) for a, b in zip(self.C, attitudes, strict=True)])


@cache
def made(seconds=60.0, **own):
    return Made(seconds, **own)


def started(world, chart="twin", off=(0.02, -0.01, 0.0), sigmas=(0.02, 0.02, 1e-4), **own):
    """With a first attitude that is off in tilt; the heading is right by definition."""
    C = rotation(np.array(off)) @ world.first
    P = np.zeros((6, 6))
    P[:3, :3], P[3:, 3:] = np.diag(sigmas) ** 2, np.deg2rad(0.2) ** 2 * np.eye(3)
    if chart == "euler":
        back = np.linalg.inv(pocket.turning(pocket.angles(C)))
        P[:3, :3] = back @ P[:3, :3] @ back.T
    return Start(C, np.zeros(3), P, **own)


REFERENCES = {
    "none": Magnetic(),
    "differential": Magnetic("differential"),
    "averaged": Magnetic("averaged"),
    "anchored": Magnetic("anchored"),
    "state": Magnetic("state", wander=0.01),
    "deviation": Magnetic("state", deviation=0.5, deviation_time=2.0),
}


@cache
def through(chart, name):
    world = made()
    start = started(world, chart, field=EARTH, sigma_field=1.0)
    return getattr(pocket, chart)(world.walk, Settings(), REFERENCES[name], start)


BOTH = [name for name in REFERENCES if name != "deviation"]


@pytest.mark.parametrize(
    ("chart", "name"), [*(("euler", x) for x in BOTH), *(("twin", x) for x in REFERENCES)]
)
def test_bias_is_found(chart, name):
    world, run = made(), through(chart, name)
    sigma = np.sqrt(np.diag(run.P)[3:6])
    assert np.all(np.abs(run.bias[-1] - BIAS) < 4 * sigma), (run.bias[-1] - BIAS) / sigma
    assert sigma[:2].max() < np.deg2rad(0.02)
    assert (sigma[2] < np.deg2rad(0.03)) == (name not in ("none", "differential"))
    tilt = world.away(run.attitude)[250:, :2]
    assert np.abs(tilt).max() < np.deg2rad(2.0 if name == "anchored" else 0.6)  # an anchor keeps its errors
    assert 0.2 < run.gravity.mean() < 0.8
    if name != "none":
        assert run.field[world.disturbed].max() == 0
        assert run.field[~world.disturbed].mean() > 0.9


@pytest.mark.parametrize("name", BOTH)
def test_euler_and_twin_agree(name):
    one, other = through("euler", name), through("twin", name)
    apart = max(angle(a @ b.T) for a, b in zip(one.attitude[::10], other.attitude[::10], strict=True))
    assert apart < np.deg2rad(0.1)
    sigma = np.sqrt(np.diag(other.P)[3:6])
    assert np.abs(one.bias - other.bias).max() < np.deg2rad(0.01)
    np.testing.assert_allclose(np.sqrt(np.diag(one.P)[3:6]), sigma, rtol=0.02)


@pytest.mark.parametrize("name", ["none", "averaged", "anchored", "state"])
def test_euler_and_twin_differ_by_the_square_of_the_error(name):
    world = made(0.4, noisy=False, disturbed=False)
    clean = world.walk._replace(rate=world.rate, force=9.81 * world.C[:, 2])

    def apart(size):
        runs = []
        for chart in ("euler", "twin"):
            start = started(world, chart, size * np.array([1.0, -0.5, 0.7]), (0.1, 0.1, 0.1), field=EARTH)
            runs.append(getattr(pocket, chart)(clean, Settings(), REFERENCES[name], start).attitude[-1])
        return angle(runs[0] @ runs[1].T)

    assert apart(0.01) / apart(0.005) == pytest.approx(4, rel=0.07)


def test_hard_iron_is_found():
    world = made(40.0, hard_iron=True)
    m = Magnetic("state", threshold=8.0, hard_iron=True, deviation=0.3, deviation_time=2.0)
    run = pocket.twin(
        world.walk,
        Settings(),
        m,
        started(world, field=EARTH, sigma_field=0.5, sigma_hard_iron=2.0),
    )
    assert list(run.own) == ["B", "d", "h"]
    assert run.P.shape == (15, 15)
    for found, true, at in ((run.own["h"], HARD_IRON, slice(12, 15)), (run.bias, BIAS, slice(3, 6))):
        sigma = np.sqrt(np.diag(run.P)[at])
        assert np.all(np.abs(found[-1] - true) < 4 * sigma), (found[-1] - true) / sigma
    assert np.all(np.sqrt(np.diag(run.P)[12:15]) < 0.5)


def test_missing_fields_and_samples_of_no_duration():
    world = made(5.0, disturbed=False)
    field, dt = world.walk.field.copy(), world.walk.dt.copy()
    field[30], dt[60:] = np.nan, 0.0
    walk = world.walk._replace(field=field, dt=dt)
    for name in ("differential", "averaged", "anchored", "state"):
        run = pocket.twin(walk, Settings(), REFERENCES[name]._replace(samples=2), started(world, field=EARTH))
        assert np.isfinite(run.attitude).all()
        assert np.isfinite(run.P).all()
        assert not run.field[30:32].any()
        assert not run.field[60:].any()
        np.testing.assert_array_equal(run.attitude[60:], np.broadcast_to(run.attitude[59], (40, 3, 3)))


# ---- the filter in the pocket


def pocket_start(C, sigma_yaw=0.05):
    sigmas = [0.02, 0.02, sigma_yaw, *[0.3] * 3, *[np.deg2rad(0.2)] * 3, *[2.0] * 3, *[0.5] * 3]
    zero = np.zeros(3)
    return PocketStart(C, zero, zero, zero, EARTH, np.diag(sigmas) ** 2)


def test_pocket_finds_bias_heading_and_hard_iron():
    world = made(40.0, hard_iron=True, mid=True)
    run = pocket.pocket(world.walk, PocketSettings(), pocket_start(world.first))
    for found, true, at in ((run.bias, BIAS, pocket.BIAS), (run.hard_iron, HARD_IRON, pocket.IRON)):
        sigma = np.sqrt(np.diag(run.P)[at])
        assert np.all(np.abs(found[-1] - true) < 4 * sigma), (found[-1] - true) / sigma
    assert np.abs(world.away(run.attitude)[300:]).max() < np.deg2rad(2.0)
    assert run.weight[world.disturbed].max() < 0.3
    assert np.median(run.weight[~world.disturbed]) > 0.9


@pytest.mark.parametrize("waits", [False, True])
def test_pocket_latches_where_the_field_may_be_the_known_one(waits):
    world = made(8.0, mid=True, disturbed=False)
    field = world.walk.field.copy()
    field[:100] += (world.C.transpose(0, 2, 1) @ (30 * UP))[:100]
    wrong = rotation(2.0 * UP) @ world.first
    s = PocketSettings(latch=True, memory_waits=waits)
    run = pocket.pocket(world.walk._replace(field=field), s, pocket_start(wrong, 3.0))
    assert not run.latched[:100].any()
    assert run.latched[100:].all()
    assert not run.weight[:100].any()
    off = np.abs(world.away(run.attitude)[:, 2])
    assert off[99] > 1.8
    assert off[100] < 0.1
    assert off[-1] < 0.05
    assert run.memory[99] == 0 if waits else run.memory[99] > 100
