"""What a sensor makes of the truth: noise, biases, distortion, bandwidth, range and steps; and its clock.

`apply` takes the clean signal of one triad through, in this order: scale factors, misalignment and
g-sensitivity; the low-pass; the biases and white noise; saturation; quantisation. The default of every field
is no error, and then values come out bit for bit as they went in. Everything but `clock` is pure JAX: `vmap`
over keys, over models, or both. Each source of error has its own key, so that switching one off leaves the
draws of all others as they are, and cropping the end of a signal changes nothing before it but last bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax.errors import InputError
from pedjax.parameters import cast

_SOURCES = (
    "noise", "drift", "walk", "bias", "startup", "temperature", "scale", "misalignment", "g_sensitivity",
)  # fmt: skip
"""Each has the key of its place: a new one goes last, or old seeds give new draws. The first three are drawn
for every sample, the others once."""

_SHORTEST = 1e-6
"""s, floor of a time step: two samples at one instant must not give infinite noise."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Triad:
    """Errors of three axes; u is the unit of the sensor: m/s^2, rad/s or microtesla.

    Each field is one number for all axes or `(3,)`, but for the two matrices. What is drawn (`..._std`) is
    drawn once per run and axis, normal with mean zero, and added to the fixed value beside it.

    `noise` u/sqrt(Hz), two-sided: a sample has the standard deviation noise / sqrt(dt), so that the Allan
    deviation at 1 s is `noise` (a density that stands for noise^2 = rms^2 / bandwidth is sqrt(2) larger).
    `bias`, `bias_std` u, constant: the turn-on bias. `drift_std` u, `drift_time` s (positive): a stationary
    first-order Gauss-Markov bias, standard deviation and correlation time. `walk` u/sqrt(s): a random walk
    from 0, of standard deviation walk * sqrt(t). `startup`, `startup_std` u, `startup_time` s (positive): a
    bias that decays as exp(-t / startup_time) from the first sample on. `temperature`, `temperature_std` u/K:
    bias per kelvin of the temperature profile.

    `scale`, `scale_std`: relative scale errors. `misalignment`, `misalignment_std` rad: element (i, j) of
    `(3, 3)`, i not j, is what axis i sees of axis j; one number stands for all six, the diagonal is ignored.
    `g_sensitivity`, `g_sensitivity_std` u/(m/s^2), for gyroscopes: `(3, 3)` times specific force; one number
    or `(3,)` is its diagonal, and the draw has all nine elements.

    `bandwidth` Hz (inf: none) and `order` (1 or 2) of `low_pass`, which the signal passes and the noise does
    not. `limit` u (inf: none): saturation at plus and minus. `resolution` u (0: none): the least step;
    gradients pass it as if it were not there.
    """

    noise: ArrayLike = 0.0
    bias: ArrayLike = 0.0
    bias_std: ArrayLike = 0.0
    drift_std: ArrayLike = 0.0
    drift_time: ArrayLike = 100.0
    walk: ArrayLike = 0.0
    startup: ArrayLike = 0.0
    startup_std: ArrayLike = 0.0
    startup_time: ArrayLike = 100.0
    temperature: ArrayLike = 0.0
    temperature_std: ArrayLike = 0.0
    scale: ArrayLike = 0.0
    scale_std: ArrayLike = 0.0
    misalignment: ArrayLike = 0.0
    misalignment_std: ArrayLike = 0.0
    g_sensitivity: ArrayLike = 0.0
    g_sensitivity_std: ArrayLike = 0.0
    bandwidth: ArrayLike = jnp.inf
    limit: ArrayLike = jnp.inf
    resolution: ArrayLike = 0.0
    order: int = field(default=2, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Magnetometer:
    """A magnetometer triad on a foot, in microtesla.

    `hard_iron (3,)` and `soft_iron (3, 3)` in body axes, always. Only while the foot stands: `platform (3,)`
    in body axes, of what the sole then touches, and `floor (3,)` in navigation axes, of floor and shoe.
    """

    triad: Triad = field(default_factory=Triad)
    hard_iron: ArrayLike = 0.0
    soft_iron: ArrayLike = field(default_factory=lambda: np.eye(3))
    platform: ArrayLike = 0.0
    floor: ArrayLike = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Clock:
    """When a unit samples, what it stamps and what arrives; see `clock`.

    `rate` Hz nominal; `ppm`, `ppm_std` its relative error in 1e-6, fixed and drawn per run; `jitter` s,
    standard deviation of each sampling instant about its even place; `loss` probability that a sample is lost
    if the one before arrived, `burst` mean number of samples lost in a row (at least 1); `repeat` probability
    that a stamp repeats the one before.
    """

    rate: float = 100.0
    ppm: float = 0.0
    ppm_std: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    burst: float = 1.0
    repeat: float = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Imu:
    """One unit: accelerometer (m/s^2), gyroscope (rad/s), magnetometer (microtesla) and their clock."""

    accelerometer: Triad = field(default_factory=Triad)
    gyroscope: Triad = field(default_factory=Triad)
    magnetometer: Magnetometer = field(default_factory=Magnetometer)
    clock: Clock = field(default_factory=Clock)


class Measured(NamedTuple):
    """What a triad puts out, and the truth about it: before bandwidth, limit and resolution,
    values = matrix @ clean + bias + noise, but for g-sensitivity and what acts in stance only.

    `values (T, 3)`; `bias (T, 3)`, the exact sum of all slow errors added (constant, drift, walk, start-up,
    temperature, hard iron); `matrix (3, 3)`, scale factors, misalignment and soft iron.
    """

    values: Array
    bias: Array
    matrix: Array


class MeasuredImu(NamedTuple):
    """`Measured` of each triad of a unit; `magnetometer` is None where no field was given."""

    accelerometer: Measured
    gyroscope: Measured
    magnetometer: Measured | None


class Ticks(NamedTuple):
    """`time (N,)` s, the true sampling instants; `stamps (N,)` s, what the unit writes; `kept (N,)` bool,
    which samples arrive."""

    time: np.ndarray
    stamps: np.ndarray
    kept: np.ndarray


def apply(
    model: Triad,
    key: Array,
    dt: ArrayLike,
    clean: ArrayLike,
    *,
    specific_force: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
) -> Measured:
    """What a triad of that model measures, in the precision of `clean`.

    `dt`, one number or `(T,)` s: the true step that ends at each sample, positive and as uneven as it likes.
    `clean (T, 3)` in u. `specific_force (T, 3)` m/s^2 is for the g-sensitivity of gyroscopes, `temperature
    (T,)` K is taken above that of the calibration; left out, neither has an effect.
    """
    return _measure(model, key, dt, _floats(clean), specific_force, temperature, 0.0)


def apply_magnetometer(
    model: Magnetometer,
    key: Array,
    dt: ArrayLike,
    clean: ArrayLike,
    *,
    attitude: ArrayLike | None = None,
    stance: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
) -> Measured:
    """What a magnetometer measures of the field `clean (T, 3)` in microtesla, body axes.

    With w = `stance (T,)` in [0, 1] and C = `attitude (T, 3, 3)`, body to navigation, the field at the triad
    is soft_iron @ (clean + w C^T floor) + w platform, and hard_iron joins its bias. The rest as in `apply`.
    """
    clean = _floats(clean)
    iron = cast(model, clean.dtype)
    there = clean
    if stance is not None:
        if attitude is None:
            raise InputError("stance disturbances need the attitude, (T, 3, 3), beside the stance")
        weight = jnp.asarray(stance, clean.dtype)[:, None]
        floor = jnp.broadcast_to(jnp.asarray(iron.floor), (3,))
        there = clean + weight * (jnp.asarray(attitude, clean.dtype) * floor[:, None]).sum(axis=-2)
    there = _turned(jnp.asarray(iron.soft_iron), there)
    if stance is not None:
        there = there + weight * iron.platform
    measured = _measure(model.triad, key, dt, there, None, temperature, jnp.asarray(iron.hard_iron))
    soft = jnp.asarray(iron.soft_iron)
    return measured._replace(matrix=(measured.matrix[:, :, None] * soft[None]).sum(axis=1))


def apply_imu(
    imu: Imu,
    key: Array,
    dt: ArrayLike,
    specific_force: ArrayLike,
    angular_rate: ArrayLike,
    magnetic_field: ArrayLike | None = None,
    *,
    attitude: ArrayLike | None = None,
    stance: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
) -> MeasuredImu:
    """What a unit measures of clean `specific_force` m/s^2, `angular_rate` rad/s and `magnetic_field`
    microtesla, each `(T, 3)` in body axes; the rest as in `apply` and `apply_magnetometer`."""
    keys = [jax.random.fold_in(key, sensor) for sensor in range(3)]
    magnetic = None
    if magnetic_field is not None:
        magnetic = apply_magnetometer(
            imu.magnetometer, keys[2], dt, magnetic_field,
            attitude=attitude, stance=stance, temperature=temperature,
        )  # fmt: skip
    return MeasuredImu(
        apply(imu.accelerometer, keys[0], dt, specific_force, temperature=temperature),
        apply(
            imu.gyroscope, keys[1], dt, angular_rate, specific_force=specific_force, temperature=temperature
        ),
        magnetic,
    )


def _measure(
    model: Triad,
    key: Array,
    dt: ArrayLike,
    clean: Array,
    specific_force: ArrayLike | None,
    temperature: ArrayLike | None,
    offset: ArrayLike,
) -> Measured:
    own = cast(model, clean.dtype)
    steps = jnp.broadcast_to(jnp.asarray(dt, clean.dtype), clean.shape[:1])
    steps = jnp.maximum(steps, _SHORTEST)
    draws = _draws(key, clean)
    scale = own.scale + own.scale_std * draws["scale"][0]
    turn = own.misalignment + own.misalignment_std * draws["misalignment"]
    eye = jnp.eye(3, dtype=clean.dtype)
    error = jnp.diag(scale) + (1 - eye) * turn
    signal = clean + _turned(error, clean)
    if specific_force is not None:
        fixed = jnp.asarray(own.g_sensitivity)
        fixed = fixed if fixed.ndim == 2 else eye * fixed
        felt = fixed + own.g_sensitivity_std * draws["g_sensitivity"]
        signal = signal + _turned(felt, jnp.asarray(specific_force, clean.dtype))
    signal = low_pass(signal, steps, own.bandwidth, model.order)
    bias = _slow(own, draws, steps, temperature) + offset
    noise = own.noise / jnp.sqrt(steps)[:, None] * draws["noise"]
    limit = jnp.asarray(own.limit)
    values = _quantise(jnp.clip(signal + (bias + noise), -limit, limit), jnp.asarray(own.resolution))
    return Measured(values, bias, eye + error)


def _floats(values: ArrayLike) -> Array:
    array = jnp.asarray(values)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


def _draws(key: Array, clean: Array) -> dict[str, Array]:
    """Standard normal numbers of each source of error: `(T, 3)`, or `(3, 3)` where they are drawn once."""

    def draw(keys: Array, shape: tuple[int, ...]) -> Array:
        return jax.vmap(lambda own: jax.random.normal(own, shape, clean.dtype))(keys)

    keys = jax.vmap(lambda source: jax.random.fold_in(key, source))(jnp.arange(len(_SOURCES)))
    every, once = draw(keys[:3], clean.shape), draw(keys[3:], (3, 3))
    return dict(zip(_SOURCES, (*every, *once), strict=True))


def _turned(matrix: Array, vectors: Array) -> Array:
    """`(3, 3)` times each of `(T, 3)`, by sums and not by a product routine: the identity leaves all bits."""
    return (matrix * vectors[:, None, :]).sum(axis=-1)


def _slow(own: Triad, draws: dict[str, Array], steps: Array, temperature: ArrayLike | None) -> Array:
    """(T, 3): everything that a filter would call bias."""
    startup = own.startup + own.startup_std * draws["startup"][0]
    fresh = own.drift_std * draws["drift"]
    kicks = own.walk * jnp.sqrt(steps)[:, None] * draws["walk"]
    drifted = jnp.broadcast_to(steps[:, None] / own.drift_time, fresh.shape)
    settled = jnp.broadcast_to(steps[:, None] / own.startup_time, fresh.shape)
    nothing = jnp.zeros_like(fresh)
    parts = _recurrence(
        jnp.exp(-jnp.stack([drifted, nothing, settled], axis=1)),
        jnp.stack([jnp.sqrt(-jnp.expm1(-2 * drifted)) * fresh, kicks, nothing], axis=1),
        jnp.stack([fresh[0], nothing[0], startup]),  # the drift begins in its stationary state
    )
    constant = jnp.asarray(own.bias + own.bias_std * draws["bias"][0])
    bias = constant + parts.sum(axis=1)
    if temperature is None:
        return bias
    per_kelvin = jnp.asarray(own.temperature + own.temperature_std * draws["temperature"][0])
    return bias + per_kelvin * jnp.asarray(temperature, steps.dtype)[:, None]


def _recurrence(decay: Array, drive: Array, start: Array) -> Array:
    """y[0] = start, y[k] = decay[k] y[k-1] + drive[k]."""

    def step(last: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        value = now[0] * last + now[1]
        return value, value

    rest = jax.lax.scan(step, start, (decay[1:], drive[1:]))[1]
    return jnp.concatenate([start[None], rest])


def low_pass(signal: Array, dt: ArrayLike, bandwidth: ArrayLike, order: int = 2) -> Array:
    """`signal (T, 3)` through a low-pass of unit gain at rest, -3 dB at `bandwidth` Hz; inf leaves it alone.

    `dt`, one number or `(T,)` s. Causal, and exact at any step for a signal that runs straight between its
    samples: order 1 is RC, 2 Butterworth. A slow signal comes out late by 1 / (2 pi bandwidth) =
    0.159 / bandwidth seconds in order 1 and by sqrt(2) as much, 0.225 / bandwidth, in order 2, whatever the
    sampling rate. It starts settled on the first sample.
    """
    if order not in (1, 2):
        raise InputError(f"a low-pass has order 1 or 2, not {order}")
    open_ = jnp.isinf(jnp.asarray(bandwidth, signal.dtype))
    pole = 2 * jnp.pi * jnp.where(open_, 1.0, bandwidth)
    if order == 2:
        pole = pole / jnp.sqrt(2.0).astype(signal.dtype)  # real and imaginary part of both its poles
    steps = jnp.broadcast_to(jnp.asarray(dt, signal.dtype), signal.shape[:1])
    angle = jnp.broadcast_to(steps[:, None] * pole, signal.shape)
    before = jnp.concatenate([signal[:1], signal[:-1]])
    lag = (signal - before) / angle  # how far the output stays behind when the input runs on like this

    def step(state: tuple[Array, Array], now: tuple[Array, ...]) -> tuple[tuple[Array, Array], Array]:
        value, speed = state  # the speed in units of the pole
        old, new, late, turn = now
        away, decay = value - old + late, jnp.exp(-turn)
        if order == 1:
            return (new - late + decay * away, speed), new - late + decay * away
        rest, c, s = speed - late, decay * jnp.cos(turn), decay * jnp.sin(turn)
        value = new - late + (c + s) * away + s * rest
        return (value, late + (c - s) * rest - 2 * s * away), value

    start = (signal[0], jnp.zeros_like(signal[0]))
    smooth = jax.lax.scan(step, start, (before, signal, lag, angle))[1]
    return jnp.where(open_, signal, smooth)


@jax.custom_jvp
def _quantise(values: Array, resolution: Array) -> Array:
    some = resolution > 0
    step = jnp.where(some, resolution, 1.0)
    return jnp.where(some, jnp.round(values / step) * step, values)


_quantise.defjvps(lambda tangent, _answer, _values, _resolution: tangent, None)


def clock(model: Clock, seed: int, duration: float) -> Ticks:
    """Sampling instants, stamps and losses of int(duration * rate) samples; same seed, same bits (numpy).

    The unit believes in its nominal rate: with e = ppm * 1e-6, drawn part included, it samples at the true
    instants k / (rate (1 + e)), each moved by jitter but at most 0.45 of a step, so that their order stays,
    and stamps them time * (1 + e). Errors belong to the true steps, a filter sees the stamps. A repeated
    stamp is that of the sample before; no instant moves for it. Losses are a two-state chain, all samples
    being drawn, so that in the long run loss * burst / (1 + loss * burst) of them are lost; duration and
    errors count lost samples too. The first sample is at 0, is kept, and repeats nothing. What is switched
    off leaves the other draws as they are.
    """
    if not (model.rate > 0 and 0 <= model.loss < 1 and 0 <= model.repeat <= 1 and model.burst >= 1):
        raise InputError("a clock needs rate > 0, loss in [0, 1), repeat in [0, 1] and burst >= 1")
    if model.jitter < 0 or model.ppm_std < 0:
        raise InputError("a clock's jitter and ppm_std must not be negative")
    count = int(duration * model.rate + 1e-9)
    if count < 1:
        raise InputError(f"{duration} s at {model.rate} Hz hold no sample")
    of_rate, of_jitter, of_loss, of_repeat = (np.random.default_rng([21, seed, i]) for i in range(4))
    fast = 1.0 + 1e-6 * (model.ppm + model.ppm_std * of_rate.standard_normal())
    step = 1.0 / (model.rate * fast)
    moved = np.clip(model.jitter * of_jitter.standard_normal(count), -0.45 * step, 0.45 * step)
    moved[0] = 0.0
    time = step * np.arange(count) + moved
    same = of_repeat.uniform(size=count) < model.repeat
    same[0] = False
    last = np.maximum.accumulate(np.where(same, 0, np.arange(count)))
    return Ticks(time, (time * fast)[last], _kept(of_loss, count, model.loss, model.burst))


def _kept(rng: np.random.Generator, count: int, loss: float, burst: float) -> np.ndarray:
    """Runs of kept and of lost samples by turns, their lengths geometric."""
    if loss == 0:
        return np.ones(count, bool)
    lengths = np.stack([rng.geometric(loss, count), rng.geometric(1 / burst, count)], axis=1).ravel()
    ends = np.minimum(np.cumsum(np.minimum(lengths, count)), count)
    return np.repeat(np.arange(2 * count) % 2 == 0, np.diff(ends, prepend=0))
