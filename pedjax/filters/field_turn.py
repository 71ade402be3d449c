"""A field that stays is seen to turn as the sensor turns: what that says of the gyroscope's bias.

Differential (Munoz Diaz 2017, Eq. 15-16, corrected): with A the rotation of the body over a sample,

    m_k = Aᵀ m_{k−1} + noise,  A = exp([(ω − b) dt ×]);

printed is A m_{k−1}, which in a still field is wrong by twice the turn, and drives the bias away. Two
readings that follow share the noise of the one between them. Taken as white, which is published, N rows are
believed to have 2N σ² where their sum has 2 σ²: the filter learns a hundred times slower than it could, and
says so. With `moving average` noise the error of the last reading is a state, for one sample.

Anchored (after Afzal 2011): the first reading of a steady stretch, turned into navigation axes, is what all
others of it are held against. It is fast; but the error of the anchor is in every row of the stretch, and
nobody tells the filter: its covariance is too small.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.filters import covariance, kalman
from pedjax.filters.covariance import Covariance
from pedjax.filters.kalman import Rows
from pedjax.lanes import eye, matmul, matmul_t, matvec, slopes, transpose
from pedjax.rotations import skew


def turned(before: Array, rate: Array, bias: Array, dt: Array) -> tuple[Array, Array, Array]:
    """What the last reading `before (3, *L)` µT becomes as the body turns for `dt` s, its slope `(3, 3, *L)`
    by the bias, and Aᵀ `(3, 3, *L)`."""
    found, by_bias = slopes(lambda b: matvec(rotations.exp(-(rate - b) * dt), before), bias)
    return found, by_bias, rotations.exp(-(rate - bias) * dt)


def noise_of_rate(before: Array, dt: Array, rate_density: Array) -> Array:
    """What the gyroscope's white noise, rad/s/√Hz, puts into the turned reading: dt σ² [m×][m×]ᵀ."""
    across = skew(before)
    return dt * rate_density**2 * matmul_t(across, across)


def differential(
    reading: Array, before: Array, rate: Array, bias: Array, dt: Array, densities: tuple[Array, Array]
) -> Rows:
    """Rows on g with the noises of both readings as if new: R = 2 σ²/dt I + dt σ_ω² [m×][m×]ᵀ. `densities` of
    magnetometer, µT/√Hz, and gyroscope, rad/s/√Hz."""
    found, by_bias, _ = turned(before, rate, bias, dt)
    own = 2 * densities[0] ** 2 / dt * eye(3, dt)
    return Rows(reading - found, own + noise_of_rate(before, dt, densities[1]), {"g": by_bias})


def chained(
    P: Covariance,
    reading: Array,
    before: Array,
    error: Array,
    rate: Array,
    bias: Array,
    dt: Array,
    densities: tuple[Array, Array],
    weight: Array,
) -> tuple[Covariance, dict[str, Array], Array]:
    """The update with the error of the last reading as the state `n`, whose estimate is `error (3, *L)` µT.

    The new reading's error `o` joins, the update is made, and `o` becomes `n`: the covariance, the correction
    of all other states, and the estimate of the new reading's error. A `weight` below 1 is further noise, by
    which σ² becomes σ²/weight for this row: on the gyroscope's small part alone it would hold off nothing.
    """
    last = before - error
    found, by_bias, back = turned(last, rate, bias, dt)
    sigma = densities[0] / jnp.sqrt(dt) + 0 * reading
    doubt = (1 / jnp.maximum(weight, 1e-9) - 1) * densities[0] ** 2 / dt
    noise = noise_of_rate(last, dt, densities[1]) + (doubt + 1e-12) * eye(3, dt)
    H: dict[str, Array | None] = {"g": by_bias, "n": -back, "o": None}
    counts = jnp.where(weight > 0, 1.0, 0.0).astype(dt.dtype)
    P, correction = kalman.update(
        covariance.extended(P, {"o": sigma}), Rows(reading - found, noise, H), counts
    )
    new = correction.pop("o")
    correction.pop("n")
    kept = {}
    for name, block in P.items():
        if name == "oo":
            kept["nn"] = block
        elif "o" in name and "n" not in name:
            kept[name.replace("o", "n")] = block
        elif "n" not in name:
            kept[name] = block
    return kept, correction, new


def anchored(reading: Array, anchor: Array, attitude: Array, sigma: Array) -> Rows:
    """The reading against the `anchor (3, *L)` µT in navigation axes: z = m − Ĉᵀ B, H = Ĉᵀ [B×] on t."""
    back = transpose(attitude)
    H = matmul(back, skew(anchor))
    return Rows(reading - matvec(back, anchor), sigma**2 * eye(3, sigma), {"t": H})
