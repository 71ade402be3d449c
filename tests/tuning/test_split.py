"""Which recordings are held back: by content, not by name or order."""

from dataclasses import replace

import numpy as np
import pytest

from pedjax import split
from pedjax.errors import InputError
from pedjax.identity import fingerprint
from pedjax.recording import Stream
from pedjax.tuning.split import refuse_overlap
from tests import tools


def test_fingerprint_is_of_the_samples_alone(demos):
    prints = [fingerprint(r) for r in demos]
    assert len(set(prints)) == len(demos)
    assert fingerprint(replace(demos[0], name="other", landmarks=None)) == prints[0]
    assert fingerprint(tools.crop(demos[0], 11.0)) != prints[0]
    assert fingerprint(shifted(demos[0], 1.7e9)) == prints[0]


def changed(recording, kind, change):
    """The recording with another stream of that kind on its first sensor."""
    name, sensor = next(iter(recording.sensors.items()))
    sensor = replace(sensor, **{kind: change(getattr(sensor, kind))})
    return replace(recording, sensors={**recording.sensors, name: sensor})


def shifted(recording, seconds):
    sensor = recording.sensor()
    later = {
        kind: Stream(stream.time + seconds, stream.values)
        for kind in ("accelerometer", "gyroscope", "magnetometer")
        for stream in [getattr(sensor, kind)]
    }
    return replace(recording, sensors={"foot": replace(sensor, **later)}, landmarks=None, truth=None)


def with_field(recording, turned_deg=0.0):
    """A field of 48 microtesla in body axes, turned about z."""
    angle = np.radians(turned_deg)
    time = recording.sensor().gyroscope.time
    field = np.tile([20 * np.cos(angle), 20 * np.sin(angle), -43.0], (len(time), 1))
    return changed(recording, "magnetometer", lambda _: Stream(time, field))


OTHER = {
    "field": lambda r: with_field(r, 90.0),
    "no field": lambda r: changed(r, "magnetometer", lambda _: None),
    "a last bit": lambda r: changed(r, "gyroscope", lambda s: Stream(s.time, s.values * (1 + 2**-50))),
    "time": lambda r: changed(r, "gyroscope", lambda s: Stream(1.001 * s.time, s.values)),
    "clock of the field": lambda r: changed(r, "magnetometer", lambda s: Stream(s.time + 0.01, s.values)),
    "name of the sensor": lambda r: r.renamed({"foot": "waist"}),
}


@pytest.mark.parametrize("what", OTHER)
def test_fingerprint_tells_all_that_was_measured(demos, what):
    first = with_field(demos[0])
    other = OTHER[what](first)
    assert fingerprint(other) != fingerprint(first)
    refuse_overlap([fingerprint(first)], [other])
    with pytest.raises(InputError, match="was tuned on"):
        refuse_overlap([fingerprint(first), fingerprint(other)], [other])


def test_split_covers_all_and_depends_on_no_order(demos):
    for seed in range(5):
        first, second = split(demos, 0.5, seed)
        assert sorted(first + second) == [0, 1, 2, 3]
        assert len(first) == 2
        again, _ = split(demos[::-1], 0.5, seed)
        assert sorted(3 - i for i in again) == first
    assert len({tuple(split(demos, 0.5, seed)[0]) for seed in range(12)}) > 1


def test_a_copy_lands_on_the_same_side(demos):
    copy = replace(demos[1], name="a copy under another name")
    for seed in range(6):
        first, _ = split([*demos, copy], 0.5, seed)
        assert (1 in first) == (4 in first)


def test_both_sides_get_something(demos):
    for fraction in (0.01, 0.99):
        first, second = split(demos, fraction)
        assert first
        assert second


@pytest.mark.parametrize("fraction", [0.0, 1.0, -1.0, 2.0, float("nan")])
def test_fraction_must_lie_between(demos, fraction):
    with pytest.raises(InputError, match="must lie between 0 and 1"):
        split(demos, fraction)


def test_one_walk_twice_cannot_be_split(demos):
    with pytest.raises(InputError, match="two different recordings"):
        split([demos[0], replace(demos[0], name="copy")])


def test_overlap_is_refused(demos):
    prints = [fingerprint(r) for r in demos[:2]]
    refuse_overlap(prints, demos[2:])
    with pytest.raises(InputError, match="copy was tuned on"):
        refuse_overlap(prints, [demos[2], replace(demos[0], name="copy")])
