"""Numbered stances, and cleaning, against loops."""

import jax
import numpy as np
import pytest

from pedjax.detectors import clean_stance, stance_id
from tests.reference import detectors as naive

number, clean = jax.jit(stance_id), jax.jit(clean_stance)


@pytest.fixture
def masks(rng):
    masks = [np.repeat(rng.random(30) < 0.5, rng.integers(1, 12, 30))[:90] for _ in range(20)]
    return [*masks, np.zeros(90, bool), np.ones(90, bool)]


def test_stances_are_numbered_in_order(masks):
    for mask in masks:
        np.testing.assert_array_equal(number(mask), naive.stance_id(mask))


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_cleaning_equals_loops(masks, rng, jitter):
    for mask in masks:
        dt = 0.01 * (1 + jitter * rng.uniform(-1, 1, len(mask)))
        expected = naive.clean_stance(mask, dt, 0.05, 0.08)
        np.testing.assert_array_equal(clean(mask, dt, 0.05, 0.08), expected)


def test_a_run_as_long_as_the_limit_is_neither_gap_nor_short():
    mask = np.array([1] * 8 + [0] * 5 + [1] * 8 + [0] * 9 + [1] * 7 + [0] * 3, bool)
    np.testing.assert_array_equal(clean(mask, np.full(40, 0.01)), np.where(np.arange(40) < 21, mask, False))
