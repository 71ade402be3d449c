"""What a deviation of the field may tell."""

import jax.numpy as jnp
import numpy as np

from pedjax import rotations
from pedjax.filters import wandering_field
from pedjax.filters.wandering_field import Fields, Wandering


def test_a_deviation_does_not_tell_of_the_yaw():
    attitude = rotations.from_euler(*jnp.array([0.1, -0.2, 0.7]))
    zero, one = jnp.zeros(3), jnp.array(1.0)
    down, level = jnp.array([0.0, 0.0, -65.0]), jnp.array([1.5, -0.7, 0.3])
    for deviation in (zero, level):
        fields = Fields(down, deviation, zero, one)
        rows = wandering_field.rows(Wandering(), fields, attitude, attitude.T @ (down + deviation), one)
        assert np.abs(rows.innovation).max() < 1e-12
        assert np.abs(rows.H["t"][:, 2]).max() == 0
        assert np.abs(rows.H["t"][:, :2]).max() > 1
