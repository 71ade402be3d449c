"""One recording through one system: the track."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import filtering, parameters, prior, rotations
from pedjax.detectors.segments import clean_stance, stance_id
from pedjax.errors import InputError, suggest
from pedjax.preparing import prepare
from pedjax.recording import Clock, Recording
from pedjax.shapes import bucket
from pedjax.system import Inputs, Output, System
from pedjax.systems import system as find_system
from pedjax.walks import Sensors, Walk, check_walk, sensor_names
from pedjax.walks import walk as as_walk

_LONG_GAP = 3.0  # s without an update after which an inertial filter has lost its way


@dataclass(frozen=True)
class Gate:
    """A gate over a walk: its `weight (T,)` in [0, 1], and the `log_ratio (T,)` of its statistic over its
    threshold."""

    weight: np.ndarray
    log_ratio: np.ndarray

    @property
    def open(self) -> np.ndarray:
        """`(T,)` bool: where it lets more through than it keeps out."""
        return self.weight > 0.5

    def stretches(self, time: np.ndarray, merge_s: float = 0.05, drop_s: float = 0.08) -> np.ndarray:
        """`(T,)` int: 0, 1, 2, ... in each stretch where it is open, −1 outside, after gaps shorter than
        `merge_s` are filled and stretches shorter than `drop_s` dropped (not causal)."""
        dt = jnp.asarray(np.diff(time, prepend=time[0]))
        return np.asarray(stance_id(clean_stance(jnp.asarray(self.open), dt, merge_s, drop_s)))


@dataclass(frozen=True)
class Track:
    """What a run puts out, numpy, time first.

    `time (T,)` s; `estimate` by name, of which `position (T, 3)` m in ENU from the start at the origin and
    `attitude (T, 3, 3)` body to navigation are always there; `sigma (T, 3)` standard deviations by the
    name of the estimate; `gates` by name, the first of which bounds the drift; `euler (T, 3)` roll, pitch,
    yaw in rad;
    `more` what the system says beside, by name, `(T, ...)`. `status (T,)` is 0 while the filter is well, and
    from its first fault on says which; `healthy` is false where there was one, or where the first gate never
    opened; `warnings` says what to look at. `sensor` is the one whose track it is.
    """

    name: str
    system: str
    sensor: str
    time: np.ndarray
    estimate: dict[str, np.ndarray]
    sigma: dict[str, np.ndarray]
    gates: dict[str, Gate]
    euler: np.ndarray
    status: np.ndarray
    healthy: bool
    warnings: tuple[str, ...]
    more: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def position(self) -> np.ndarray:
        """`(T, 3)` m."""
        return self.estimate["position"]

    @property
    def attitude(self) -> np.ndarray:
        """`(T, 3, 3)`, body to navigation."""
        return self.estimate["attitude"]

    @property
    def distance(self) -> float:
        """Horizontal path length in m, from positions 0.1 s apart."""
        step = max(round(0.1 / float(np.median(np.diff(self.time)))), 1)
        path = np.concatenate([self.position[::step, :2], self.position[-1:, :2]])
        return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())

    def gate(self, name: str) -> Gate:
        """The gate of that name; an unknown one is an `InputError` with a suggestion."""
        if name not in self.gates:
            raise InputError(f"the system '{self.system}' has no gate '{name}'{suggest(name, self.gates)}")
        return self.gates[name]


@partial(jax.jit, static_argnames="system")
def _scan(system: System, params: Any, site: Any, inputs: Inputs) -> Output:
    state = system.start(params, site, inputs.opening)
    return filtering.scan(system, params, site, inputs.samples, state)[1]


def run(
    recording: Recording,
    system: str | System = "iez",
    params: Any = None,
    *,
    sensor: Sensors = None,
    clock: Clock | None = None,
    site: Any = None,
    passes: int = 1,
) -> Track:
    """Run a system over a recording (`params`: default the published ones) in JAX's current precision.

    `sensor` is the name of the one that plays the system's first role, or names by role; `site` is what a
    system that needs one is to know of the place, a magnetic map. With two `passes` the walk is run once more
    from the biases that the first run ended with (`prior.second_pass`), which is not causal.
    """
    chosen = find_system(system)
    params = chosen.defaults() if params is None else params
    if passes not in (1, 2):
        raise InputError(f"passes = {passes} must be 1 or 2")
    if passes == 2:
        first = run(recording, chosen, params, sensor=sensor, clock=clock, site=site)
        if not first.healthy:
            return first  # it says why, and has nothing to tell to a second
        params = prior.second_pass(params, first)
    walk = as_walk(recording, sensor, clock, needs=chosen.needs)
    check_walk(chosen, params, walk)
    dtype = jnp.result_type(float)
    length = len(walk)
    params = parameters.cast(params, dtype)
    inputs = prepare(chosen, params, walk, dtype, bucket(length))
    output = jax.tree.map(lambda x: np.asarray(x)[:length], _scan(chosen, params, site, inputs))
    attitude = jnp.moveaxis(jnp.asarray(output.estimate.attitude), 0, -1)
    gates = {name: Gate(*output.gates[name]) for name in chosen.gates}
    faults = np.flatnonzero(output.status)
    status = np.zeros(length, np.int32)
    if len(faults):
        status[faults[0] :] = output.status[faults[0]]
    opened = not gates or bool(next(iter(gates.values())).open.any())
    names = sensor_names(chosen.needs, sensor)
    return Track(
        name=recording.name,
        system=chosen.name,
        sensor=names[chosen.needs[0].role],
        time=walk.imu.time,
        estimate=output.estimate._asdict(),
        sigma=output.sigma,
        gates=gates,
        euler=np.asarray(jax.jit(rotations.to_euler)(attitude)).T,
        status=status,
        healthy=not len(faults) and opened,
        warnings=(
            *_warnings(chosen, walk, status, gates, names),
            *_of_field(params, output.more),
        ),
        more=output.more,
    )


def _warnings(
    system: System, walk: Walk, status: np.ndarray, gates: dict[str, Gate], names: dict[str, str]
) -> list[str]:
    notes = []
    if status[-1]:
        first = int(np.argmax(status > 0))
        notes.append(f"{system.reason(int(status[-1]))}, at {walk.imu.time[first]:.2f} s")
    notes += [note for name, gate in list(gates.items())[:1] for note in _of_gate(name, gate, walk)]
    first_role = system.needs[0].role
    if first_role == "foot" and not names["foot"].startswith("foot"):
        notes.append(f"sensor '{names['foot']}' is not on a foot, where alone zero-velocity updates hold")
    return notes


_ODD_STRENGTH, _ODD_DIP = 0.15, math.radians(10.0)


def _of_field(params: Any, more: dict[str, np.ndarray]) -> list[str]:
    """Whether the looks at the field fit the earth's field that was given, and the first yaw what later clean
    fields say of it."""
    notes, looked = [], more.get("look", np.zeros(0)) > 0
    q = getattr(params, "compass", None)
    if q is not None and looked.any() and getattr(q, "reference", "") == "given":
        field = more["magnetic_field"][looked]
        size = float(np.median(np.linalg.norm(field, axis=1)))
        dip = float(np.median(np.arctan2(-field[:, 2], np.linalg.norm(field[:, :2], axis=1))))
        if abs(size / float(q.strength) - 1) > _ODD_STRENGTH or abs(dip - float(q.inclination)) > _ODD_DIP:
            notes.append(
                f"the field is {size:.1f} uT strong and dips {math.degrees(dip):.0f} degrees in the median, "
                f"where compass.strength says {float(q.strength):.1f} and compass.inclination "
                f"{math.degrees(float(q.inclination)):.0f}: look them up for the place, or set "
                "compass.reference = running"
            )
    if "start_error" in more and len(more["start_error"]):
        error, sigma = float(more["start_error"][-1]), float(more["start_error_sigma"][-1])
        mended = bool(more["start_mended"][-1] > 0)
        if abs(error) > max(4 * sigma, math.radians(5.0)):
            told = "the path was turned" if mended else "initial.align.check = mend turns the path by it"
            notes.append(
                f"later clean fields turn the first yaw by {math.degrees(error):+.0f} degrees "
                f"(standard deviation {math.degrees(sigma):.0f}): {told}"
            )
    return notes


def _of_gate(name: str, gate: Gate, walk: Walk) -> list[str]:
    """What looks wrong with the gate that bounds the drift."""
    role, time = next(iter(walk.sensors)), walk.imu.time
    if not gate.open.any():
        if name == "field":
            return ["no field at all: no reading was as reference.state.level and .down expect; look them up"]
        place = "in the pocket" if role == "pocket" else f"on the {role}"
        return [f"no {name} at all: raise the detector's threshold, or is the sensor {place}?"]
    notes = []
    edges = np.concatenate([[0], np.flatnonzero(gate.open), [len(time) - 1]])
    gaps = np.diff(time[edges])
    if gaps.max() > _LONG_GAP:
        start = time[edges[int(gaps.argmax())]]
        drifts = "heading" if name == "field" else "position"
        notes.append(f"{gaps.max():.1f} s without {name} from {start:.1f} s on: the {drifts} drifts there")
    if name == "stance" and gate.open.mean() > 0.97:
        notes.append("still almost all the time: lower the detector's threshold, or nobody walked")
    return notes
