"""Recordings packed together give what each gives alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import filtering, parameters
from pedjax.ensemble import Problem, losses
from pedjax.errors import InputError
from pedjax.packing import alike, pack, pack_all
from pedjax.preparing import prepare
from pedjax.recording import Inertial, Landmarks
from pedjax.shapes import bucket
from pedjax.system import Status
from pedjax.systems import SYSTEMS
from pedjax.walks import Walk, points_of, reference_of, walk
from tests import tools

IEZ = SYSTEMS["iez"]
scan_points = jax.jit(filtering.scan_points, static_argnums=(0, 3))


@pytest.fixture(scope="module")
def params():
    return tools.iez(gate__width=0.25)


@pytest.fixture(scope="module")
def batch(demos, params):
    return pack(IEZ, parameters.cast(params, float), [walk(r) for r in demos])


@pytest.fixture(scope="module")
def alone(demos, params):
    return [pedjax.run(r, params=params) for r in demos]


def at_points(tracks, demos):
    return [t.position[walk(r).index] for t, r in zip(tracks, demos, strict=True)]


def test_packed_recordings_equal_each_alone(batch, demos, params, alone):
    points = scan_points(IEZ, parameters.cast(params, float), batch.packed, batch.slots)
    estimates = np.asarray(batch.estimates(points)["position"])
    for r, expected in enumerate(at_points(alone, demos)):
        np.testing.assert_allclose(estimates[: len(expected), :, r], expected, atol=1e-10)
        np.testing.assert_allclose(
            batch.reference.position[: len(expected), :, r], demos[r].landmarks.position
        )
        assert (
            np.asarray(batch.reference.horizontal)[:, r].cumsum()
            == np.minimum(np.arange(1, len(estimates) + 1), len(expected))
        ).all()
    assert (np.asarray(batch.status(points)) == 0).all()
    total = sum(t.gates["stance"].weight.sum() for t in alone)
    padding = np.asarray(points.gates["stance"]).sum() - total
    assert abs(padding) < 1e-6


def test_lanes_equal_one_by_one(batch, demos, params):
    thresholds = np.array([1e7, 8.5e7, 5e8])
    cast = parameters.cast(params, float)
    lanes = parameters.with_leaves(cast, {"stance.shoe.threshold": jnp.asarray(thresholds)[:, None]})
    points = scan_points(IEZ, lanes, batch.packed, batch.slots)
    estimates = np.asarray(batch.estimates(points)["position"])
    assert estimates.shape == (len(batch.rows), 3, 3, len(demos))
    assert batch.status(points).shape == (3, len(demos))
    for s, threshold in enumerate(thresholds):
        one = parameters.with_leaves(cast, {"stance.shoe.threshold": jnp.asarray(threshold)})
        single = scan_points(IEZ, one, batch.packed, batch.slots)
        np.testing.assert_allclose(estimates[:, :, s], batch.estimates(single)["position"], atol=1e-10)


def test_points_lie_at_the_nearest_samples(demos):
    made = walk(demos[0])
    gap = np.abs(made.imu.time[made.index] - demos[0].landmarks.time)
    assert gap.max() <= 0.5 / demos[0].sensor().gyroscope.rate + 1e-12
    between = replace(demos[0], landmarks=Landmarks(np.array([1.0024, 1.0026]), np.zeros((2, 3))))
    np.testing.assert_array_equal(walk(between).index, [200, 201])


def test_two_landmarks_on_one_sample(demos, params):
    time = np.array([3.0, 6.0, 6.0, 6.001, 8.0])
    twice = replace(demos[0], landmarks=Landmarks(time, np.arange(15.0).reshape(5, 3)))
    made = walk(twice)
    assert made.index[1] == made.index[2] == made.index[3]
    cast = parameters.cast(params, float)
    batch = pack(IEZ, cast, [made, walk(demos[1])])
    estimates = np.asarray(batch.estimates(scan_points(IEZ, cast, batch.packed, batch.slots))["position"])
    track = pedjax.run(twice, params=params)
    np.testing.assert_allclose(estimates[:5, :, 0], track.position[made.index], atol=1e-10)


def test_a_broken_recording_spoils_no_other(demos, params):
    """The third of four is driven out of the numbers; the others, before and after it, do not notice."""
    walks = [walk(r) for r in demos]
    imu = walks[2].imu
    force = imu.specific_force.copy()
    force[len(force) // 2] = 1e200
    walks[2] = replace(walks[2], sensors={"foot": replace(imu, specific_force=force)})
    cast = parameters.cast(params, float)
    batch = pack(IEZ, cast, walks)
    assert (batch.columns == batch.columns[2]).sum() > 1 or len(set(batch.columns)) < 4
    points = scan_points(IEZ, cast, batch.packed, batch.slots)
    np.testing.assert_array_equal(batch.status(points), [0, 0, Status.DIVERGED, 0])
    estimates = np.asarray(batch.estimates(points)["position"])
    for r in (0, 1, 3):
        expected = pedjax.run(demos[r], params=params).position[walks[r].index]
        np.testing.assert_allclose(estimates[: len(expected), :, r], expected, atol=1e-10)


def tiny(count, rng):
    """A walk of that many samples, to count padding only."""
    time = np.arange(count) / 100.0
    signal = np.tile([0.0, 0.0, 9.8], (count, 1))
    return Walk(
        str(count),
        {"foot": Inertial(time, np.full(count, 0.01), signal, 0 * signal)},
        np.array([count - 1]),
        np.zeros((1, 3)),
    )


@pytest.mark.parametrize("spread", [1.2, 4.0])
def test_padding_adds_less_than_a_fifth(rng, spread):
    lengths = np.exp(rng.uniform(np.log(2500), np.log(2500 * spread), 24)).astype(int)
    batch = pack(IEZ, parameters.cast(tools.iez(), float), [tiny(n, rng) for n in lengths])
    assert batch.steps < 1.2 * lengths.sum()
    assert batch.steps == batch.packed.slot.size


def test_one_recording_alone_wastes_a_chunk_and_a_sixteenth_at_most(demos, params):
    made = walk(demos[0])
    batch = pack(IEZ, parameters.cast(params, float), [made])
    assert batch.steps <= 17 / 16 * (len(made.imu.time) + 1.2 * len(made.imu.time) ** 0.5)


def test_recordings_of_about_the_same_length_have_one_shape(demos, params):
    cast = parameters.cast(params, float)
    shapes = [
        jax.tree.map(jnp.shape, pack(IEZ, cast, [walk(tools.crop(demos[1], seconds))]))
        for seconds in (18.9, 18.6)
    ]
    assert jax.tree.leaves(shapes[0]) == jax.tree.leaves(shapes[1])
    assert jax.tree.structure(shapes[0]) == jax.tree.structure(shapes[1])


def test_buckets_are_few_and_close():
    lengths = np.arange(1, 20000)
    buckets = np.array([bucket(int(n)) for n in lengths])
    assert (buckets >= lengths).all()
    assert (buckets <= np.ceil(lengths * 1.125)).all()
    assert len(np.unique(buckets[lengths > 1000])) < 40


def test_padding_leaves_the_samples_alone(demos, params):
    cast = parameters.cast(params, float)
    made = tools.cropped(walk(demos[0]), 0, 500)
    alone, padded = (prepare(IEZ, cast, made, float, n) for n in (500, 640))
    for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(padded), strict=True):
        np.testing.assert_array_equal(a, b[: len(a)])
    assert (np.asarray(padded.samples.sensor.dt)[500:] == 0).all()


def test_dense_truth_is_thinned(demos):
    recording = replace(demos[0], landmarks=None)
    imu = walk(recording).imu
    every, _ = points_of(recording, imu.time, None)
    some, position = points_of(recording, imu.time, 10.0)
    assert len(every) == len(imu.time)
    assert len(some) == pytest.approx(len(every) / 20, abs=1)
    np.testing.assert_allclose(position, recording.truth.position[some])


def test_unknown_coordinates_weigh_nothing():
    reference = reference_of(np.array([[1.0, 2.0, np.nan], [np.nan, np.nan, 3.0], [4.0, 5.0, 6.0]]))
    np.testing.assert_array_equal(reference.horizontal, [1, 0, 1])
    np.testing.assert_array_equal(reference.vertical, [0, 1, 1])
    assert np.isfinite(reference.position).all()


def test_recordings_of_several_rates_keep_their_order(demos, minute_recording):
    """The rule looks at as many windows as a window has samples: another rate, another tree."""
    slow = tools.crop(minute_recording, 12.0, "slow")
    params = parameters.cast(tools.iez(stance__rule="any"), float)
    walks = [walk(r) for r in (demos[2], slow, demos[0])]
    assert alike(walks) == [[0, 2], [1]]
    batches = pack_all(IEZ, params, walks)
    assert [len(part.samples) for part in batches.parts] == [2, 1]
    windows = [part.packed.samples.own["zero_velocity"].shape[1] for part in batches.parts]
    assert windows == [5, 2]
    problem = Problem(IEZ, "rms_2d", "none")
    values = {"stance.shoe.threshold": jnp.array([1e7, 1e8])}
    found = np.asarray(losses(problem, params, values, batches))
    assert found.shape == (2, 3)
    assert np.isfinite(found).all()
    assert len(np.unique(found)) == found.size
    for r, one in enumerate(walks):
        alone = losses(problem, params, values, pack_all(IEZ, params, [one]))
        np.testing.assert_allclose(found[:, r], np.asarray(alone)[:, 0], rtol=1e-10)
    with pytest.raises(InputError, match=r"demo:2 at 200 Hz, slow at 100 Hz, .* take pack_all"):
        pack(IEZ, params, walks)


def test_nothing_to_pack():
    with pytest.raises(InputError, match="no recording"):
        pack(IEZ, tools.iez(), [])
