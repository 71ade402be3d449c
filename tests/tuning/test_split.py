"""Which recordings are held back: by content, not by name or order."""

from dataclasses import replace

import pytest

from pedjax import split
from pedjax.errors import InputError
from pedjax.tuning import fingerprint
from pedjax.tuning.split import refuse_overlap
from tests import tools


def test_fingerprint_is_of_the_samples_alone(demos):
    prints = [fingerprint(r) for r in demos]
    assert len(set(prints)) == len(demos)
    assert fingerprint(replace(demos[0], name="other", landmarks=None)) == prints[0]
    assert fingerprint(tools.crop(demos[0], 11.0)) != prints[0]


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
