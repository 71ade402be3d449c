"""Disturbed copies to tune on: what is added, what is not touched, and on which side they stay."""

import tomllib
from dataclasses import asdict, replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pedjax
from pedjax import parameters
from pedjax.cli.main import main
from pedjax.config import load, tune_settings
from pedjax.errors import InputError
from pedjax.identity import fingerprint, walk_fingerprint
from pedjax.readers import write_csv
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth, inertial
from pedjax.tuning import Augment, TuneSettings, disturbed, loop, refuse_overlap, split, tune
from pedjax.tuning.augment import copies_of, magnets, with_copies
from tests.reference import walk as reference
from tests.toy import pocket

SOME = Augment(copies=2, off=2.0, on=2.0)
WITHOUT_IRON = replace(SOME, iron=0.0)


def still(name="still", seconds=20.0, seed=0, rate=50.0):
    """A sensor at rest in a steady field, not measured from 8 to 12 s, beside one without a compass."""
    time = np.arange(0.0, seconds, 1 / rate)
    rng = np.random.default_rng(seed)
    force = Stream(time, rng.normal([0.0, 0.0, 9.81], 0.01, (len(time), 3)))
    turn = Stream(time, rng.normal(0, 0.001, (len(time), 3)))
    known = time[(time < 8.0) | (time > 12.0)]
    compass = Stream(known, rng.normal([20.0, 5.0, -43.0], 0.1, (len(known), 3)))
    return Recording(
        name,
        {"foot": Sensor(force, turn, compass), "waist": Sensor(force, turn)},
        landmarks=Landmarks([0.5, 1.5], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        truth=Truth(time, np.zeros((len(time), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))),
    )


def added(copy, recording, kind="magnetometer", sensor="foot"):
    return getattr(copy.sensor(sensor), kind).values - getattr(recording.sensor(sensor), kind).values


def test_same_seed_same_bits_and_other_copies_are_independent():
    recording = still()
    first, again = disturbed(recording, SOME, 1), disturbed(still(), SOME, 1)
    np.testing.assert_array_equal(added(first, recording), added(again, recording))
    others = [
        disturbed(recording, SOME, 2),
        disturbed(recording, replace(SOME, seed=1), 1),
        disturbed(still("other"), SOME, 1),
    ]
    for other in others:
        assert abs(added(other, recording) - added(first, recording)).max() > 1.0


def test_more_copies_or_a_bias_leave_the_magnets_as_they_are():
    recording = still()
    first = disturbed(recording, SOME, 1)
    for change in ({"copies": 5}, {"bias": 0.01}):
        other = disturbed(recording, replace(SOME, **change), 1)
        np.testing.assert_array_equal(added(other, recording), added(first, recording))


def test_all_but_the_field_stays_and_the_recording_is_not_changed():
    recording = still()
    prints, before = fingerprint(recording), recording.sensor().magnetometer.values.copy()
    copy = disturbed(recording, SOME, 1)
    assert copy.name == "still+magnets1"
    assert copy.truth is recording.truth
    assert copy.landmarks is recording.landmarks
    for name in recording.sensors:
        for kind in ("accelerometer", "gyroscope"):
            assert getattr(copy.sensor(name), kind) is getattr(recording.sensor(name), kind)
    assert copy.sensor("waist").magnetometer is None
    assert any("nobody measured" in finding for finding in copy.findings)
    np.testing.assert_array_equal(recording.sensor().magnetometer.values, before)
    assert fingerprint(recording) == prints


def test_a_gap_of_the_magnetometer_stays_a_gap():
    recording = still()
    field, other = (inertial(r).magnetic_field for r in (recording, disturbed(recording, SOME, 1)))
    assert np.isnan(field).any()
    np.testing.assert_array_equal(np.isnan(other), np.isnan(field))


def test_magnets_are_as_strong_and_as_often_there_as_asked():
    time = np.arange(0.0, 6000.0, 0.05)
    asked = Augment(copies=1, low=20.0, high=80.0, on=4.0, off=10.0, rise=0.5)
    size = np.linalg.norm(magnets(time, asked, np.random.default_rng(0)), axis=1)
    begins = [np.linalg.norm(magnets(time[:2], asked, np.random.default_rng(n))[0]) > 10 for n in range(300)]
    assert np.mean(begins) == pytest.approx(4 / 14, abs=0.08)
    peaks = np.array([size[a:b].max() for a, b in _stays(size)])[1:-1]  # the last may only begin
    assert len(peaks) == pytest.approx(6000 / 14, rel=0.1)
    assert peaks.min() > 0.95 * 20.0  # no sample may lie on the top of a short one
    assert peaks.max() <= 80.0 + 1e-9
    assert np.median(peaks) == pytest.approx(40.0, rel=0.12)  # evenly on a log scale
    assert np.mean(size > 10.0) == pytest.approx(4 / 14, rel=0.12)
    assert abs(np.diff(size)).max() < 80.0 * 1.6 * 0.05 / 0.5  # comes and goes smoothly


def _stays(size):
    """First and last (exclusive) samples of each stretch with a magnet."""
    return np.flatnonzero(np.diff(np.concatenate([[0], size > 0, [0]]))).reshape(-1, 2)


def test_half_of_the_magnets_are_fixed_to_the_body_and_half_turn_slowly():
    time = np.arange(0.0, 20000.0, 0.05)
    field = magnets(time, Augment(copies=1, off=30.0), np.random.default_rng(1))
    size = np.linalg.norm(field, axis=1)
    turns = []
    for a, b in _stays(size):
        direction = field[a:b] / size[a:b, None]
        steps = np.linalg.norm(np.diff(direction, axis=0), axis=1)
        turns.append(steps.max(initial=0.0) / 0.05)  # rad/s
    fixed = np.array(turns) < 1e-9
    assert np.mean(fixed) == pytest.approx(0.5, abs=0.08)
    assert np.percentile(turns, 99) < 3.0  # two that touch are one here
    assert np.median(np.array(turns)[~fixed]) == pytest.approx(0.5, abs=0.3)


def test_iron_and_bias_are_constant_and_of_the_asked_size():
    recording = still(seconds=2.0)
    asked = replace(SOME, off=1e4, iron=9.0, bias=0.01)  # no magnet comes in two seconds
    copies = [disturbed(recording, asked, k) for k in range(1, 301)]
    for kind, sensor, size in (("magnetometer", "foot", 9.0), ("gyroscope", "waist", 0.01)):
        errors = np.stack([added(copy, recording, kind, sensor) for copy in copies])
        assert np.ptp(errors, axis=1).max() < 1e-9
        np.testing.assert_allclose(errors[:, 0].std(axis=0), size, rtol=0.15)
        assert np.all(abs(errors[:, 0].mean(axis=0)) < 4 * size / np.sqrt(300))


def test_each_sensor_has_its_own_magnets():
    one = still()
    both = replace(one, sensors={"foot": one.sensor(), "waist": one.sensor()})
    copy = disturbed(both, WITHOUT_IRON, 1)
    assert abs(added(copy, both) - added(copy, both, sensor="waist")).max() > 1.0
    np.testing.assert_array_equal(added(copy, both), added(disturbed(one, WITHOUT_IRON, 1), one))


def test_a_copy_is_the_same_walk_where_recordings_are_held_back():
    walks = [still(f"walk{k}", seed=k) for k in range(4)]
    copies = copies_of(walks, SOME)
    assert [c.name for c in copies[:3]] == ["walk0+magnets1", "walk0+magnets2", "walk1+magnets1"]
    assert fingerprint(copies[0]) != fingerprint(walks[0])
    assert walk_fingerprint(copies[0]) == fingerprint(walks[0])
    assert walk_fingerprint(disturbed(copies[0], SOME, 1)) == fingerprint(walks[0])
    assert walk_fingerprint(replace(copies[0], name="other")) == fingerprint(walks[0])
    sides = split([*walks, *copies], 0.5)
    first, second = ({walk_fingerprint([*walks, *copies][i]) for i in side} for side in sides)
    assert not first & second
    with pytest.raises(InputError, match="walk0 was tuned on"):
        refuse_overlap([walk_fingerprint(copies[0])], walks)
    with pytest.raises(InputError, match=r"is a disturbed copy.*hold back the recording"):
        refuse_overlap([], [copies[5]])


@pytest.mark.parametrize("count", [2, 3, 8])
def test_copies_are_on_the_side_of_their_recording(count):
    settings = TuneSettings(("gravity",), validation=0.4, augment=Augment(copies=2))
    training, validation = loop._part(count, settings)
    assert sorted([*training, *validation]) == list(range(3 * count))
    names = [f"walk{k}" for k in range(count)]
    names += [f"{name}+magnets{c}" for name in names for c in (1, 2)]
    sides = [{names[i].partition("+")[0] for i in side} for side in (training, validation)]
    assert not sides[0] & sides[1]
    assert all(len(side) == 3 * len(walks) for side, walks in zip((training, validation), sides, strict=True))
    assert loop._part(count, replace(settings, augment=Augment())) == (
        [i for i in training if i < count],
        [i for i in validation if i < count],
    )
    assert with_copies([1], count, Augment()) == [1]


@pytest.fixture(scope="module")
def made():
    """Two tiny walks of a foot, which plays the pocket and the waist, in a homogeneous field."""
    field = np.array([0.0, 21.0, -43.0])

    def tiny(seed):
        found = reference.walk(8.0, 50.0, seed)
        time = np.cumsum(found.dt)
        quaternion = Rotation.from_matrix(found.attitude).as_quat()[:, [3, 0, 1, 2]]
        sensor = Sensor(
            Stream(time, found.specific_force),
            Stream(time, found.angular_rate),
            Stream(time, np.einsum("tij,i->tj", found.attitude, field)),
        )
        truth = Truth(time, found.position, quaternion)
        return Recording(f"tiny:{seed}", {"pocket": sensor, "waist": sensor}, truth=truth)

    return [tiny(seed) for seed in (1, 2)], pocket.Site(jnp.asarray(field))


def test_tuning_uses_copies_and_reports_only_recordings(made):
    walks, site = made
    asked = Augment(copies=2, off=2.0, low=50.0)
    settings = TuneSettings(
        ("field.sigma",), loss="heading_rms", iterations=2, starts=1, grid=0, check_every=1, validation=0.5,
        mode="forward", augment=asked,
    )  # fmt: skip
    poor = parameters.replace(
        pocket.PocketParameters(), {"field.threshold": 1000.0, "gravity.threshold": 4.0}
    )
    found = tune(walks, settings, "toy_pocket", poor, site=site)
    for report, params in ((found.before, poor), (found.after, found.params)):
        assert list(report["tuned_on"]) == [walk.name for walk in walks]
        for walk in walks:
            track = pedjax.run(walk, "toy_pocket", params, site=site)
            own = pedjax.evaluate(track, walk).heading_rms_deg
            assert report["tuned_on"][walk.name] == pytest.approx(own, rel=0.05)  # of points at 10 Hz
    assert found.fingerprints == tuple(fingerprint(walk) for walk in walks)
    for side, walk in zip(("training", "validation"), _by_side(walks), strict=True):
        near = [walk, *copies_of([walk], asked)]
        tracks = [pedjax.run(r, "toy_pocket", poor, site=site) for r in near]
        errors = [pedjax.evaluate(t, r).heading_rms_deg for t, r in zip(tracks, near, strict=True)]
        assert max(errors[1:]) > 1.5 * errors[0]
        assert found.history[0][side][0] == pytest.approx(np.mean(errors), rel=0.05)


def _by_side(walks):
    training, validation = loop._part(2, TuneSettings(("gravity",), validation=0.5))
    return [walks[training[0]], walks[validation[0]]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"copies": -1}, r"tune\.augment\.copies = -1 must be a whole number between 0"),
        ({"copies": 1.5}, r"tune\.augment\.copies = 1\.5 must be a whole number"),
        ({"low": 0.0}, r"tune\.augment\.low = 0\.0 must be between"),
        ({"high": float("nan")}, r"tune\.augment\.high = nan must be between"),
        (
            {"low": 100.0, "high": 50.0},
            r"tune\.augment\.low = 100 must not be above tune\.augment\.high = 50",
        ),
        ({"rise": 5.0}, r"tune\.augment\.rise = 5 must not be longer than tune\.augment\.on = 2"),
        ({"iron": "much"}, r"tune\.augment\.iron = 'much' must be between"),
        ({"bias": 1.0}, r"tune\.augment\.bias = 1\.0 must be between"),
    ],
)
def test_settings_that_make_no_magnets_are_refused(change, message):
    bad = replace(SOME, **change)
    with pytest.raises(InputError, match=message):
        disturbed(still(), bad, 1)
    with pytest.raises(InputError, match=message):
        tune([still()], TuneSettings(("gravity",), augment=bad))


def test_what_has_no_magnetometer_is_refused_with_a_remedy():
    recording = still()
    bare = replace(recording, sensors={"foot": recording.sensor("waist")})
    with pytest.raises(InputError, match=r"no magnetometer.*tune\.augment\.copies = 0"):
        disturbed(bare, SOME, 1)
    with pytest.raises(InputError, match=r"'iez' does not use a magnetometer.*another --system \(.*ma2018"):
        tune([recording], TuneSettings(("gravity",), augment=SOME))
    with pytest.raises(InputError, match=r"no magnetometer"):
        tune([bare], TuneSettings(("field.sigma",), augment=SOME), "toy_pocket", sensor={"pocket": "foot"})


def test_a_field_that_magnets_drown_says_which_settings_to_lower():
    drowned = Augment(copies=1, low=900.0, high=1000.0, on=1000.0, off=0.5)
    with pytest.raises(InputError, match=r"tune\.augment: lower its high"):
        copies_of([still()], replace(drowned, copies=20))


def test_configs_reach_it_key_by_key(tmp_path):
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text('system = "ma2018"\nseed = 7\n[tune.augment]\ncopies = 1\nhigh = 80\n')
    second.write_text("[tune.augment]\ncopies = 3\n")
    assert tune_settings(load(first, second)).augment == Augment(copies=3, high=80.0, seed=7)
    assert tune_settings(load()).augment == Augment()
    for text, message in (
        ("[tune.augment]\ncopys = 1\n", r"'tune\.augment\.copys' is unknown; did you mean 'copies'"),
        ("[tune.augment]\ncopies = 1.5\n", r"tune\.augment\.copies = 1\.5 must be of the kind of 0"),
        ("[tune]\naugment = 2\n", r"tune\.augment must be a table"),
    ):
        first.write_text(text)
        with pytest.raises(InputError, match=message):
            load(first)


def test_command_line_reaches_it(made, tmp_path, capsys):
    walks, site = made
    table, place, out = tmp_path / "walk.csv", tmp_path / "place.toml", tmp_path / "out"
    write_csv(walks[0], table)
    place.write_text(f"field = {np.asarray(site.field).tolist()}\n")
    given = ["--with", pocket.__file__, "--system", "toy_pocket", "--map", place, "--names", "field.sigma"]
    sets = ("loss=heading_rms", "iterations=1", "starts=1", "grid=0", "mode=forward", "augment.off=2")
    given += [x for setting in sets for x in ("--set", f"tune.{setting}")]
    args = ["tune", table, *given, "--augment", 1, "--out", out, "--no-figures"]
    assert main([str(a) for a in args]) == 0, capsys.readouterr().err
    written = tomllib.loads((out / "config.toml").read_text())["tune"]["augment"]
    assert written == asdict(Augment(copies=1, off=2.0))
    assert "on 1 recordings and 1 disturbed copies of each" in (out / "tuned.toml").read_text()
    assert "tuned on (1 recordings)" in capsys.readouterr().out
    assert main([str(a) for a in [*args[:2], *given, "--augment", -1]]) == 1
    assert "tune.augment.copies = -1" in capsys.readouterr().err
