"""Stance detectors: six published statistics behind one interface.

The foot is still where statistic < threshold. A detector is split in two: `evidence`, parameter-free and
computed once for a recording, and `statistic`, a few operations for each parameter set. Defaults: SHOE and
ARED as published with PyShoe (Wagstaff, Peretroukhin, Kelly 2017) at 200 Hz; windows are lengths in seconds
so that they mean the same at any rate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.detectors import evidence as measure
from pedjax.errors import InputError
from pedjax.gates import log_positive
from pedjax.parameters import group, leaf, offer, parameters, setting
from pedjax.windows import is_complete

_PYSHOE = "PyShoe, published scripts"
_KIT = "kit choice"
_MISSING = 1e10  # a window that is not there: never still, and its square finite in float32


def _window(name: str, seconds: float = 0.025, source: str = "PyShoe: W = 5 at 200 Hz") -> Any:
    return setting(
        seconds, source=source,
        meaning=f"Length of the window of {name}; longer, a short rest no longer counts as stance.",
    )  # fmt: skip


@parameters
class Shoe:
    """SHOE, the generalised likelihood ratio test of Skog et al. 2010."""

    threshold: Array = leaf(
        8.5e7, unit="1", low=1e3, high=1e12, source=f"{_PYSHOE} (mixed gait)", tune=True, point=True,
        meaning="Statistic below which the foot counts as still; raised, more samples are taken for "
        "stance, moving ones too.",
    )  # fmt: skip
    sigma_accelerometer: Array = leaf(
        0.00098, unit="m/s^2", low=1e-5, high=10.0, source=_PYSHOE,
        meaning="Noise by which SHOE divides the force's part; raised, the force counts for less and "
        "more samples pass.",
    )  # fmt: skip
    sigma_gyroscope: Array = leaf(
        8.7266463e-5, unit="rad/s", low=1e-7, high=1.0, source=_PYSHOE,
        meaning="Noise by which SHOE divides the rate's part; raised, the rate counts for less and more "
        "samples pass.",
    )  # fmt: skip
    window_s: float = _window("SHOE")


@parameters
class Ared:
    """ARED, angular rate energy."""

    threshold: Array = leaf(
        0.55, unit="rad^2/s^2", low=1e-5, high=1e3, source=f"{_PYSHOE} (mixed gait)", tune=True, point=True,
        meaning="Mean square angular rate below which the foot counts as still; raised, more samples are "
        "taken for stance.",
    )  # fmt: skip
    window_s: float = _window("ARED")


@parameters
class Amvd:
    """AMVD, moving variance of the specific force."""

    threshold: Array = leaf(
        0.3, unit="m^2/s^4", low=1e-5, high=1e4, source=_KIT, tune=True, point=True,
        meaning="Variance of the force below which the foot counts as still; raised, more samples are "
        "taken for stance.",
    )  # fmt: skip
    window_s: float = _window("AMVD")


@parameters
class Mag:
    """MAG, magnitude of the specific force against gravity."""

    threshold: Array = leaf(
        1.0, unit="1", low=1e-5, high=1e12, source=_KIT, tune=True, point=True,
        meaning="Mean square of the force's size less gravity, scaled, below which the foot is still; "
        "raised, more samples are.",
    )  # fmt: skip
    sigma_accelerometer: Array = leaf(
        0.5, unit="m/s^2", low=1e-5, high=10.0, source=_KIT,
        meaning="Noise by which MAG divides the force's size less gravity; raised, the statistic falls "
        "and more samples pass.",
    )  # fmt: skip
    window_s: float = _window("MAG")


@parameters
class Mbgtd:
    """MBGTD, memory-based graph-theoretic detector."""

    threshold: Array = leaf(
        0.3, unit="m/s^2", low=1e-4, high=1e3, source=_KIT, tune=True, point=True,
        meaning="Weighted distance of earlier and later forces below which the foot is still; raised, "
        "more samples are stance.",
    )  # fmt: skip
    window_s: float = setting(
        0.025, source="kit choice: W = 5 at 200 Hz (PyShoe tunes with 2)",
        meaning="Length of the window of MBGTD; longer, the statistic grows and takes much more time to "
        "compute.",
    )  # fmt: skip


@parameters
class Eps:
    """EPS, variances of energy, product and sum (Sejong 2020, Eq. 1-9). Thresholds are not published:
    the defaults are ten times the 95th percentile of a foot's stance on public recordings at 100-250 Hz."""

    energy: Array = leaf(
        40.0, unit="m^4/s^8", low=1e-4, high=1e8, source=_KIT, tune=True, point=True,
        meaning="Limit of the variance of f_x^2 + f_z^2 (x forward, z vertical) in stance; raised, this "
        "test rejects fewer samples.",
    )  # fmt: skip
    product: Array = leaf(
        10.0, unit="m^4/s^8", low=1e-4, high=1e8, source=_KIT, point=True,
        meaning="Limit of the variance of f_x f_z in stance; raised, this test rejects fewer samples.",
    )  # fmt: skip
    total: Array = leaf(
        0.5, unit="m^2/s^4", low=1e-5, high=1e6, source=_KIT, point=True,
        meaning="Limit of the variance of f_x + f_z in stance; raised, this test rejects fewer samples.",
    )  # fmt: skip
    rate_variance: Array = leaf(
        0.05, unit="rad^4/s^4", low=1e-8, high=1e6, source=_KIT, point=True,
        meaning="Limit of the variance of the rate's energy about x and y in stance; raised, this test "
        "rejects fewer samples.",
    )  # fmt: skip
    rate_energy: Array = leaf(
        0.55, unit="rad^2/s^2", low=1e-5, high=1e4, source=_KIT, tune=True, point=True,
        meaning="Limit of the rate's energy about x and y in stance; raised, this test rejects fewer "
        "samples.",
    )  # fmt: skip
    window_s: float = _window("EPS", 0.15, "Sejong 2020: 15 samples at 100 Hz")


def _shoe(p: Shoe, e: Array, gravity: Array) -> Array:
    # |f - g u|^2 averages to the window's variance plus (|mean| - g)^2, without cancellation
    force = e[0] + (e[1] - gravity) ** 2
    return force / p.sigma_accelerometer**2 + e[2] / p.sigma_gyroscope**2


def _mag(p: Mag, e: Array, gravity: Array) -> Array:
    return (e[4] + (e[3] - gravity) ** 2) / p.sigma_accelerometer**2


def _eps(p: Eps, e: Array, gravity: Array) -> Array:
    limits = (p.energy, p.product, p.total, p.rate_variance, p.rate_energy)
    worst = e[0] / limits[0]
    for value, limit in zip(e[1:], limits[1:], strict=True):
        worst = jnp.maximum(worst, value / limit)
    return worst


class Detector(NamedTuple):
    """A stance detector: `evidence(force, rate, window)` and `statistic(parameters, evidence, gravity)`.

    `statistic` takes evidence `(m, *L)` and gives `(*L)`; `threshold(parameters)` is what it is held against.
    """

    evidence: Callable[[Array, Array, int], Array]
    statistic: Callable[[Any, Array, Array], Array]
    threshold: Callable[[Any], Any]


DETECTORS: dict[str, Detector] = {
    "shoe": Detector(measure.force_and_rate, _shoe, lambda p: p.threshold),
    "ared": Detector(measure.force_and_rate, lambda p, e, g: e[2], lambda p: p.threshold),
    "amvd": Detector(measure.force_and_rate, lambda p, e, g: e[0], lambda p: p.threshold),
    "mag": Detector(measure.force_and_rate, _mag, lambda p: p.threshold),
    "mbgtd": Detector(measure.memory_based_graph, lambda p, e, g: e[0], lambda p: p.threshold),
    "eps": Detector(measure.eps_variances, _eps, lambda p: 1.0),
}


def register_stance_detector(name: str, detector: Detector, own: type) -> None:
    """Make a stance detector of your own known by its name, with the class of its parameters: a `window_s`
    setting, and its operating points as leaves made with `point`."""
    DETECTORS[name] = detector
    offer(StanceParameters, name, own)


RULES = ("causal", "any", "all", "block")


@parameters
class StanceParameters:
    """Which detector, and how its windows decide on samples.

    `rule`: `causal`, the window that ends at the sample; `any` of the windows that cover it (Skog's and
    OpenShoe's dilation, not causal); `all` of them (not causal); `block`, the one of the non-overlapping
    blocks that holds it (PyShoe, not causal within a block; its last incomplete block is *not* still here).
    """

    detector: str = setting(
        "shoe", choices=tuple(DETECTORS), source=_PYSHOE,
        meaning="Which statistic decides whether the foot is still; only the group of that name has an "
        "effect.",
    )  # fmt: skip
    rule: str = setting(
        "causal", choices=RULES, source=_KIT,
        meaning="Which windows decide on a sample: the one that ends there, any or all that cover it, or "
        "its block's.",
    )  # fmt: skip
    shoe: Shoe = group(Shoe, when={"detector": "shoe"})
    ared: Ared = group(Ared, when={"detector": "ared"})
    amvd: Amvd = group(Amvd, when={"detector": "amvd"})
    mag: Mag = group(Mag, when={"detector": "mag"})
    mbgtd: Mbgtd = group(Mbgtd, when={"detector": "mbgtd"})
    eps: Eps = group(Eps, when={"detector": "eps"})

    def chosen(self) -> tuple[Detector, Any]:
        """The detector that is on, and its parameters."""
        return DETECTORS[self.detector], getattr(self, self.detector)


def window_s(p: StanceParameters) -> float:
    """The window of the chosen detector in s."""
    return float(p.chosen()[1].window_s)


def window_samples(p: StanceParameters, rate: float) -> int:
    """The window of the chosen detector in samples at a rate in Hz (at least 2)."""
    return max(round(window_s(p) * rate), 2)


def evidence(
    p: StanceParameters,
    specific_force: Array,
    angular_rate: Array,
    rate: float,
    length: ArrayLike | None = None,
) -> Array:
    """Evidence of the windows that decide on each sample: `(T, windows, m)`, from `(T, 3)` arrays.

    The rules `causal` and `block` have one window a sample, `any` and `all` have W. Samples from `length`
    on are padding and never still.
    """
    detector, _ = p.chosen()
    window, total = window_samples(p, rate), specific_force.shape[0]
    if total < window:
        raise InputError(f"the recording has {total} samples, less than the detector's window of {window}")
    length = total if length is None else length
    found = detector.evidence(specific_force, angular_rate, window)
    found = jnp.where(is_complete(total, window)[:, None], found, _MISSING)
    index = jnp.arange(total)
    if p.rule == "causal":
        decisive = found[:, None]
    elif p.rule == "block":
        end = index // window * window + window - 1
        decisive = jnp.where((end < length)[:, None], found[jnp.minimum(end, total - 1)], _MISSING)[:, None]
    else:  # windows that end 0 .. W-1 samples later; one that does not exist repeats the nearest real one
        ends = index[:, None] + jnp.arange(window)
        decisive = found[jnp.clip(ends, window - 1, jnp.asarray(length) - 1)]
    return jnp.where((index < length)[:, None, None], decisive, _MISSING)


def log_ratio(p: StanceParameters, found: Array, gravity: Array) -> Array:
    """log(statistic / threshold) of one sample's evidence `(windows, m, *L)`; below 0 the foot is still."""
    detector, own = p.chosen()
    each = jnp.stack([log_positive(detector.statistic(own, window, gravity)) for window in found])
    worst = {"any": jnp.min, "all": jnp.max}.get(p.rule, jnp.max)(each, axis=0)
    return worst - jnp.log(detector.threshold(own))


def statistic(
    p: StanceParameters, specific_force: Array, angular_rate: Array, rate: float, gravity: float = 9.80665
) -> Array:
    """The chosen detector's statistic at each sample `(T,)`, to be held against its threshold."""
    found = jnp.moveaxis(evidence(p, specific_force, angular_rate, rate), 0, -1)
    g = jnp.asarray(gravity, found.dtype)
    return jnp.exp(log_ratio(p, found, g)) * jnp.asarray(p.chosen()[0].threshold(p.chosen()[1]))
