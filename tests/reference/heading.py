"""What straight walking says of the yaw, and rivals of a heading, as naive loops, scalar by scalar, float64.

Headings in rad, the oldest first. Rows are on the error of the estimate, truth = estimate + error: a row on
the yaw has the innovation told - estimated; one on the gyroscope's bias what the yaw drifts by in rad/s.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference import filter as dense
from tests.reference.field import wrapped

Array = NDArray[np.float64]


def circular_mean(headings: list[float]) -> float:
    """Direction of the sum of unit vectors."""
    total = 0j
    for x in headings:
        total += np.exp(1j * x)
    return float(np.angle(total))


def change(headings: list[float]) -> float:
    """Of the last from the mean of those before it."""
    return abs(wrapped(headings[-1] - circular_mean(headings[:-1])))


def spread(headings: list[float]) -> float:
    """The largest distance from the mean of all."""
    return max(abs(wrapped(x - circular_mean(headings))) for x in headings)


def away(heading: float, axis: float, count: int) -> float:
    """Deviation from the nearest of ``count`` directions in a full turn, one of which is ``axis``."""
    every = [wrapped(heading - (axis + k * 2 * np.pi / count)) for k in range(count)]
    return min(every, key=abs)


class Told(NamedTuple):
    """A row H (3,) on a state ("t" or "g") and its weight; or a move (3,) of the gyroscope's bias, and one of
    the yaw."""

    state: str = ""
    H: Array | None = None
    innovation: float = 0.0
    variance: float = 0.0
    weight: float = 0.0
    bias: Array | None = None
    yaw: float | None = None


UP = np.array([0.0, 0.0, 1.0])


def on_yaw(innovation: float, sigma: float, weight: float) -> Told:
    return Told("t", UP, innovation, sigma**2, weight)


def hdr(p: Any, s: dict[str, Any]) -> Told:
    """The mean of the strides before is the heading; off a straight: nothing, or an innovation of zero."""
    back = wrapped(circular_mean(s["headings"][:-1]) - s["headings"][-1])
    if p.hdr.on_curve == "zero":
        return on_yaw(s["straight"] * back, p.hdr.sigma, 1.0)
    return on_yaw(back, p.hdr.sigma, s["straight"])


def slope(p: Any, s: dict[str, Any]) -> Told:
    """A line through the run's headings over time, by least squares; its slope is c . g."""
    times, yaws, ups = (np.array(s["run"][name]) for name in ("times", "yaws", "ups"))
    steepness = float(np.polyfit(times - times[0], yaws, 1)[0])
    variance = p.slope.sigma**2 / float(np.sum((times - times.mean()) ** 2))
    H = ups.mean(axis=0)
    square = steepness**2 / (H @ s["P"][3:6, 3:6] @ H + variance)
    counts = len(times) >= p.slope.least and square < p.slope.far**2
    return Told("g", H, steepness, variance, s["over"] if counts else 0.0)


def integrator(p: Any, s: dict[str, Any]) -> Told:
    turn = wrapped(s["headings"][-1] - s["headings"][-2]) / s["seconds"]
    gain = p.integrator.gain * np.tanh(turn / p.integrator.softness)
    return Told(weight=s["straight"], bias=gain * s["up"])


def hde(p: Any, s: dict[str, Any]) -> Told:
    side = np.tanh(s["away"] / p.hde.softness)
    turn = -p.hde.turn * p.hde.softness * side
    return Told(weight=s["straight"] * s["known"], bias=p.hde.gain * side * s["up"], yaw=turn)


def directed(p: Any, s: dict[str, Any], sure: float, sigma: float) -> Told:
    """The error of the directions is the same in every stride: no row may leave the yaw surer than that."""
    left = max(1 - p.directions.error**2 / s["P"][2, 2], 0.0)
    return on_yaw(-s["away"], sigma, s["straight"] * s["known"] * sure * left)


def near(tolerance: float, s: dict[str, Any]) -> float:
    return float(np.exp(-((s["away"] / tolerance) ** 2)) * np.exp(-(min(s["bent"], 3.0) ** 2)))


def ihde(p: Any, s: dict[str, Any]) -> Told:
    return directed(p, s, near(p.ihde.tolerance, s), p.ihde.sigma)


def mihde(p: Any, s: dict[str, Any]) -> Told:
    """The compass asks for a turn by ``compass``, the direction for one by -``away``."""
    apart = wrapped(s["compass"] - -s["away"]) / p.mihde.compass
    return directed(p, s, near(p.mihde.tolerance, s) * np.exp(-0.5 * apart**2), p.mihde.sigma)


def normal(x: float, variance: float) -> float:
    return float(np.exp(-0.5 * x**2 / variance) / np.sqrt(2 * np.pi * variance))


def von_mises(p: Any, s: dict[str, Any]) -> Told:
    q, between = p.von_mises, 2 * np.pi / p.directions.count
    along = q.share * normal(s["away"], q.sigma**2 + s["P"][2, 2])
    return directed(p, s, along / (along + (1 - q.share) / between), q.sigma)


FORMS = {
    "hdr": hdr,
    "slope": slope,
    "integrator": integrator,
    "hde": hde,
    "ihde": ihde,
    "mihde": mihde,
    "von_mises": von_mises,
}


class Directions:
    """Learnt from straight strides: the circular mean of ``count`` times their headings."""

    def __init__(self, p: Any):
        self.p, self.total, self.many = p, 0j, 0.0

    def see(self, heading: float, straight: float, of_yaw: float) -> None:
        p = self.p
        if p.memory <= p.strides <= self.many:
            return
        counts = straight * p.sure**2 / (p.sure**2 + of_yaw)
        if self.many >= max(p.strides, p.memory):
            self.total *= 1 - counts / p.memory
        self.total += counts * np.exp(1j * p.count * heading)
        self.many += counts

    def known(self) -> bool:
        return self.many >= self.p.strides

    def axis(self) -> float:
        return float(np.angle(self.total)) / self.p.count


NOTHING = 1e4  # rad^2


class Other:
    """A rival: by how much its yaw is larger, its variance, its log odds, where its path begins."""

    def __init__(self, turn: float, variance: float, odds: float, since: Array):
        self.turn, self.variance, self.odds, self.since = turn, variance, odds, np.array(since)


def likelihood(p: Any, x: float, variance: float) -> tuple[float, float]:
    """Log of (1 - e) N(x; 0, S) + e / 2 pi, and the share of the first part in it."""
    about = (1 - p.outliers) * normal(x, variance)
    whole = about + p.outliers / (2 * np.pi)
    return float(np.log(whole)), about / whole


class Rivals:
    """The filter's heading against a fresh rival and the former one."""

    def __init__(self, p: Any, place: Array):
        self.p = p
        self.fresh = Other(0.0, NOTHING, -p.fresh, place)
        self.former = Other(0.0, NOTHING, -p.former, place)

    def see(
        self, now: bool, innovation: float, noise: float, of_yaw: float, odd: float, place: Array, dt: float
    ) -> Other | None:
        """A sample; the rival that takes over, after which `turn` is to be called."""
        p = self.p
        for rival in (self.fresh, self.former):
            rival.variance += p.wander**2 * dt
        if not now:
            return None
        own, agrees = likelihood(p, innovation, noise + of_yaw)
        counts = np.exp(-0.5 * (odd / p.oddity) ** 2)
        explained = []
        for rival, start in ((self.fresh, -p.fresh), (self.former, -p.former)):
            off = wrapped(innovation - rival.turn)
            theirs, about = likelihood(p, off, noise + rival.variance)
            is_one = rival.variance < 0.5 * NOTHING
            moves = counts * (theirs - own) if is_one else 0.0
            rival.odds = max((rival.odds - start) * p.memory + start + moves, start)
            if is_one:  # it learns as far as the look is about it
                gain = about * rival.variance / (rival.variance + noise)
                rival.turn = wrapped(rival.turn + gain * off)
                rival.variance *= 1 - gain
            explained.append(about)
        if self.fresh.odds + p.fresh < 3.0:  # less than a look's worth: given up, or born anew
            if agrees < 0.75 and explained[0] < 0.5:
                self.fresh = Other(innovation, noise, -p.fresh, place)
            elif agrees > explained[0]:
                self.fresh = Other(0.0, NOTHING, -p.fresh, place)
        best = self.former if self.former.odds > self.fresh.odds else self.fresh
        if best.odds <= 0:
            return None
        self.former = Other(0.0, of_yaw, -p.former, best.since)
        self.fresh = Other(0.0, NOTHING, -p.fresh, best.since)
        return best

    def turn(self, yaw: float) -> None:
        """The filter's yaw became larger."""
        for rival in (self.fresh, self.former):
            rival.turn = wrapped(rival.turn - yaw)


def taken_over(
    P: Array, turn: float, variance: float, since: Array, place: Array, speed: Array
) -> tuple[Array, Array, Array]:
    """Covariance (15, 15), position and velocity of a filter that turns, and its path since then, as one."""
    R = dense.rotation(np.array([0.0, 0.0, turn]))
    T = np.eye(15)
    for part in (dense.PHI, dense.POS, dense.VEL):
        T[part, part] = R
    path, speed = R @ (place - since), R @ speed
    u = np.zeros(15)
    u[dense.PHI], u[dense.POS], u[dense.VEL] = UP, np.cross(UP, path), np.cross(UP, speed)
    return T @ P @ T.T + variance * np.outer(u, u), since + path, speed
