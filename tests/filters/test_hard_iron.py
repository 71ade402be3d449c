"""Hard iron tracked while moving: against a dense filter, on simulated boards and on real ones."""

import dataclasses
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from experiments import broad_magnets
from pedjax import parameters
from pedjax.filters.hard_iron import HardIron, HardIronParameters, offset_steps, start, step, track_hard_iron
from tests.reference import hard_iron as oracle

HZ = 50.0
MAGNET = np.array([-6.5, -1.1, 58.0])
NONE = np.zeros(3)
tracked = jax.jit(track_hard_iron)


def made(**changes):
    return parameters.cast(parameters.replace(HardIronParameters(), changes), jnp.float64)


def track(board, **changes):
    return HardIron(*map(np.asarray, tracked(board.rate, board.reading, board.dt, made(**changes))))


def with_magnet(seconds=30.0, on=10.0, off=20.0, offset=MAGNET, seed=3, hz=HZ, **kind):
    """A board on which a magnet is put, and taken off again, while it turns."""
    truth = oracle.switched(round(seconds * hz), hz, on, off, offset)
    return oracle.board(seconds, hz, seed, truth, **kind), truth


def test_equals_the_dense_filter():
    board, _ = with_magnet(16.0, 6.0, 11.0, lag=2)
    board.reading[200:230] = np.nan
    expected = oracle.run(*board[2:4], board.dt, oracle.Settings(lag=0.04))
    assert 0.0 < expected[2].mean() < 0.2
    for ours, theirs in zip(track(board, lag=0.04), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_parameters_equal_those_of_the_dense_filter():
    values = parameters.values(HardIronParameters())
    assert values.pop("width") == 0.0
    assert values.pop("straight_through") is False
    assert values == oracle.Settings()._asdict()


@pytest.mark.parametrize("seed", range(3))
def test_an_offset_from_the_start_is_found_by_turning(seed):
    """As well as sigma says, and not at rest."""
    offset = np.array([20.0, -35.0, 10.0])
    board = oracle.board(20.0, HZ, seed, np.tile(offset, (1000, 1)), rest=5.0, speed=2.0)
    found = track(board, initial_offset=50.0)
    at_rest = round(4.5 * HZ)
    assert found.sigma[at_rest].min() > 15.0
    assert np.linalg.norm(found.offset[-1] - offset) < 0.6
    late = slice(round(10 * HZ), None)
    assert np.mean(((found.offset - offset) / found.sigma)[late] ** 2) < 2.0
    assert offset_steps(board.time, found) == []


@pytest.mark.parametrize("offset", [MAGNET, np.array([4.0, -2.0, 3.0])])
@pytest.mark.parametrize("seed", range(3))
def test_a_magnet_is_found_within_three_seconds(offset, seed):
    board, _ = with_magnet(offset=offset, seed=seed, speed=2.0)
    on, off = offset_steps(board.time, track(board))
    for change, there, before, after in ((on, 11.0, NONE, offset), (off, 21.0, offset, NONE)):
        assert there < change.time < there + 3.0
        assert np.linalg.norm(change.before - before) < 2.0
        assert np.linalg.norm(change.after - after) < 2.0


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_where_nothing_is(seed):
    board = oracle.board(40.0, HZ, seed, np.zeros((2000, 3)), speed=(1.0, 4.0)[seed % 2])
    found = track(board)
    assert found.jump.mean() < 0.005
    assert offset_steps(board.time, found) == []


def test_at_rest_a_magnet_makes_unsure_and_turning_tells():
    """A field that changes about a board at rest: put on the board, or laid beside and left behind."""
    on_board, truth = with_magnet(24.0, 6.0, 99.0, rest=12.0, speed=2.0)
    beside = oracle.board(24.0, HZ, 3, 0 * truth, rest=12.0, speed=2.0)
    passing = oracle.switched(1200, HZ, 6.0, 12.5, MAGNET)
    beside = beside._replace(reading=beside.reading + passing)
    for board, changes in ((on_board, 1), (beside, 0)):
        found = track(board)
        assert found.sigma[round(11.5 * HZ)].min() > 5.0
        assert len(offset_steps(board.time, found)) == changes


def test_the_rate_of_sampling_does_not_matter():
    slow, _ = with_magnet(speed=2.0)
    fast, _ = with_magnet(speed=2.0, hz=200.0)
    for at, after in ((18.0, MAGNET), (29.0, NONE)):
        for board, hz in ((slow, HZ), (fast, 200.0)):
            found = track(board)
            assert np.linalg.norm(found.offset[round(at * hz)] - after) < 1.2
            assert 0.1 < found.sigma[round(at * hz)].max() < 0.6


def test_lag_unaccounted_for_spoils_it():
    board = oracle.board(30.0, 200.0, 1, np.zeros((6000, 3)), speed=4.0, lag=3)
    blind, told = track(board), track(board, lag=0.015)
    assert np.abs(told.offset[1600:]).max() < 1.0 < np.abs(blind.offset[1600:]).max()


def test_causal_in_chunks_and_in_lanes():
    board, _ = with_magnet(12.0, 5.0, 99.0)
    whole = track(board)
    half = track(board._replace(**{name: getattr(board, name)[:300] for name in board._fields}))
    for short, long in zip(half, whole, strict=True):
        np.testing.assert_array_equal(short, long[:300])

    params = made()
    state = start(params, jnp.asarray(board.reading[0]))
    ours = jax.jit(step)
    for k in range(60):
        state = ours(params, state, *(jnp.asarray(x[k]) for x in (board.rate, board.reading, board.dt)))
    np.testing.assert_allclose(state.offset, whole.offset[59], atol=1e-10)

    wide = dataclasses.replace(
        made(), threshold=jnp.array([30.0, 60.0])[:, None], lag=jnp.array([0.0, 0.01, 0.02])
    )
    lanes = jax.jit(track_hard_iron)(board.rate, board.reading, board.dt, wide)
    assert lanes.offset.shape == (600, 3, 2, 3)
    np.testing.assert_allclose(lanes.offset[..., 0, 0], whole.offset, atol=1e-9)
    one = track(board, threshold=60.0, lag=0.02)
    np.testing.assert_allclose(lanes.sigma[..., 1, 2], one.sigma, atol=1e-9)


def test_single_precision_is_enough():
    board, _ = with_magnet(20.0, 8.0, 14.0, speed=2.0)
    single = tracked(
        *(jnp.asarray(x, jnp.float32) for x in (board.rate, board.reading, board.dt)),
        parameters.cast(HardIronParameters(), jnp.float32),
    )
    double = track(board)
    assert np.isfinite(single.sigma).all()
    late = slice(-100, None)
    np.testing.assert_allclose(single.offset[late], double.offset[late], atol=0.05)


def test_gradient_equals_differences():
    """Of the squared error, by every parameter and by the readings, with a soft gate."""
    board, truth = with_magnet(8.0, 3.0, 99.0, rest=0.5, lag=1)
    board.reading[100:105] = np.nan
    point = made(width=0.5, lag=0.013, bias=1e-3)

    @jax.jit
    @jax.value_and_grad
    def loss(p):
        found = track_hard_iron(board.rate, board.reading, board.dt, p)
        return jnp.mean((found.offset - truth) ** 2 + found.sigma)

    slopes = parameters.values(loss(point)[1])
    for name, value in parameters.values(point).items():
        h = 1e-5 * float(value)
        up, down = (parameters.with_leaves(point, {name: value + d}) for d in (h, -h))
        numeric = (loss(up)[0] - loss(down)[0]) / (2 * h)
        np.testing.assert_allclose(slopes[name] * value, numeric * value, rtol=2e-5, atol=1e-7, err_msg=name)


@pytest.fixture(scope="module")
def broad():
    """Every trial at hand through the filter, with lag and field from the undisturbed ones."""
    folder = os.environ.get("PEDJAX_DATA")
    if not folder or not (Path(folder) / "broad").is_dir():
        pytest.skip("PEDJAX_DATA does not name a folder with broad/")
    files = sorted((Path(folder) / "broad").glob("*.mat"))
    recordings = {path.stem[:2]: pedjax.read(str(path)) for path in files}
    if not {"02", "21"} <= set(recordings):
        pytest.skip("no undisturbed trials, 02 and 21, in broad/ of PEDJAX_DATA")
    lag = 0.013  # what lag_of finds on 02 and 21
    earth = broad_magnets.earth_field([recordings["02"], recordings["21"]], lag)
    wanted = {"02", "21", "28", "32", "36"} & set(recordings)
    return {trial: broad_magnets.find(recordings[trial], lag, earth) for trial in sorted(wanted)}


@pytest.mark.parametrize(
    ("trial", "offset"), [("32", MAGNET), ("36", np.array([0.2, -0.2, -5.8]))], ids=["1cm", "5cm"]
)
def test_real_magnets_are_found_within_three_seconds(broad, trial, offset):
    """Put on at rest, so seen from the first turn on; taken off while moving."""
    if trial not in broad:
        pytest.skip(f"trial {trial} is not in broad/ of PEDJAX_DATA")
    pairs = broad_magnets.matched(broad[trial])
    assert len(pairs) == 2
    for (switch, change), after in zip(pairs, (offset, NONE), strict=True):
        assert switch is not None
        assert change is not None
        assert np.linalg.norm(switch.offset - after) < 1.0
        assert 0.0 < change.time - switch.seen < 3.0
        assert np.linalg.norm(change.after - switch.offset) < 2.0


@pytest.mark.parametrize("trial", ["02", "21", "28"])
def test_no_real_magnet_is_found_where_none_is(broad, trial):
    """Not on an undisturbed board, nor where the magnet lies in the room."""
    if trial not in broad:
        pytest.skip(f"trial {trial} is not in broad/ of PEDJAX_DATA")
    assert broad[trial].steps == []
    assert broad[trial].switches == []
