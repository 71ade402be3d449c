"""Gradients of a landmark error through a whole walk, by every tunable number of IEZ, against differences."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.detectors.stance import DETECTORS
from pedjax.ensemble import Problem, losses
from pedjax.packing import pack_all
from pedjax.systems import SYSTEMS
from pedjax.tuning import objective
from pedjax.walks import walk
from tests import tools
from tests.reference.walk import walk as make_walk

IEZ = SYSTEMS["iez"]
HALVINGS = 13
FIRST_STEP = 0.64
"""In free units, about e-folds."""

VALUES = {
    "gate.kind": "adaptive",
    "gate.width": 0.25,
    "gate.hysteresis": 1.8,
    "gate.follow": 0.3,
    "gate.follow_time": 0.8,
    "gate.growth": 0.4,
    "gate.floor": -1.0,
    "updates.zaru": True,
    "updates.zero_angular_rate": 0.05,
    "updates.zero_velocity": 0.02,
    "process.accelerometer_bias": 0.01,
    "process.gyroscope_bias": 1e-3,
    "process.accelerometer_bias_time": 5.0,
    "process.gyroscope_bias_time": 8.0,
    "initial.bias": "rest",
    "initial.attitude": 0.02,
    "initial.heading_sigma": 0.05,
    "initial.gyroscope_bias": 0.005,
    "initial.accelerometer_bias": 0.05,
    "initial.velocity": 0.02,
    "stance.shoe.sigma_accelerometer": 0.01,
    "stance.shoe.sigma_gyroscope": 0.005,
    "stance.shoe.threshold": 1500.0,
    "stance.mag.threshold": 0.02,
    "stance.eps.energy": 5.0,
    "stance.eps.product": 1.2,
    "stance.eps.total": 0.03,
    "stance.eps.rate_variance": 3e-8,
    "stance.eps.rate_energy": 3e-4,
}
"""A point where every number matters."""

COVARIANCE_ONLY = ("initial.position",)
"""The estimate does not depend on how sure the first position is: no row looks at it."""


@pytest.fixture(scope="module")
def truth():
    return tools.noisy(make_walk(13.0, 100.0, seed=4), seed=6)


@pytest.fixture(scope="module")
def scored(truth):
    return walk(tools.recording_of(truth, "short", every_s=2.0))


def at(truth, detector):
    c = truth.initial_attitude
    heading = float(np.arctan2(c[1, 0], c[0, 0])) + 0.3  # far from its best, where the loss has a sharp bend
    return parameters.replace(
        IEZ.defaults(), {**VALUES, "stance.detector": detector, "initial.heading": heading}
    )


class Loss:
    """A landmark loss by the free numbers of some leaves, with its gradient and its differences."""

    def __init__(self, truth, scored, detector, names):
        self.params = at(truth, detector)
        self.specs = parameters.specs(self.params)
        self.names = tuple(names)
        self.problem = Problem(IEZ, "rms_2d", "none")
        self.cast = parameters.cast(self.params, float)
        self.batch = pack_all(IEZ, self.cast, [scored])
        self.free = {
            n: jnp.asarray([self.specs[n].to_free(parameters.get(self.params, n))]) for n in self.names
        }

    def gradient(self, batch=None, **free):
        changed = {**self.free, **free}
        found = objective.soft_loss_and_gradient(self.problem, self.cast, changed, batch or self.batch)
        return float(found[0][0]), {n: float(g[0]) for n, g in found[1].items()}

    def at_free(self, free):
        """Losses `(S,)` of free numbers `(S,)`."""
        values = {n: self.specs[n].from_free(x) for n, x in free.items()}
        return np.asarray(losses(self.problem, self.cast, values, self.batch))[:, 0]

    def differences(self, first_step=FIRST_STEP):
        """Slope of each leaf by Ridders' extrapolation of central differences, and its own error estimate."""
        steps = first_step * 0.5 ** np.arange(HALVINGS)
        both = np.concatenate([steps, -steps])
        lanes = len(self.names) * len(both)
        free = {n: np.full(lanes, float(x[0])) for n, x in self.free.items()}
        for i, name in enumerate(self.names):
            free[name][i * len(both) : (i + 1) * len(both)] += both
        loss = self.at_free({n: jnp.asarray(x) for n, x in free.items()}).reshape(
            len(self.names), 2, HALVINGS
        )
        central = (loss[:, 0] - loss[:, 1]) / (2 * steps)
        rounding = 4 * np.finfo(float).eps * np.abs(loss).max() / steps
        return {n: ridders(central[i], rounding) for i, n in enumerate(self.names)}, np.ptp(loss, axis=(1, 2))


def ridders(central, rounding):
    """Extrapolate differences at halved steps to step 0; the entry that agrees best with its neighbours.

    None is known better than its losses are rounded: at small steps two entries may agree by chance.
    """
    table, best, error = [central], central[0], np.inf
    for order in range(1, 4):
        before = table[-1]
        after = before[1:] + (before[1:] - before[:-1]) / (4.0**order - 1)
        for k, value in enumerate(after):
            here = max(abs(value - before[k]), abs(value - before[k + 1])) + rounding[k + order]
            if here < error:
                best, error = value, here
        table.append(after)
    return best, error


def influences(name, params):
    """By rule: what the settings leave in force, but what only the covariance sees."""
    return name in parameters.active(params) and name not in COVARIANCE_ONLY


@pytest.fixture(scope="module")
def everything(truth, scored):
    """Of every leaf but those of an aid that is off, which are no part of the program (test_assembly)."""
    return Loss(truth, scored, "shoe", [n for n in tools.LEAVES if not n.startswith("heuristic.")])


@pytest.fixture(scope="module")
def reverse(everything):
    return everything.gradient()


def assert_equal_slopes(gradient, differences, names, tolerance=1e-5):
    """Within the tolerance, to which the differences themselves must be known."""
    slopes = {name: differences[name] for name in names}
    vague = {n: (slope, error) for n, (slope, error) in slopes.items() if error > tolerance * abs(slope)}
    assert not vague, "differences that are not good enough to judge by"
    worst = {n: abs(gradient[n] - slope) / abs(slope) for n, (slope, _) in slopes.items()}
    assert max(worst.values()) < tolerance, {n: w for n, w in worst.items() if w >= tolerance}
    return worst


@pytest.mark.slow
def test_reverse_gradient_of_every_leaf_equals_differences(everything, reverse):
    loss, gradient = reverse
    assert 0.01 < loss < 10
    differences, spread = everything.differences()
    alive = [n for n in everything.names if influences(n, everything.params)]
    dead = [n for n in everything.names if not influences(n, everything.params)]
    assert {"stance.ared.threshold", "initial.align.gain", "initial.position"} <= set(dead)
    assert len(alive) >= 20
    worst = assert_equal_slopes(gradient, differences, alive)
    print({name: f"{error:.1e}" for name, error in worst.items()})
    for name in dead:
        assert gradient[name] == 0.0, name
        assert spread[everything.names.index(name)] == 0.0, name


FORWARD = ("stance.shoe.threshold", "process.gyroscope")


@pytest.fixture(scope="module")
def forward(everything):
    free = {n: everything.free[n] for n in FORWARD}
    problem = everything.problem
    loss, gradient = objective.soft_loss_and_gradient_forward(
        problem, everything.cast, free, everything.batch
    )
    return float(loss[0]), {n: float(g[0]) for n, g in gradient.items()}


def test_forward_gradient_equals_differences(truth, scored, forward):
    differences, _ = Loss(truth, scored, "shoe", FORWARD).differences()
    assert_equal_slopes(forward[1], differences, FORWARD)


@pytest.mark.slow
def test_forward_gradient_equals_reverse(forward, reverse):
    assert forward[0] == pytest.approx(reverse[0], rel=1e-12)
    for name in FORWARD:
        assert forward[1][name] == pytest.approx(reverse[1][name], rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("detector", [d for d in DETECTORS if d != "shoe"])
def test_thresholds_of_the_other_detectors(truth, scored, detector):
    names = [n for n in tools.LEAVES if n.startswith(f"stance.{detector}.")]
    loss = Loss(truth, scored, detector, [*names, "stance.shoe.threshold"])
    _, gradient = loss.gradient()
    # small steps: the worst of EPS's five and the bounded level bend where two of them cross
    differences, spread = loss.differences(2e-3)
    matter = [n for i, n in enumerate(names) if spread[i] > 0]
    assert matter
    assert_equal_slopes(gradient, differences, matter)
    for name in set(loss.names) - set(matter):  # a limit of EPS that is never the worst of the five
        assert gradient[name] == 0.0
    assert "stance.shoe.threshold" not in matter


def still(imu, force, rate=0.0):
    shape = imu.specific_force.shape
    found = replace(
        imu,
        specific_force=np.broadcast_to(np.asarray(force, float), shape),
        angular_rate=np.full(shape, rate),
    )
    return {"foot": found}


DEGENERATE = {
    "a foot that never moves": lambda w: replace(w, sensors=still(w.imu, [0.3, -0.2, 9.79])),
    "no force at all": lambda w: replace(w, sensors=still(w.imu, [0.0, 0.0, 0.0])),
    "gimbal lock at rest": lambda w: replace(w, sensors=still(w.imu, [-9.8029, 0.0, 0.0])),
    "exactly gravity": lambda w: replace(w, sensors=still(w.imu, [0.0, 0.0, 9.8029])),
    "all landmarks equal": lambda w: replace(w, position=np.zeros_like(w.position)),
    "a single landmark": lambda w: replace(
        w, position=np.where(np.arange(len(w.index))[:, None] == 2, w.position, np.nan)
    ),
    "no landmark at all": lambda w: replace(w, position=np.full_like(w.position, np.nan)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", DEGENERATE)
@pytest.mark.parametrize("width", ["soft", "hard"])
def test_gradients_are_finite_at_degenerate_inputs(everything, scored, kind, width):
    batch = pack_all(IEZ, everything.cast, [DEGENERATE[kind](scored)])
    free = {"gate.width": jnp.array([-1e4])} if width == "hard" else {}
    loss, gradient = everything.gradient(batch, **free)
    assert np.isfinite(loss)
    assert np.isfinite(list(gradient.values())).all(), [n for n, g in gradient.items() if not np.isfinite(g)]


@pytest.mark.slow
def test_gradient_is_finite_where_the_gate_ties(everything, scored):
    """The statistic of a still foot sits on its threshold, for every sample."""
    away = (9.79 - 9.8029) ** 2 / VALUES["stance.shoe.sigma_accelerometer"] ** 2
    tie = Loss.__new__(Loss)
    tie.__dict__ = {**everything.__dict__}
    tie.batch = pack_all(IEZ, everything.cast, [replace(scored, sensors=still(scored.imu, [0.0, 0.0, 9.79]))])
    tie.cast = parameters.with_leaves(everything.cast, {})
    sigma = np.sqrt((9.79 - 9.8029) ** 2 / 1e3)
    for width in (-1e4, float(everything.free["gate.width"][0])):
        free = {
            "stance.shoe.sigma_accelerometer": jnp.array(
                [everything.specs["stance.shoe.sigma_accelerometer"].to_free(sigma)]
            ),
            "stance.shoe.threshold": jnp.array(
                [everything.specs["stance.shoe.threshold"].to_free(1e3 * (1 + 1e-3))]
            ),
            "gate.width": jnp.array([width]),
        }
        assert away > 0
        _, gradient = tie.gradient(tie.batch, **free)
        assert np.isfinite(list(gradient.values())).all()


@pytest.mark.slow
def test_bounds_themselves_have_finite_gradients(everything):
    for far in (-1e3, 1e3):
        loss, gradient = everything.gradient(
            **{"gate.follow": jnp.array([far]), "gate.floor": jnp.array([far])}
        )
        assert np.isfinite([loss, *gradient.values()]).all()
