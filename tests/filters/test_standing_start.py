"""The gyroscope's first bias from the standing start: what it is, what it weighs, in packed recordings."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import filtering, parameters
from pedjax.ensemble import Problem, losses
from pedjax.filters import covariance
from pedjax.kernels.graph import evaluate, with_numpy
from pedjax.kernels.program import beginning, program
from pedjax.kernels.tangents import Dual, dual, tangents
from pedjax.packing import pack, pack_all
from pedjax.preparing import prepare
from pedjax.system import Signals
from pedjax.systems import SYSTEMS
from pedjax.walks import walk as as_walk
from tests import tools
from tests.kernels.tools import advance_of
from tests.reference import detectors as naive
from tests.reference import filter as oracle
from tests.reference.walk import walk

IEZ = SYSTEMS["iez"]
RATE = 100.0
BIAS = np.array([0.006, -0.004, 0.003])
SIGMA, SWAY = 0.0052, np.radians(0.25)


def rested(**changes):
    return tools.iez(
        **{"initial__bias": "rest", "initial__gyroscope_bias": SIGMA, **tools.shoe_sigmas(), **changes}
    )


def biased(made, noise=0.0, seed=4):
    """The walk of a gyroscope with that bias."""
    rate = made.angular_rate + BIAS
    return made._replace(angular_rate=rate + np.random.default_rng(seed).normal(0, noise, rate.shape))


@pytest.fixture(scope="module")
def standing():
    """Stands for 3 s and then walks."""
    return biased(walk(12.0, RATE, seed=3, standing=3.0))


def started(params, made):
    """The first state of a made walk."""
    params = parameters.cast(params, float)
    signals = Signals(jnp.asarray(made.specific_force), jnp.asarray(made.angular_rate))
    inputs = IEZ.prepare(params, {"foot": signals}, jnp.asarray(made.dt), RATE)
    return IEZ.start(params, None, inputs.opening)


def sigma_of(state):
    return np.asarray(covariance.sigma(state.P, "g"))


def posterior(made, rest_s=10.0, sway=SWAY, sigma=SIGMA):
    """Bias (3,) and its standard deviation, from loops and the information added up."""
    mean, spread, windows = naive.standing_start(made.angular_rate, made.dt, RATE, rest_s)
    information = windows / (sway**2 + spread)
    variance = 1.0 / (1.0 / sigma**2 + information)
    return variance * information * mean, np.sqrt(variance)


def test_zero_asks_for_nothing(standing):
    state = started(tools.iez(), standing)
    assert not np.asarray(state.estimate.gyroscope_bias).any()
    signals = Signals(jnp.asarray(standing.specific_force), jnp.asarray(standing.angular_rate))
    opening = IEZ.prepare(tools.iez(), {"foot": signals}, jnp.asarray(standing.dt), RATE).opening
    assert opening.rest is None
    assert "initial.sway" not in parameters.active(tools.iez())
    assert "initial.sway" in parameters.tunable(rested())


def test_a_known_bias_is_found(standing):
    """With a sway that is hardly any, and no noise, to rounding."""
    state = started(rested(initial__sway=1e-6), standing)
    np.testing.assert_allclose(state.estimate.gyroscope_bias, BIAS, atol=1e-8)
    track = pedjax.run(tools.recording_of(standing, "stands"), params=rested(initial__sway=1e-6))
    assert track.healthy
    np.testing.assert_allclose(track.estimate["gyroscope_bias"][-1], BIAS, atol=2e-4)


@pytest.mark.parametrize("seconds", [0.1, 0.4, 1.0, 3.0, 9.0])
def test_bias_and_sigma_are_the_sum_of_information(seconds):
    made = biased(walk(11.0, RATE, seed=3, standing=seconds), noise=0.004)
    bias, sigma = posterior(made)
    state = started(rested(), made)
    np.testing.assert_allclose(state.estimate.gyroscope_bias, bias, rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(sigma_of(state), sigma, rtol=1e-10)


def test_a_longer_rest_is_surer(standing):
    lengths = (0.0, 0.1, 0.5, 1.0, 2.0, 3.0)
    found = [sigma_of(started(rested(initial__rest_s=s), standing))[0] for s in lengths]
    assert found[0] == found[1] == SIGMA  # no window: the prior
    assert (np.diff(found[1:]) < 0).all()
    away = [
        np.abs(started(rested(initial__rest_s=s), standing).estimate.gyroscope_bias - BIAS).max()
        for s in lengths
    ]
    assert (np.diff(away[1:]) < 0).all()


def test_a_moving_start_gives_the_prior(standing):
    moving = standing._replace(**{k: getattr(standing, k)[330:] for k in standing._fields[:4]})
    assert naive.standing_start(moving.angular_rate, moving.dt, RATE, 10.0)[2] == 0
    state = started(rested(), moving)
    assert not np.asarray(state.estimate.gyroscope_bias).any()
    np.testing.assert_array_equal(sigma_of(state), np.full(3, SIGMA))
    params = (rested(), rested(initial__bias="zero"))
    tracks = [pedjax.run(tools.recording_of(moving, "moves"), params=p) for p in params]
    np.testing.assert_allclose(tracks[0].position, tracks[1].position, atol=1e-12)


def test_the_track_is_the_textbook_filters(standing):
    params = rested()
    track = pedjax.run(tools.recording_of(standing, "stands"), params=params)
    bias, sigma = posterior(standing)
    first = standing.specific_force[: round(params.initial.levelling_s * RATE)].mean(axis=0)
    settings = replace(
        tools.oracle_settings(params, first, params.initial.heading),
        initial_gyroscope_bias=bias,
        initial_gyroscope_bias_std=sigma,
    )
    stance = track.gates["stance"].weight
    expected = oracle.run(
        standing.dt, standing.specific_force, standing.angular_rate, stance, 0 * stance, settings
    )
    for ours, theirs in tools.ORACLE_NAMES.items():
        np.testing.assert_allclose(track.estimate[ours], expected[theirs], atol=1e-9, err_msg=ours)
    np.testing.assert_allclose(tools.sigmas(track), np.sqrt(expected["P_diag"]), atol=1e-9)


def test_a_measured_bias_helps(standing):
    recording = tools.recording_of(standing, "stands", every_s=2.0)
    errors = [
        pedjax.evaluate(pedjax.run(recording, params=p), recording).rms_2d_m
        for p in (tools.iez(**tools.shoe_sigmas()), rested())
    ]
    assert errors[1] < 0.5 * errors[0]


def test_cropping_after_the_rest_changes_no_bit(standing):
    params = parameters.cast(rested(), float)
    found = as_walk(tools.recording_of(standing, "stands"))
    inputs = prepare(IEZ, params, found, float, 1200)
    _, whole = tools.scan(IEZ, params, inputs.samples, IEZ.start(params, None, inputs.opening))
    for stop in (900, 350):
        cropped = prepare(IEZ, params, tools.cropped(found, 0, stop), float, stop)
        _, part = tools.scan(IEZ, params, cropped.samples, IEZ.start(params, None, cropped.opening))
        tools.same_bits(jax.tree.map(lambda x, n=stop: x[:n], whole), part)


def recordings():
    """Different rests, and lengths; the last moves from the first sample on, all but."""
    made = ((12.0, 3.0), (9.0, 1.1), (15.0, 6.0), (10.0, 0.1))
    return [
        tools.recording_of(biased(walk(s, RATE, seed=k, standing=r), 0.004), f"{k}", 2.0)
        for k, (s, r) in enumerate(made)
    ]


def test_packed_recordings_equal_each_alone():
    params, some = parameters.cast(rested(), float), recordings()
    batch = pack(IEZ, params, [as_walk(r) for r in some])
    rest = batch.packed.openings.rest
    assert rest.rate.shape == (3, 4)
    assert rest.windows.tolist() == [12, 4, 24, 0]
    points = jax.jit(filtering.scan_points, static_argnums=(0, 3))(IEZ, params, batch.packed, batch.slots)
    estimates = np.asarray(batch.estimates(points)["position"])
    for r, recording in enumerate(some):
        alone = pedjax.run(recording, params=params).position[as_walk(recording).index]
        np.testing.assert_allclose(estimates[: len(alone), :, r], alone, atol=1e-10)


def test_with_a_compass(demos):
    """Aids that mend the first state leave the bias alone."""
    system = SYSTEMS["ma2018"]
    changes = {"initial.bias": "rest", "initial.gyroscope_bias": SIGMA}
    params = parameters.cast(parameters.replace(system.defaults(), changes), float)
    batch = pack(system, params, [as_walk(r, needs=system.needs) for r in demos[:2]])
    state, rest = filtering.starts_of(system, params, batch.packed), batch.packed.openings.rest
    assert (rest.windows > 0).all()
    own = rest.windows * SIGMA**2 / (rest.windows * SIGMA**2 + SWAY**2 + rest.spread)
    np.testing.assert_allclose(state.estimate.gyroscope_bias, own * rest.rate, rtol=1e-10)
    expected = np.broadcast_to(SIGMA * np.sqrt(1 - own), (3, 2))
    np.testing.assert_allclose(sigma_of(state), expected, rtol=1e-10)


def test_sets_in_lanes_equal_one_by_one():
    params = parameters.cast(rested(), float)
    batch = pack(IEZ, params, [as_walk(r) for r in recordings()])
    values = {
        "initial.sway": np.array([1e-4, 4e-3, 0.05]),
        "initial.gyroscope_bias": np.array([1e-3, SIGMA, 0.02]),
    }
    lanes = parameters.with_leaves(params, {k: jnp.asarray(v)[:, None] for k, v in values.items()})
    many = filtering.starts_of(IEZ, lanes, batch.packed)
    assert many.estimate.gyroscope_bias.shape == (3, 3, 4)
    for s in range(3):
        one = parameters.with_leaves(params, {k: jnp.asarray(v[s]) for k, v in values.items()})
        alone = filtering.starts_of(IEZ, one, batch.packed)
        tools.same_bits(jax.tree.map(lambda x, s=s: x[..., s, :], many), alone)


def test_gradient():
    """Of the whole track's error by sway and prior, against differences."""
    params = parameters.cast(rested(gate__width=0.25), float)
    batches = pack_all(IEZ, params, [as_walk(r) for r in recordings()[:2]])
    problem = Problem(IEZ, "rms_2d", "yaw_translation")
    paths = ("initial.sway", "initial.gyroscope_bias")
    at = jnp.log(jnp.array([parameters.get(params, path) for path in paths]))

    @jax.jit
    def loss(logs):
        values = {path: jnp.exp(x)[None] for path, x in zip(paths, logs, strict=True)}
        return losses(problem, params, values, batches).sum()

    slope, steps = jax.jit(jax.grad(loss))(at), 1e-4 * jnp.eye(2)
    expected = [(loss(at + step) - loss(at - step)) / 2e-4 for step in steps]
    assert np.abs(expected).min() > 1e-6
    np.testing.assert_allclose(slope, expected, rtol=1e-4)


def test_the_start_is_a_program_of_single_numbers(standing):
    """As a kernel on a GPU makes it, with slopes, too."""
    params = parameters.cast(rested(), float)
    signals = Signals(jnp.asarray(standing.specific_force), jnp.asarray(standing.angular_rate))
    inputs = IEZ.prepare(params, {"foot": signals}, jnp.asarray(standing.dt), RATE)
    both = Dual(params, parameters.with_leaves(jax.tree.map(lambda x: None, params), {"initial.sway": 1.0}))
    both = both._replace(slope=jax.tree.map(jnp.asarray, both.slope))

    def plain(p, opening):
        return IEZ.start(p, None, opening)

    def sloping(p, opening):
        return dual(lambda q: plain(q, opening), p)

    for advance, start, given in (
        (advance_of(IEZ), plain, params),
        (tangents(advance_of(IEZ)), sloping, both),
    ):
        trees = {"parameter": given, "opening": inputs.opening}
        like = {
            k: jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), v) for k, v in trees.items()
        }
        state = start(given, inputs.opening)
        sample = jax.tree.map(lambda x: x[0], inputs.samples)
        made = program(advance, given, state, sample)
        begun = beginning(start, like["parameter"], like["opening"], made)
        flat = {k: [np.asarray(x).reshape(-1) for x in jax.tree.leaves(v)] for k, v in trees.items()}
        leaves = [np.asarray(x).reshape(-1) for x in jax.tree.leaves(state)]
        found = evaluate(
            begun.graph,
            list(begun.nodes),
            lambda name, flat=flat: flat[name.tree][name.place.leaf][name.place.at],
            with_numpy,
        )
        expected = [leaves[place.leaf][place.at] for place in made.carried]
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-14)
