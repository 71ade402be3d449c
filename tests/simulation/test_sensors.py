"""The sensor models: each error against its closed form, draws against statistics, clocks, presets."""

import dataclasses
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.errors import InputError
from pedjax.simulation import presets, sensors
from pedjax.simulation.sensors import Clock, Imu, Magnetometer, Triad

COUNT = 400
STEPS = np.random.default_rng(1).uniform(0.004, 0.016, COUNT)
"""s, an uneven clock."""

KEY = jax.random.key(7)
ALL = {
    "noise": 0.01, "bias_std": 0.2, "drift_std": 0.1, "walk": 0.05, "startup_std": 0.3, "scale_std": 0.01,
    "misalignment_std": 0.01, "g_sensitivity_std": 1e-3, "temperature_std": 0.02,
}  # fmt: skip
"""Every random source at once."""

SEEDS = 2000
FEW = STEPS[:120]

apply_as_given = jax.jit(sensors.apply)
apply_magnetometer = jax.jit(sensors.apply_magnetometer)
apply_imu = jax.jit(sensors.apply_imu)
over_keys = jax.jit(jax.vmap(sensors.apply, in_axes=(None, 0, None, None)))


def apply(model, key, dt, clean, specific_force=None, temperature=None):
    """`sensors.apply` as one program for most tests."""
    force = np.zeros_like(clean) if specific_force is None else specific_force
    heat = np.zeros(len(clean)) if temperature is None else temperature
    return apply_as_given(model, key, dt, clean, specific_force=force, temperature=heat)


def many(model, seeds=SEEDS, dt=FEW, dtype=float):
    """`Measured` over seeds, `(S, T, 3)`, of a still sensor."""
    keys = jax.vmap(jax.random.key)(jnp.arange(seeds))
    return over_keys(model, keys, dt, np.zeros((len(dt), 3), dtype))


@pytest.fixture(scope="module")
def clean():
    return np.random.default_rng(2).normal(0, 5, (COUNT, 3))


def near(estimate, truth, error, sigmas=5.0):
    """Whether an estimate lies within that many of its own standard deviations."""
    off = np.abs(np.asarray(estimate) - truth)
    np.testing.assert_array_less(off, np.broadcast_to(sigmas * error, off.shape))


# --- nothing, and each error alone ---


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_error_leaves_every_bit(clean, dtype):
    signal = clean.astype(dtype)
    heat = np.linspace(0, 9, COUNT)
    out = apply(Triad(), KEY, STEPS, signal, signal, heat)
    assert {x.dtype for x in out} == {np.dtype(dtype)}
    np.testing.assert_array_equal(out.values, signal)
    np.testing.assert_array_equal(out.bias, 0)
    np.testing.assert_array_equal(out.matrix, np.eye(3))


def test_no_error_leaves_every_bit_of_a_unit(clean):
    turn = np.broadcast_to(np.eye(3), (COUNT, 3, 3))
    for triad in apply_imu(Imu(), KEY, STEPS, clean, clean, clean, attitude=turn, stance=np.ones(COUNT)):
        np.testing.assert_array_equal(triad.values, clean)
    first_order = apply_imu(Imu(Triad(order=1)), KEY, STEPS, clean, clean)
    np.testing.assert_array_equal(first_order.accelerometer.values, clean)
    assert first_order.magnetometer is None


def test_saturation(clean):
    limit = np.array([2.0, 4.0, 1.0])
    np.testing.assert_array_equal(
        apply(Triad(limit=limit), KEY, STEPS, clean).values, clean.clip(-limit, limit)
    )


def test_quantisation(clean):
    out = np.asarray(apply(Triad(resolution=0.25), KEY, STEPS, clean).values)
    np.testing.assert_array_equal(out, np.round(clean / 0.25) * 0.25)
    near((out - clean).std(), 0.25 / np.sqrt(12), 0.25 / np.sqrt(12) / np.sqrt(out.size))


def test_quantisation_is_transparent_to_gradients(clean):
    def power(bias):
        return (sensors.apply(Triad(bias=bias, resolution=0.5), KEY, STEPS, clean).values ** 2).mean()

    values = apply(Triad(bias=0.1, resolution=0.5), KEY, STEPS, clean).values
    assert float(jax.jit(jax.grad(power))(0.1)) == pytest.approx(float(2 * values.mean()))


def test_scale_and_misalignment(clean):
    scale = np.array([0.01, -0.02, 0.03])
    turn = np.arange(9.0).reshape(3, 3) * 1e-3
    out = apply(Triad(scale=scale, misalignment=turn), KEY, STEPS, clean)
    matrix = np.eye(3) + np.diag(scale) + turn * (1 - np.eye(3))
    np.testing.assert_allclose(out.matrix, matrix, rtol=1e-14)
    np.testing.assert_allclose(out.values, clean @ matrix.T, rtol=0, atol=1e-13)


def test_the_matrix_told_is_the_matrix_used(clean):
    out = apply(Triad(scale_std=0.1, misalignment_std=0.1), KEY, STEPS, clean)
    np.testing.assert_allclose(out.values, clean @ np.asarray(out.matrix).T, rtol=0, atol=1e-12)
    assert np.abs(np.asarray(out.matrix) - np.eye(3)).min() > 1e-4  # all nine were drawn


def test_drawn_matrix_statistics():
    error = np.asarray(many(Triad(scale_std=0.02, misalignment_std=0.01)).matrix) - np.eye(3)
    wanted = np.where(np.eye(3) > 0, 0.02, 0.01)
    near(error.std(axis=0), wanted, wanted / np.sqrt(2 * SEEDS))
    near(error.mean(axis=0), 0, wanted / np.sqrt(SEEDS))


@pytest.mark.parametrize("shape", [(), (3,), (3, 3)])
def test_g_sensitivity(clean, shape):
    force = np.random.default_rng(3).normal(0, 10, (COUNT, 3))
    given = np.random.default_rng(4).normal(0, 1e-3, shape)
    matrix = given if shape == (3, 3) else given * np.eye(3)
    out = apply(Triad(g_sensitivity=given), KEY, STEPS, clean, force)
    np.testing.assert_allclose(out.values - clean, force @ matrix.T, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(out.bias, 0)
    if shape == ():
        np.testing.assert_array_equal(
            apply_as_given(Triad(g_sensitivity=0.1), KEY, STEPS, clean).values, clean
        )


def test_temperature(clean):
    heat = 12 * (1 - np.exp(-np.cumsum(STEPS) / 1.5))
    each = np.array([0.1, -0.2, 0.3])
    out = apply(Triad(temperature=each), KEY, STEPS, clean, None, heat)
    np.testing.assert_allclose(out.bias, heat[:, None] * each, rtol=1e-13)
    np.testing.assert_allclose(out.values, clean + out.bias, rtol=0, atol=1e-13)


def test_start_up(clean):
    out = apply(Triad(startup=np.array([1.0, 2.0, -3.0]), startup_time=0.8), KEY, STEPS, clean)
    since = np.cumsum(STEPS) - STEPS[0]
    np.testing.assert_allclose(out.bias, np.exp(-since / 0.8)[:, None] * [1.0, 2.0, -3.0], rtol=1e-11)


def test_a_fixed_bias(clean):
    out = apply(Triad(bias=np.array([0.1, 0.0, -0.1])), KEY, STEPS, clean)
    np.testing.assert_array_equal(out.bias, np.broadcast_to([0.1, 0.0, -0.1], (COUNT, 3)))


# --- the low-pass ---


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("bandwidth", [0.5, 8.0, 300.0])
def test_step_response(order, bandwidth):
    """A step is a ramp over the interval in which it falls: the continuous answer, sampled at any rate."""
    at = 50
    signal = np.zeros((COUNT, 3))
    signal[at:] = 1.0
    t, h = (np.cumsum(STEPS) - STEPS[: at + 1].sum() + STEPS[at])[at:], STEPS[at]  # from the ramp's begin
    w = 2 * np.pi * bandwidth
    if order == 1:

        def integral(t):
            return t - (1 - np.exp(-w * t)) / w

    else:
        a = w / np.sqrt(2)

        def integral(t):
            return t - np.sqrt(2) / w + np.exp(-a * t) * np.cos(a * t) / a

    wanted = (integral(t) - integral(t - h)) / h
    got = sensors.low_pass(jnp.asarray(signal), STEPS, bandwidth, order)
    np.testing.assert_allclose(got[at:, 0], wanted, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(got[:at], 0)


@pytest.mark.parametrize("order", [1, 2])
def test_gain_at_rest_delay_and_half_power(order):
    flat = np.full((COUNT, 3), 3.7)
    np.testing.assert_allclose(sensors.low_pass(jnp.asarray(flat), STEPS, 5.0, order), flat, rtol=1e-13)
    time = np.cumsum(STEPS)
    ramp = np.stack([time, -2 * time, 0 * time], axis=1)
    late = ramp - np.asarray(sensors.low_pass(jnp.asarray(ramp), STEPS, 5.0, order))
    delay = (1 if order == 1 else np.sqrt(2)) / (2 * np.pi * 5.0)
    np.testing.assert_allclose(late[-1], [delay, -2 * delay, 0], rtol=1e-9)
    t = np.arange(4000) * 1e-3
    wave = np.repeat(np.sin(2 * np.pi * 5.0 * t)[:, None], 3, axis=1)
    out = np.asarray(sensors.low_pass(jnp.asarray(wave), 1e-3, 5.0, order))[2000:, 0]
    assert out.std() / wave[2000:, 0].std() == pytest.approx(np.sqrt(0.5), rel=1e-3)


def test_low_pass_goes_through_the_model_and_spares_noise_and_bias(clean):
    model = Triad(bandwidth=6.0, order=1)
    noisy = dataclasses.replace(model, noise=0.1, bias=1.0)
    got, extra = apply(model, KEY, STEPS, clean), apply(noisy, KEY, STEPS, clean)
    np.testing.assert_allclose(got.values, sensors.low_pass(clean, STEPS, 6.0, 1), rtol=0, atol=1e-13)
    white = apply(Triad(noise=0.1, bias=1.0), KEY, STEPS, 0 * clean).values
    np.testing.assert_allclose(extra.values - got.values, white, rtol=0, atol=1e-12)


def test_a_low_pass_has_an_order():
    with pytest.raises(InputError, match="order 1 or 2"):
        sensors.low_pass(jnp.zeros((3, 3)), 0.01, 1.0, 3)


# --- statistics over seeds ---


def test_white_noise():
    out = np.asarray(many(Triad(noise=0.02)).values) * np.sqrt(FEW)[:, None] / 0.02
    count = out[..., 0].size
    near(out.std(axis=(0, 1)), 1, 1 / np.sqrt(2 * count))
    near(out.mean(axis=(0, 1)), 0, 1 / np.sqrt(count))
    near((out[:, 1:] * out[:, :-1]).mean(axis=(0, 1)), 0, 1 / np.sqrt(count))
    near((out**4).mean(axis=(0, 1)), 3, np.sqrt(96 / count))
    short, long = FEW < 0.007, FEW > 0.013  # each step has its own standard deviation
    for part in (short, long):
        near(out[:, part].std(), 1, 1 / np.sqrt(2 * out[:, part].size))


def test_gauss_markov():
    tau = 0.5
    out = np.asarray(many(Triad(drift_std=0.3, drift_time=tau)).bias)
    for k in (0, 60, 119):  # stationary from the first sample on
        near(out[:, k].std(axis=0), 0.3, 0.3 / np.sqrt(2 * SEEDS))
    for a, b in ((0, 1), (20, 60), (5, 100)):
        rho = np.exp(-FEW[a + 1 : b + 1].sum() / tau)
        got = (out[:, a] * out[:, b]).mean(axis=0) / 0.3**2
        near(got, rho, np.sqrt((1 + rho**2) / SEEDS))


def test_random_walk():
    out = np.asarray(many(Triad(walk=0.4)).bias)
    np.testing.assert_array_equal(out[:, 0], 0)
    for k in (1, 30, 119):
        wanted = 0.4 * np.sqrt(FEW[1 : k + 1].sum())
        near(out[:, k].std(axis=0), wanted, wanted / np.sqrt(2 * SEEDS))
    fresh = out[:, 60] - out[:, 30]
    near((fresh * out[:, 30]).mean() / fresh.std() / out[:, 30].std(), 0, 1 / np.sqrt(3 * SEEDS))


@pytest.mark.parametrize("name", ["bias", "startup"])
def test_drawn_constants(name):
    out = np.asarray(many(Triad(**{name: 1.0, f"{name}_std": 0.5})).bias)[:, 0]
    near(out.std(axis=0), 0.5, 0.5 / np.sqrt(2 * SEEDS))
    near(out.mean(axis=0), 1.0, 0.5 / np.sqrt(SEEDS))


def test_seeds_axes_and_sources_are_independent():
    """Correlations of every pair among axes and sources, and of neighbouring seeds."""
    sources = ("noise", "bias_std", "drift_std", "walk", "startup_std")
    columns = [np.asarray(many(Triad(**{name: 1.0})).values)[:, 1] for name in sources]
    together = np.concatenate(columns, axis=1)
    near(np.corrcoef(together.T) - np.eye(15), 0, 1 / np.sqrt(SEEDS))
    near([np.corrcoef(x[1:], x[:-1])[0, 1] for x in together.T], 0, 1 / np.sqrt(SEEDS))


def test_triads_of_a_unit_draw_apart(clean):
    unit = Imu(Triad(**ALL), Triad(**ALL), Magnetometer(Triad(**ALL)))
    out = apply_imu(unit, KEY, STEPS, clean, clean, clean)
    a, b, c = (np.asarray(x.values) for x in out)
    assert min(np.abs(a - b).max(), np.abs(b - c).max(), np.abs(a - c).max()) > 0.1


# --- keys ---


def test_same_seed_same_bits(clean):
    one, same, other = (apply(Triad(**ALL), jax.random.key(k), STEPS, clean) for k in (3, 3, 4))
    for a, b, c in zip(one, same, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert (np.asarray(a) != np.asarray(c)).any()


@pytest.mark.parametrize("name", [*ALL, "bias"])
def test_switching_one_error_off_leaves_the_draws_of_the_others(clean, name):
    """All errors but white noise are exact sums, so what is gone is what that error does alone."""
    kept = {other: value for other, value in ALL.items() if other != name}
    alone = dict.fromkeys(ALL, 0.0) | {name: ALL.get(name, 0.4)}
    whole = {**ALL, name: alone[name]}
    heat = np.linspace(0, 5, COUNT)

    def run(fields):
        fields = dict.fromkeys([*ALL, "bias"], 0.0) | fields
        return apply(Triad(**fields), KEY, STEPS, clean, clean, heat)

    a, b, c = run(whole), run(kept), run(alone)
    np.testing.assert_allclose(a.values - b.values, c.values - clean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.bias - b.bias, c.bias, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.matrix - b.matrix, c.matrix - np.eye(3), rtol=0, atol=1e-15)
    assert np.abs(c.values - clean).max() > 0


@pytest.mark.parametrize("keep", [1, 137])
def test_cropping_the_end_changes_nothing_before_it(clean, keep):
    model = Triad(**ALL, bandwidth=20.0)
    whole, part = apply(model, KEY, STEPS, clean), apply(model, KEY, STEPS[:keep], clean[:keep])
    np.testing.assert_allclose(part.values, whole.values[:keep], rtol=0, atol=1e-14)
    np.testing.assert_allclose(part.bias, whole.bias[:keep], rtol=0, atol=1e-15)


def test_bias_is_exactly_what_was_added(clean):
    model = Triad(**{**ALL, "noise": 0.0, "scale_std": 0.0, "misalignment_std": 0.0})
    out = apply(model, KEY, STEPS, clean)
    np.testing.assert_array_equal(out.values, clean + np.asarray(out.bias))


# --- batches, precision, gradients ---


def test_a_hundred_keys_at_once_are_a_hundred_runs(clean):
    keys = jax.random.split(KEY, 100)
    model = Triad(**ALL, bandwidth=30.0, limit=8.0, resolution=1e-4)
    batch = over_keys(model, keys, STEPS, clean)
    for k in range(100):
        one = apply(model, keys[k], STEPS, clean)
        np.testing.assert_allclose(batch.bias[k], one.bias, rtol=0, atol=1e-12)
        np.testing.assert_allclose(batch.matrix[k], one.matrix, rtol=0, atol=1e-14)
        off = np.abs(batch.values[k] - one.values)
        assert np.isclose(off, 0, atol=1e-12).mean() > 0.999  # a last bit may tip a step
        assert off.max() < 1.01e-4


def test_models_side_by_side(clean):
    models = jax.vmap(lambda x: Triad(noise=x, bandwidth=50 * x, scale_std=x))(jnp.array([0.1, 0.2, 0.3]))
    batch = jax.jit(jax.vmap(lambda model: sensors.apply(model, KEY, STEPS, clean)))(models)
    for k, x in enumerate((0.1, 0.2, 0.3)):
        one = apply(Triad(noise=x, bandwidth=50 * x, scale_std=x), KEY, STEPS, clean)
        np.testing.assert_allclose(batch.values[k], one.values, rtol=0, atol=1e-12)


def test_single_precision_stays_near_double(clean):
    """Everything that is not drawn; draws differ by precision."""
    model = Triad(
        bias=0.3, startup=0.5, temperature=0.1, scale=0.01, misalignment=0.02, g_sensitivity=0.001,
        bandwidth=10.0, limit=9.0,
    )  # fmt: skip
    heat = np.linspace(0, 5, COUNT)
    out = {}
    for dtype in (np.float32, np.float64):
        signal = clean.astype(dtype)
        out[dtype] = apply(model, KEY, STEPS, signal, signal, heat)
        assert {x.dtype for x in out[dtype]} == {np.dtype(dtype)}
    np.testing.assert_allclose(out[np.float32].values, out[np.float64].values, rtol=0, atol=3e-5)
    np.testing.assert_allclose(out[np.float32].bias, out[np.float64].bias, rtol=0, atol=1e-5)


def test_single_precision_draws_have_their_statistics():
    out = np.asarray(many(Triad(noise=0.02), 400, FEW, np.float32).values)
    assert out.dtype == np.float32
    near((out * np.sqrt(FEW)[:, None]).std(), 0.02, 0.02 / np.sqrt(2 * out.size))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gradients_are_finite(clean, dtype):
    """By every number of a whole model, at its defaults (most errors off) and in a preset."""

    def spread(model):
        out = sensors.apply(model, KEY, STEPS, clean.astype(dtype), specific_force=clean)
        return ((out.values - out.values.mean(axis=0)) ** 2).mean()

    slope = jax.jit(jax.grad(spread))
    for model in (Triad(noise=0.02), presets.imu_array_8().gyroscope):
        shaped = jax.tree.map(lambda x: jnp.asarray(x, float), model)
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slope(shaped)))


def test_gradient_by_noise_density():
    """The power of white noise is its density squared over dt: its gradient is known."""

    def power(density):
        return (sensors.apply(Triad(noise=density), KEY, STEPS, np.zeros((COUNT, 3))).values ** 2).mean()

    value, slope = jax.jit(jax.value_and_grad(power))(0.02)
    assert float(slope) == pytest.approx(2 * float(value) / 0.02)


def test_a_step_of_zero_gives_finite_values(clean):
    out = apply(Triad(**ALL, bandwidth=20.0), KEY, np.where(np.arange(COUNT) == 9, 0.0, STEPS), clean)
    assert np.isfinite(out.values).all()


# --- the magnetometer ---


SOFT = np.eye(3) + 0.05 * np.arange(9.0).reshape(3, 3)
FLOOR, PLATFORM = np.array([3.0, -1.0, 2.0]), np.array([0.5, 0.6, 0.7])


def test_hard_and_soft_iron(clean):
    """And no stance disturbance where there is no stance."""
    hard = np.array([13.8, 7.5, -5.6])
    out = apply_magnetometer(Magnetometer(Triad(scale=0.1), hard, SOFT, PLATFORM, FLOOR), KEY, STEPS, clean)
    np.testing.assert_allclose(out.matrix, 1.1 * SOFT, rtol=1e-14)
    np.testing.assert_array_equal(out.bias, np.broadcast_to(hard, (COUNT, 3)))
    np.testing.assert_allclose(out.values, clean @ np.asarray(out.matrix).T + hard, rtol=0, atol=1e-12)


def test_stance_disturbance(clean):
    angle = np.linspace(0, 3, COUNT)
    c, s, o = np.cos(angle), np.sin(angle), np.zeros(COUNT)
    attitude = np.stack([c, -s, o, s, c, o, o, o, o + 1], axis=1).reshape(-1, 3, 3)
    stance = np.random.default_rng(6).uniform(0, 1, COUNT) * (np.arange(COUNT) % 100 > 50)
    model = Magnetometer(soft_iron=SOFT, floor=FLOOR, platform=PLATFORM)
    out = apply_magnetometer(model, KEY, STEPS, clean, attitude=attitude, stance=stance)
    there = clean + stance[:, None] * np.einsum("tji,j->ti", attitude, FLOOR)
    np.testing.assert_allclose(out.values, there @ SOFT.T + stance[:, None] * PLATFORM, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(out.bias, 0)
    swing = stance == 0
    np.testing.assert_allclose(out.values[swing], clean[swing] @ SOFT.T, rtol=0, atol=1e-13)
    with pytest.raises(InputError, match="need the attitude"):
        sensors.apply_magnetometer(model, KEY, STEPS, clean, stance=stance)


# --- the clock ---


def test_an_even_clock():
    ticks = sensors.clock(Clock(rate=200.0), 0, 3.0)
    np.testing.assert_allclose(ticks.time, np.arange(600) / 200.0, rtol=1e-15)
    np.testing.assert_array_equal(ticks.stamps, ticks.time)
    assert ticks.kept.all()


def test_rate_error():
    ticks = sensors.clock(Clock(rate=100.0, ppm=200.0), 0, 1000.0)
    np.testing.assert_allclose(ticks.stamps, np.arange(100000) / 100.0, rtol=1e-12)  # it believes in itself
    assert ticks.time[-1] == pytest.approx(999.99 / (1 + 200e-6), rel=1e-12)
    ppm = [1e6 * (0.09 / sensors.clock(Clock(ppm_std=50.0), k, 0.1).time[-1] - 1) for k in range(400)]
    near(np.std(ppm), 50, 50 / np.sqrt(800))
    near(np.mean(ppm), 0, 50 / np.sqrt(400))


def test_jitter():
    ticks = sensors.clock(Clock(rate=100.0, jitter=1e-3), 1, 100.0)
    moved = ticks.time - np.arange(10000) / 100.0
    near(moved.std(), 1e-3, 1e-3 / np.sqrt(20000))
    assert ticks.time[0] == 0
    wild = sensors.clock(Clock(rate=100.0, jitter=1.0), 1, 10.0).time
    assert np.diff(wild).min() >= 0.099 * 0.01


def test_losses():
    ticks = sensors.clock(Clock(loss=0.02, burst=4.0), 2, 2000.0)
    count = len(ticks.kept)
    assert ticks.kept[0]
    lost = ~ticks.kept
    part = 0.08 / 1.08
    near(lost.mean(), part, np.sqrt(part * (1 - part) / count * (2 * 4)))  # bursts: fewer free samples
    starts = (lost[1:] & ~lost[:-1]).sum()
    near(lost.sum() / starts, 4.0, np.sqrt(12 / starts))
    near(starts / (~lost).sum(), 0.02, np.sqrt(0.02 / count))
    single = ~sensors.clock(Clock(loss=0.3, burst=1.0), 2, 100.0).kept
    assert not (single[1:] & single[:-1]).any()


def test_repeated_stamps():
    ticks = sensors.clock(Clock(rate=400.0, repeat=0.1), 3, 100.0)
    same = np.diff(ticks.stamps) == 0
    near(same.mean(), 0.1, np.sqrt(0.09 / len(same)))
    assert (np.diff(ticks.stamps) >= 0).all()
    np.testing.assert_allclose(ticks.time, np.arange(40000) / 400.0, rtol=1e-12)
    np.testing.assert_array_equal(ticks.stamps[1:][~same], ticks.time[1:][~same])


def test_clock_draws_do_not_touch_each_other():
    full = Clock(rate=100.0, ppm_std=0.0, jitter=1e-3, loss=0.05, burst=2.0, repeat=0.05)
    one, same = sensors.clock(full, 5, 50.0), sensors.clock(full, 5, 50.0)
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a, b)
    plain = sensors.clock(dataclasses.replace(full, loss=0.0, repeat=0.0), 5, 50.0)
    np.testing.assert_array_equal(plain.time, one.time)
    even = sensors.clock(dataclasses.replace(full, jitter=0.0), 5, 50.0)
    np.testing.assert_array_equal(even.kept, one.kept)
    np.testing.assert_array_equal(np.diff(even.stamps) == 0, np.diff(one.stamps) == 0)
    assert (sensors.clock(full, 6, 50.0).time != one.time).any()


@pytest.mark.parametrize(
    "wrong", [{"rate": 0.0}, {"loss": 1.0}, {"burst": 0.5}, {"repeat": 2.0}, {"jitter": -1.0}]
)
def test_an_impossible_clock(wrong):
    with pytest.raises(InputError, match="clock"):
        sensors.clock(Clock(**wrong), 0, 1.0)


def test_a_walk_without_a_sample():
    with pytest.raises(InputError, match="hold no sample"):
        sensors.clock(Clock(rate=1.0), 0, 0.5)


# --- presets ---


@pytest.mark.parametrize("name", presets.presets())
def test_presets_measure(clean, name):
    out = apply_imu(presets.preset(name), KEY, STEPS, clean, clean, clean)
    for triad in out:
        assert np.isfinite(triad.values).all()
    if name == "perfect":
        np.testing.assert_array_equal(out.gyroscope.values, clean)
    else:
        assert (np.asarray(out.gyroscope.values) != clean).all()


def test_presets_are_trees_of_the_same_shape_of_program():
    shapes = {str(jax.tree.structure(unit)) for unit in presets.presets().values()}
    assert len(shapes) == 1


def test_an_unknown_preset():
    with pytest.raises(InputError, match="did you mean 'mpu_9250'"):
        presets.preset("mpu9250")


def test_figures_of_the_papers():
    """Table 1 of Wang et al., table 2 of Munoz Diaz et al. at 100 Hz."""
    mti, mtw = presets.mti_g_710(), presets.xsens_mtw()
    assert np.rad2deg(mti.gyroscope.bias_std) == pytest.approx(0.2)
    assert np.rad2deg(mti.gyroscope.noise) == pytest.approx(0.01)
    assert mti.accelerometer.noise / 9.80665e-6 == pytest.approx(80)
    assert mti.accelerometer.bias_std == 0.03
    assert np.rad2deg(mtw.gyroscope.noise) * np.sqrt(100.0) == pytest.approx(0.1)
    fibre = presets.kvh_dsp_1750().gyroscope  # noise and stability one to two decades below the MTw
    assert 30 < mtw.gyroscope.noise / fibre.noise < 300
    assert 30 < mtw.gyroscope.drift_std / fibre.drift_std < 300


def test_an_array_is_the_mean_of_its_units(clean):
    """Statistics of the preset against eight units that are run and averaged."""
    one, eight = presets.mpu_9250().gyroscope, presets.imu_array_8().gyroscope
    for name in ("noise", "bias_std", "drift_std", "scale_std", "misalignment_std", "temperature_std"):
        assert getattr(eight, name) == pytest.approx(getattr(one, name) / np.sqrt(8), rel=1e-6)
    assert eight.limit == one.limit
    units, whole = np.asarray(many(one).values), np.asarray(many(eight).values)
    mean = units.reshape(-1, 8, *units.shape[1:]).mean(axis=1)
    np.testing.assert_allclose(mean.std(axis=0), whole.std(axis=0), rtol=6 * np.sqrt(0.5 * 9 / SEEDS))
    steps = float(eight.resolution)
    np.testing.assert_allclose(mean / steps, np.round(mean / steps), atol=1e-6)
    with pytest.raises(InputError):
        presets.averaged(presets.mpu_9250(), 0)


def test_calibration_leaves_noise_and_drift():
    raw, left = presets.mpu_9250(), presets.calibrated(presets.mpu_9250(), 0.1)
    assert left.gyroscope.noise == raw.gyroscope.noise
    assert left.gyroscope.drift_std == raw.gyroscope.drift_std
    assert left.gyroscope.bias_std == pytest.approx(0.1 * raw.gyroscope.bias_std)
    np.testing.assert_allclose(left.accelerometer.bias_std, 0.1 * raw.accelerometer.bias_std)


def test_the_peak_of_the_allan_deviation_of_a_drift():
    """The factor by which the presets turn a published stability into a standard deviation."""
    x = np.logspace(-1, 1, 2001)
    deviation = np.sqrt(2 / x * (1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * x)))
    assert deviation.max() == pytest.approx(presets._ALLAN_PEAK, abs=5e-4)


def test_every_number_of_a_preset_has_its_source():
    """Each figure's line names data sheet, paper, measurement or assumption."""
    for make in presets.PRESETS.values():
        for line in inspect.getsource(make).splitlines():
            figure = line.strip().split("=")[0]
            if figure in Triad.__dataclass_fields__ and figure != "drift_time":
                assert any(mark in line for mark in ("[S]", "[R]", "[P]", "[M]", "[A]")), line
