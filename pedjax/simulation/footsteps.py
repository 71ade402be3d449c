"""Where and when the feet are put down: from legs of a walk to the swings of both feet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.shapes import bucket
from pedjax.simulation.gait import Sway, Swings, Walker

_FAR = 1e6  # s, a time that no walk reaches
_SHARPEST = math.radians(80)
_WALKING = 2.2  # s between two landings of a foot, above which it stands
_STANDS_STILL = 0.02  # how much less a foot sways in standing than in walking
_REST = 0.04  # s, the least that a foot is flat on the ground


@dataclass(frozen=True)
class Gait:
    """How somebody walks.

    `speed` m/s and `step_s`, s a step; `swing` share of a stride that a foot goes forward; `lift`, `aside`,
    `width` m; `toe_off`, `heel_strike`, `roll`, `toe_out` rad; `push`, `settle` shares of a stride;
    `steepest`, `toe_up`, `highest` shares of a swing; `shock` m; `slip` m, `unrest` rad (sway of a standing
    sole) and `ground` rad (its slope) as standard deviations; `spread` the relative standard deviation of
    step length and time. How a foot turns is fitted to recorded strides (`experiments/gait_fit.py`).
    """

    speed: float = 1.2
    step_s: float = 0.58
    swing: float = 0.52
    lift: float = 0.02
    aside: float = 0.02
    width: float = 0.16
    toe_off: float = 0.94
    heel_strike: float = 0.46
    roll: float = 0.36
    toe_out: float = 0.12
    push: float = 0.1
    settle: float = 0.09
    steepest: float = 0.29
    toe_up: float = 0.81
    highest: float = 0.3
    shock: float = 0.0008
    slip: float = 0.0008
    unrest: float = 0.06
    ground: float = 0.015
    spread: float = 0.02


GAITS: dict[str, Gait] = {
    "walk": Gait(),
    "slow": Gait(
        speed=0.75, step_s=0.7, swing=0.47, settle=0.11, toe_off=0.74, heel_strike=0.38, roll=0.5,
        steepest=0.27, toe_up=0.78, shock=0.0004, unrest=0.05,
    ),
    "fast": Gait(
        speed=1.9, step_s=0.47, swing=0.63, push=0.2, settle=0.05, toe_off=1.14, heel_strike=0.48, roll=0.4,
        steepest=0.3, shock=0.001, unrest=0.09,
    ),
    "run": Gait(
        speed=2.7, step_s=0.37, swing=0.63, push=0.16, settle=0.1, toe_off=1.0, heel_strike=0.58, roll=0.43,
        steepest=0.31, toe_up=0.93, lift=0.13, highest=0.42, shock=0.0015, width=0.1, unrest=0.1,
    ),
    "stairs": Gait(
        speed=0.5, step_s=0.62, swing=0.38, lift=0.07, toe_off=0.6, heel_strike=0.1, roll=0.2, push=0.14,
        highest=0.45, shock=0.0006,
    ),
}  # fmt: skip
"""Gaits by name."""


@dataclass(frozen=True)
class Leg:
    """A part of a walk.

    `kind`: `walk` along `points (N, 2)` m (a polyline whose corners are rounded by `radius` m, or a `spline`
    through them), or round a `circle` of that radius in m from where the walker stands (left where positive),
    rising by `climb` m; `stand` for `seconds`; `turn` on the spot by `angle` deg; `side` steps over
    `distance` m to the left; `stairs`: `steps` of `rise` and `run` m straight ahead; `elevator`: `climb` m in
    `seconds`.
    """

    kind: str = "walk"
    points: tuple[tuple[float, float], ...] = ()
    circle: float = 0.0
    spline: bool = False
    radius: float = 0.8
    gait: str = "walk"
    speed: float | None = None
    climb: float = 0.0
    seconds: float = 0.0
    angle: float = 0.0
    distance: float = 0.0
    steps: int = 0
    rise: float = 0.16
    run: float = 0.29
    repeat: int = 1


KINDS = ("walk", "stand", "turn", "side", "stairs", "elevator")


class Plan(NamedTuple):
    """A walk as it is going to happen: the `walker`, how long it takes in s, the `route (K, 3)` m that it
    follows, and how many steps it has."""

    walker: Walker
    seconds: float
    route: np.ndarray
    steps: int


@dataclass
class _Feet:
    """The walk so far."""

    rng: np.random.Generator
    time: float = 0.0
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    heading: float = 0.0
    next_side: int = 0
    swings: tuple[list[dict[str, Any]], list[dict[str, Any]]] = field(default_factory=lambda: ([], []))
    place: list[np.ndarray] = field(default_factory=list)
    facing: list[float] = field(default_factory=list)
    ground: list[np.ndarray] = field(default_factory=list)
    lifts: list[tuple[float, float, float]] = field(default_factory=list)
    route: list[np.ndarray] = field(default_factory=list)

    def step(self, centre: np.ndarray, heading: float, gait: Gait, duration: float | None = None) -> None:
        """Put the next foot down beside a place that the walker heads over."""
        side, rng = self.next_side, self.rng
        length = gait.step_s * max(rng.normal(1.0, gait.spread), 0.7) if duration is None else duration
        own = beside(centre, heading, side, gait)
        own[:2] += rng.normal(0.0, 0.5 * gait.spread, 2) * gait.speed * gait.step_s
        facing = heading + (gait.toe_out if side == 0 else -gait.toe_out) + rng.normal(0.0, 0.02)
        stride = 2 * length
        flight = gait.swing * stride
        if self.swings[side]:  # the same foot twice, or a change of gait: it must have come to rest before
            last = self.swings[side][-1]
            rises = self.time + length - flight - gait.push * stride
            self.time += max(last["lands"] + last["settle"] + _REST - rises, 0.0)
        lands = self.time + length
        slip = np.array([*rng.normal(0.0, gait.slip, 2), 0.0])
        rest = rng.normal(0.0, gait.ground, 2)
        style = np.exp(rng.normal(0.0, gait.spread, 4))
        self.swings[side].append(
            {
                "leaves": lands - flight, "lands": lands, "start": self.place[side], "end": own,
                "heading": self.facing[side], "turn": facing - self.facing[side],
                "lift": gait.lift * style[0], "aside": gait.aside * (1 if side == 0 else -1),
                "toe_off": gait.toe_off * style[1], "heel_strike": gait.heel_strike * style[2],
                "roll": gait.roll * (1 if side == 0 else -1),
                "push": gait.push * stride, "settle": gait.settle * stride,
                "steepest": gait.steepest, "toe_up": gait.toe_up, "highest": gait.highest,
                "shock": gait.shock * style[3],
                "slip": slip, "rest_before": self.ground[side], "rest": rest, "sway": gait.unrest,
            }
        )  # fmt: skip
        self.place[side], self.facing[side], self.ground[side] = own + slip, facing, rest
        self.centre, self.heading, self.time, self.next_side = centre, heading, self.time + length, 1 - side
        self.route.append(centre)


def beside(centre: np.ndarray, heading: float, side: int, gait: Gait) -> np.ndarray:
    """Where a foot stands beside the walker's line: left (0) or right (1)."""
    across = np.array([-math.sin(heading), math.cos(heading), 0.0])
    return centre + (0.5 if side == 0 else -0.5) * gait.width * across


def footsteps(legs: Sequence[Leg], seed: int, standing: float = 2.0, origin: str = "walk") -> Plan:
    """The swings of both feet along the legs, after and before `standing` s; the same for the same seed."""
    rng = np.random.default_rng([31, seed])
    feet = _Feet(rng)
    first = next((leg for leg in legs if leg.kind == "walk"), None)
    if first is not None:
        path = _path(first, np.zeros(2), f"{origin}: leg {list(legs).index(first) + 1}")
        feet.centre, feet.heading = np.array([*path[0, :2], 0.0]), float(path[0, 2])
    for side in (0, 1):
        feet.place.append(beside(feet.centre, feet.heading, side, GAITS["walk"]))
        feet.facing.append(feet.heading + (0.12 if side == 0 else -0.12))
        feet.ground.append(rng.normal(0.0, 0.015, 2))
    feet.route.append(feet.centre)
    feet.time = standing
    for number, leg in enumerate(legs, 1):
        _check(leg, f"{origin}: leg {number}")
        once, times = (_joined(leg), 1) if _is_closed(leg) else (leg, leg.repeat)
        for _ in range(times):
            _DO[leg.kind](feet, once, f"{origin}: leg {number}")
    feet.time += standing
    longest = bucket(max(len(s) for s in feet.swings) + 1, 1)
    left, right = (_stacked(side, longest, feet, i) for i, side in enumerate(feet.swings))
    share: Any = np.abs(rng.normal(0.0, 1.0, (2, 3))) * [1.0, 0.35, 0.02]
    hertz = np.array([[0.7, 2.3, 6.1], [0.9, 1.9, 7.3]]) * rng.uniform(0.8, 1.2, (2, 3))
    frequency: Any = 2 * np.pi * hertz
    phase: Any = rng.uniform(0, 2 * np.pi, (2, 3))
    sway = Sway(share, frequency, phase)
    lifts: Any = np.array([*feet.lifts, *[(_FAR, _FAR + 1, 0.0)] * (8 - len(feet.lifts))])
    walker = Walker(left, right, sway, lifts)
    return Plan(walker, feet.time, np.array(feet.route), sum(len(s) for s in feet.swings))


def _is_closed(leg: Leg) -> bool:
    return leg.kind == "walk" and len(leg.points) > 2 and leg.points[0] == leg.points[-1]


def _joined(leg: Leg) -> Leg:
    """A closed line's repetitions as one line, whose joints are corners like any other."""
    return replace(leg, points=leg.points[:1] + leg.points[1:] * leg.repeat, repeat=1)


def _check(leg: Leg, where: str) -> None:
    if leg.kind not in KINDS:
        raise InputError(f"{where}: kind '{leg.kind}' is unknown{suggest(leg.kind, KINDS)}")
    if leg.gait not in GAITS:
        raise InputError(f"{where}: gait '{leg.gait}' is unknown{suggest(leg.gait, GAITS)}")
    if leg.speed is not None and not 0.1 <= leg.speed <= 6:
        raise InputError(f"{where}: speed = {leg.speed:g} m/s must lie between 0.1 and 6")
    if leg.repeat < 1 or leg.repeat != int(leg.repeat):
        raise InputError(f"{where}: repeat = {leg.repeat!r} must be a whole number from 1 on")
    if leg.kind in ("stand", "elevator") and not leg.seconds > 0:
        raise InputError(f"{where}: seconds = {leg.seconds:g} must be positive")
    if leg.kind == "elevator" and abs(leg.climb) / leg.seconds > 5:
        raise InputError(f"{where}: an elevator that goes {leg.climb:g} m in {leg.seconds:g} s is too fast")
    if leg.kind == "stairs" and (leg.steps < 1 or not 0.1 <= leg.run <= 0.6 or abs(leg.rise) > 0.3):
        raise InputError(f"{where}: stairs need steps, a run of 0.1 to 0.6 m and a rise of at most 0.3 m")


def _gait(leg: Leg) -> Gait:
    """The leg's gait; another speed changes step length and cadence alike, as people do."""
    gait = GAITS[leg.gait]
    if leg.speed is None:
        return gait
    factor = math.sqrt(leg.speed / gait.speed)
    return replace(gait, speed=leg.speed, step_s=gait.step_s / factor)


def _path(leg: Leg, here: np.ndarray, where: str, heading: float = 0.0) -> np.ndarray:
    """The leg's line at every centimetre: `(K, 3)` x, y and heading (continuous)."""
    if leg.circle:
        turned = np.arange(0.0, 2 * np.pi, 0.01 / abs(leg.circle))
        sense, radius = math.copysign(1.0, leg.circle), abs(leg.circle)
        angle = heading + sense * turned
        across = sense * radius * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        return np.column_stack([here - across + across[0], angle])
    points = np.array(leg.points, float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise InputError(f"{where}: points must be two or more [x, y] in m")
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if (apart < 1e-6).any():
        raise InputError(f"{where}: points {int(apart.argmin()) + 1} and the next are the same")
    if leg.spline:
        from scipy.interpolate import CubicSpline  # here: it takes a third of pedjax's start

        s = np.concatenate([[0.0], np.cumsum(apart)])
        closed = np.allclose(points[0], points[-1])
        line = CubicSpline(s, points, bc_type="periodic" if closed else "not-a-knot")
        dense = line(np.linspace(0, s[-1], max(int(s[-1] / 0.01), 2)))
    else:
        dense = _rounded(points, leg.radius, where)
    step = np.linalg.norm(np.diff(dense, axis=0), axis=1)
    s = np.concatenate([[0.0], np.cumsum(step)])
    even = np.arange(0.0, s[-1], 0.01)
    xy = np.stack([np.interp(even, s, dense[:, k]) for k in range(2)], axis=1)
    heading = np.unwrap(np.arctan2(np.diff(dense[:, 1]), np.diff(dense[:, 0])))
    along = np.interp(even, 0.5 * (s[1:] + s[:-1]), heading)
    return np.column_stack([xy, along])


def _rounded(points: np.ndarray, radius: float, where: str) -> np.ndarray:
    """A polyline whose corners are arcs, which may follow each other without a straight in between."""
    if not radius > 0:
        raise InputError(f"{where}: radius = {radius:g} m must be positive")
    sides = np.diff(points, axis=0)
    lengths = np.linalg.norm(sides, axis=1)
    ahead = sides / lengths[:, None]
    turned = np.zeros(len(points))  # at each point, to the left
    across = ahead[:-1, 0] * ahead[1:, 1] - ahead[:-1, 1] * ahead[1:, 0]
    turned[1:-1] = np.arctan2(across, (ahead[:-1] * ahead[1:]).sum(axis=1))
    for (x, y), angle in zip(points, np.degrees(abs(turned)), strict=True):
        if angle > 170:
            raise InputError(
                f"{where}: the corner at ({x:g}, {y:g}) turns back by {angle:.0f} degrees; end the leg there "
                "and add a leg of kind 'turn'"
            )
    back = radius * np.tan(abs(turned) / 2)
    short = lengths - back[:-1] - back[1:]
    if (short < -1e-9).any():
        k = int(short.argmin())
        (x, y), (to_x, to_y) = points[k : k + 2]
        raise InputError(
            f"{where}: from ({x:g}, {y:g}) to ({to_x:g}, {to_y:g}) are {lengths[k]:.2f} m, but the corners "
            f"at its ends need {back[k] + back[k + 1]:.2f} m for a radius of {radius:g} m; lower radius"
        )
    parts = [points[:1]]
    for k in np.flatnonzero(abs(turned) > 1e-3).tolist():
        begin = points[k] - back[k] * ahead[k - 1]
        side = math.copysign(radius, turned[k])
        middle = begin + side * np.array([-ahead[k - 1, 1], ahead[k - 1, 0]])
        angles = np.linspace(0.0, turned[k], max(int(radius * abs(turned[k]) / 0.005), 3))
        c, s = np.cos(angles), np.sin(angles)
        x, y = begin - middle
        parts.append(middle + np.column_stack([c * x - s * y, s * x + c * y]))
    dense = np.concatenate([*parts, points[-1:]])
    moves = np.linalg.norm(np.diff(dense, axis=0), axis=1) > 1e-6  # where arcs touch, one point of the two
    return dense[np.concatenate([[True], moves])]


def _walk(feet: _Feet, leg: Leg, where: str) -> None:
    gait = _gait(leg)
    path = _path(leg, feet.centre[:2], where, feet.heading)
    gap = float(np.linalg.norm(path[0, :2] - feet.centre[:2]))
    if gap > 1.5 * gait.speed * gait.step_s:
        raise InputError(f"{where}: begins {gap:.2f} m from where the leg before it ends")
    path[:, 2] += 2 * np.pi * round((feet.heading - path[0, 2]) / (2 * np.pi))
    if abs(path[0, 2] - feet.heading) > 0.5 * _SHARPEST:  # they face the way before they set out
        _turn(feet, Leg("turn", angle=math.degrees(path[0, 2] - feet.heading)), where)
    total, base = 0.01 * (len(path) - 1), feet.centre[2]
    along = 0.0
    while along < total - 1e-9:
        length = gait.speed * gait.step_s * max(feet.rng.normal(1.0, gait.spread), 0.5)
        length *= 0.6 if along == 0 else 1.0
        along = total if total - along < 1.4 * length else along + length
        x, y, heading = path[min(round(along / 0.01), len(path) - 1)]
        if abs(heading - feet.heading) > _SHARPEST:
            by = math.degrees(abs(heading - feet.heading))
            raise InputError(
                f"{where}: at ({x:.1f}, {y:.1f}) the line turns by {by:.0f} degrees in one step, more than a "
                f"foot can ({math.degrees(_SHARPEST):.0f}); round the corner with a larger radius, or walk "
                "slower"
            )
        feet.step(np.array([x, y, base + leg.climb * along / total]), float(heading), gait)
    feet.step(feet.centre, feet.heading, gait)  # the feet come together


def _stand(feet: _Feet, leg: Leg, where: str) -> None:
    feet.time += leg.seconds


def _turn(feet: _Feet, leg: Leg, where: str) -> None:
    gait = replace(GAITS["slow"], toe_off=0.3, heel_strike=0.05, lift=0.04)
    count = max(math.ceil(abs(leg.angle) / 40.0), 1)
    goal = feet.heading + math.radians(leg.angle)
    for heading in np.linspace(feet.heading, goal, count + 1)[1:]:
        for _ in range(2):
            feet.step(feet.centre, float(heading), gait)


def _side(feet: _Feet, leg: Leg, where: str) -> None:
    gait = replace(GAITS["slow"], toe_off=0.15, heel_strike=0.03, lift=0.04)
    count = max(math.ceil(abs(leg.distance) / 0.3), 1)
    across = np.array([-math.sin(feet.heading), math.cos(feet.heading), 0.0])
    goal = feet.centre + leg.distance * across
    feet.next_side = 0 if leg.distance > 0 else 1
    for part in np.linspace(0.0, 1.0, count + 1)[1:]:
        centre = goal - (1 - part) * leg.distance * across
        for _ in range(2):
            feet.step(centre, feet.heading, gait)


def _stairs(feet: _Feet, leg: Leg, where: str) -> None:
    gait = _gait(replace(leg, gait="stairs"))
    ahead = np.array([leg.run * math.cos(feet.heading), leg.run * math.sin(feet.heading), leg.rise])
    gait = replace(gait, lift=gait.lift + 0.25 * abs(leg.rise))
    for _ in range(leg.steps):
        feet.step(feet.centre + ahead, feet.heading, gait)
    feet.step(feet.centre, feet.heading, gait)


def _elevator(feet: _Feet, leg: Leg, where: str) -> None:
    if len(feet.lifts) == 8:
        raise InputError(f"{where}: more than eight elevator rides in one walk")
    feet.lifts.append((feet.time + 1.0, feet.time + 1.0 + leg.seconds, leg.climb))
    feet.time += leg.seconds + 2.0


_DO = {
    "walk": _walk, "stand": _stand, "turn": _turn, "side": _side, "stairs": _stairs, "elevator": _elevator,
}  # fmt: skip


def _stacked(swings: list[dict[str, Any]], longest: int, feet: _Feet, side: int) -> Swings:
    """The swings of one foot as arrays, filled up with swings that never come."""
    last = {
        "leaves": _FAR, "lands": _FAR + 1, "start": feet.place[side], "end": feet.place[side],
        "heading": feet.facing[side], "turn": 0.0, "lift": 0.0, "aside": 0.0, "toe_off": 0.0,
        "heel_strike": 0.0, "roll": 0.0, "push": 0.1, "settle": 0.1, "steepest": 0.3, "toe_up": 0.8,
        "highest": 0.4, "shock": 0.0, "slip": np.zeros(3),
        "rest_before": feet.ground[side], "rest": feet.ground[side], "sway": GAITS["walk"].unrest,
    }  # fmt: skip
    never = [
        {**last, "leaves": _FAR + 10 * k, "lands": _FAR + 10 * k + 1} for k in range(longest - len(swings))
    ]
    filled = [*swings, *never]
    stances = np.diff([0.0, *(s["lands"] for s in filled), 3 * _FAR + 10 * longest])
    calm = [1.0 if t < _WALKING else _STANDS_STILL for t in stances[1:]]
    sways = [swing["sway"] * c for swing, c in zip(filled, calm, strict=True)]
    for swing, before, after in zip(filled, [_STANDS_STILL * filled[0]["sway"], *sways], sways, strict=False):
        swing |= {"unrest_before": before, "unrest": after}
    ends = np.array([s["lands"] + s["settle"] for s in filled[:-1]])
    begins = np.array([s["leaves"] - s["push"] for s in filled[1:]])
    border: Any = np.concatenate([[-_FAR], 0.5 * (ends + begins), [2 * _FAR + 10 * longest]])
    columns: list[Any] = [np.array([s[name] for s in filled], float) for name in Swings._fields[1:]]
    return Swings(border, *columns)
