"""Attitude from a sensor in a pocket: gravity where it shows, the field's turn from sample to sample, an
anchored field, a field that is itself estimated, and a velocity that stays bounded. Naive loops, float64.

Navigation axes: east, north, up. C takes body to navigation axes; Euler angles ``e`` are (roll, pitch, yaw)
of C = Rz(yaw) Ry(pitch) Rx(roll). Specific force points up at rest. Errors: C_true = exp([t x]) C with t in
navigation axes, all else additive; measured rate = true + bias. Angles in rad, fields in uT.

Timing: ``dt[k]`` is the interval that ends at sample k; row k of a result is what is known after sample k.
A sample of no duration measures nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference.field import wrapped
from tests.reference.filter import decay, euler_attitude, rotation, skew

Array = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])
ONE = np.eye(3)
TURN, SPEED, BIAS, IRON, FIELD = (slice(3 * i, 3 * i + 3) for i in range(5))  # of the filter in the pocket


class Walk(NamedTuple):
    """Steps ``dt`` (n,), ``force``, ``rate`` and ``field`` (n, 3) in body axes; a field may be NaN."""

    dt: Array
    force: Array
    rate: Array
    field: Array


class Settings(NamedTuple):
    """Of attitude and bias; ``width`` 0 is a hard gate."""

    gravity: float = 9.81
    gyroscope: float = 1e-3  # rad/s/sqrt(Hz)
    bias: float = 1e-6  # rad/s^2/sqrt(Hz)
    bias_time: float = np.inf  # s
    force: float = 0.5  # m/s^2, of a sample
    threshold: float = 0.3  # m/s^2
    width: float = 0.0


class Magnetic(NamedTuple):
    """What is made of the field: ``none``, ``differential``, ``averaged`` (differential, and the noise of the
    last reading is a state), ``anchored`` or ``state``."""

    how: str = "none"
    noise: float = 0.05  # uT/sqrt(Hz)
    samples: int = 20  # of the window in which the strength is to be steady
    threshold: float = 2.0  # uT
    width: float = 0.0
    wander: float = 0.0  # uT/sqrt(s), of the field
    deviation: float = 0.0  # uT; 0 is none
    deviation_time: float = 1.0  # s
    hard_iron: bool = False
    hard_iron_wander: float = 0.0  # uT/sqrt(s)


class Start(NamedTuple):
    """``P`` (6, 6) is of (e, g) for Euler angles and of (t, g) for the twin; the sigmas are of ``state``."""

    C: Array
    b: Array
    P: Array
    field: Array = np.zeros(3)
    sigma_field: float = 1.0
    sigma_hard_iron: float = 1.0


class Run(NamedTuple):
    """``own`` has by name what the magnetic reference estimates: ``n``, the noise of the newest reading, or
    ``B``, ``d`` and ``h``. ``steady`` is how far the field's gate opens, ``field`` the weight of its
    update."""

    attitude: Array
    bias: Array
    own: dict[str, Array]
    gravity: Array
    steady: Array
    field: Array
    P: Array


class Rows(NamedTuple):
    """Innovation ``z`` (m,), its slope ``H`` (m, n) in the states and its noise ``R`` (m, m)."""

    z: Array
    H: Array
    R: Array


def matrix(e: Array) -> Array:
    return euler_attitude(e[0], e[1], e[2])


def angles(C: Array) -> Array:
    pitch = np.arctan2(-C[2, 0], np.hypot(C[2, 1], C[2, 2]))
    return np.array([np.arctan2(C[2, 1], C[2, 2]), pitch, np.arctan2(C[1, 0], C[0, 0])])


def turning(e: Array) -> Array:
    """T of dC C^T = [T de x]: its columns are the axes that roll, pitch and yaw turn about."""
    sin_yaw, cos_yaw, sin_pitch, cos_pitch = np.sin(e[2]), np.cos(e[2]), np.sin(e[1]), np.cos(e[1])
    return np.array(
        [
            [cos_yaw * cos_pitch, -sin_yaw, 0.0],
            [sin_yaw * cos_pitch, cos_yaw, 0.0],
            [-sin_pitch, 0.0, 1.0],
        ]
    )


def right_jacobian(u: Array) -> Array:
    """J of exp([(u + du) x]) = exp([u x]) exp([J du x]), to first order in du."""
    size, s = float(np.linalg.norm(u)), skew(u)
    if size < 1e-4:
        return ONE - s / 2 + s @ s / 6
    return ONE - (1 - np.cos(size)) / size**2 * s + (size - np.sin(size)) / size**3 * (s @ s)


def update(P: Array, rows: Rows, w: float) -> tuple[Array, Array]:
    """The correction and the new P, of a measurement with noise R / w."""
    z, H, R = rows
    gain = w * P @ H.T @ np.linalg.inv(w * H @ P @ H.T + R)
    P = P - gain @ H @ P
    return gain @ z, 0.5 * (P + P.T)


def opened(statistic: float, threshold: float, width: float) -> float:
    """Weight of a gate: none where the statistic is NaN."""
    if np.isnan(statistic):
        return 0.0
    if width == 0.0:
        return float(statistic < threshold)
    return float(1 / (1 + np.exp(min(np.log(max(statistic, 1e-300) / threshold) / width, 700.0))))


def steady(field: Array, N: int, threshold: float, width: float) -> Array:
    """Weights by the range of the strength in the last N samples, the first of all repeated before it; a
    window that holds a NaN is not steady."""
    sizes, out = [float(np.linalg.norm(m)) for m in field], np.zeros(len(field))
    for k in range(len(field)):
        late = [sizes[max(j, 0)] for j in range(k - N + 1, k + 1)]
        spread = np.nan if np.isnan(late).any() else max(late) - min(late)
        out[k] = opened(spread, threshold, width)
    return out


# ---- attitude and bias, in Euler angles or as a turn


def predicted(
    chart: str, C: Array, b: Array, rate: Array, dt: float, s: Settings
) -> tuple[Array, Array, Array, Array]:
    """C, b, F (6, 6) and Q (6, 6) over one step."""
    u, keep = (rate - b) * dt, decay(dt, s.bias_time)
    new = C @ rotation(u)
    F, Q = np.eye(6), np.zeros((6, 6))
    F[3:, 3:] = keep * ONE
    if chart == "euler":
        back = np.linalg.inv(turning(angles(new)))
        J = back @ new  # d(angles) by a turn in body axes after the step
        F[:3, :3] = back @ turning(angles(C))
        F[:3, 3:] = -dt * J @ right_jacobian(u)
        Q[:3, :3] = s.gyroscope**2 * dt * J @ J.T
    else:
        F[:3, 3:] = -dt * (C + new) / 2
        Q[:3, :3] = s.gyroscope**2 * dt * ONE
    Q[3:, 3:] = s.bias**2 * dt * ONE
    return new, keep * b, F, Q


def tilt(f: Array) -> Array:
    """Roll and pitch of a body whose specific force is ``f`` at rest."""
    return np.array([np.arctan2(f[1], f[2]), np.arctan2(-f[0], np.hypot(f[1], f[2]))])


def tilt_slope(f: Array) -> Array:
    across = np.hypot(f[1], f[2])
    square = float(f @ f)
    roll = [0.0, f[2] / across**2, -f[1] / across**2]
    pitch = [-across / square, f[0] * f[1] / across / square, f[0] * f[2] / across / square]
    return np.array([roll, pitch])


def gravity_rows(chart: str, C: Array, f: Array, s: Settings) -> Rows:
    """Slopes in attitude alone, (m, 3)."""
    if chart == "euler":
        z = np.array([wrapped(x) for x in tilt(f) - angles(C)[:2]])
        J = tilt_slope(f)
        return Rows(z, np.eye(2, 3), s.force**2 * J @ J.T)
    return Rows(f - C.T @ (s.gravity * UP), C.T @ skew(s.gravity * UP), s.force**2 * ONE)


def onto(chart: str, C: Array, H_t: Array) -> Array:
    """A slope in the turn t as one in the states of the chart."""
    return H_t @ turning(angles(C)) if chart == "euler" else H_t


def turned(chart: str, C: Array, x: Array) -> Array:
    return matrix(angles(C) + x) if chart == "euler" else rotation(x) @ C


# ---- references in the field


def carried(before: Array, rate: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """What a reading of the field becomes in one step where the field is the same, and its slope in b."""
    u = (rate - b) * dt
    now = rotation(u).T @ before
    return now, -dt * skew(now) @ right_jacobian(u)


def printed_carried(before: Array, rate: Array, b: Array, dt: float) -> Array:
    """As published: turned the other way."""
    return rotation((rate - b) * dt) @ before


def unsure_turn(before: Array, gyroscope: float, dt: float) -> Array:
    """Noise of a carried reading by that of the gyroscope."""
    cross = skew(before)
    return dt * gyroscope**2 * cross @ cross.T


def differential_rows(now: Array, before: Array, rate: Array, b: Array, dt: float, noises: Array) -> Rows:
    """Slopes in b alone; ``noises``: of gyroscope and field."""
    seen, H = carried(before, rate, b, dt)
    R = 2 * noises[1] ** 2 / dt * ONE + unsure_turn(before, noises[0], dt)
    return Rows(now - seen, H, R)


def averaged_rows(
    now: Array, before: Array, n: Array, rate: Array, b: Array, dt: float, gyroscope: float
) -> Rows:
    """Slopes (3, 9) in b and in the noises of the reading before, which is believed to be ``n``, and of this
    one, believed to be none: now = A^T (before - n) + n_new."""
    seen, H_b = carried(before - n, rate, b, dt)
    H = np.hstack([H_b, -rotation((rate - b) * dt).T, ONE])
    return Rows(now - seen, H, unsure_turn(before - n, gyroscope, dt) + 1e-12 * ONE)


def known_rows(C: Array, m: Array, field: Array, noise: float, dt: float) -> Rows:
    """Of a field in navigation axes, with slopes in the turn t alone."""
    return Rows(m - C.T @ field, C.T @ skew(field), noise**2 / dt * ONE)


def places(m: Magnetic) -> dict[str, slice]:
    """Where the states of the reference stand, after attitude and bias."""
    names = {"averaged": ["n"], "state": ["B"]}.get(m.how, [])
    if m.how == "state":
        names += ["d"] * (m.deviation > 0) + ["h"] * m.hard_iron
    return {name: slice(6 + 3 * i, 9 + 3 * i) for i, name in enumerate(names)}


def grown(P: Array, sigmas: list[float]) -> Array:
    """With three more states for each sigma."""
    old = len(P)
    new = np.zeros((old + 3 * len(sigmas),) * 2)
    new[:old, :old] = P
    for i, sigma in enumerate(sigmas):
        at = slice(old + 3 * i, old + 3 * i + 3)
        new[at, at] = sigma**2 * ONE
    return new


class Filter:
    """Attitude, bias and the states of a magnetic reference."""

    def __init__(self, chart: str, settings: Settings, magnetic: Magnetic, start: Start, dt: Array):
        self.chart, self.settings, self.magnetic = chart, settings, magnetic
        self.at = places(magnetic)
        self.C, self.b = np.array(start.C, float), np.array(start.b, float)
        self.own = {name: np.zeros(3) for name in self.at}
        if "B" in self.own:
            self.own["B"] = np.array(start.field, float)
        typical = float(dt[dt > 0][0])
        sigmas = {"B": start.sigma_field, "d": magnetic.deviation, "h": start.sigma_hard_iron}
        sigmas["n"] = magnetic.noise / np.sqrt(typical)
        self.P = grown(np.array(start.P, float), [sigmas[name] for name in self.at])
        self.anchor: Array | None = None

    def predict(self, rate: Array, dt: float) -> None:
        self.C, self.b, F, Q = predicted(self.chart, self.C, self.b, rate, dt, self.settings)
        whole = np.eye(len(self.P))
        whole[:6, :6] = F
        self.P = whole @ self.P @ whole.T
        self.P[:6, :6] += Q

    def correct(self, x: Array) -> None:
        self.C = turned(self.chart, self.C, x[:3])
        self.b = self.b + x[3:6]
        for name, at in self.at.items():
            self.own[name] = self.own[name] + x[at]

    def look(self, rows: Rows, w: float, *parts: slice) -> None:
        """With slopes in some of the states, side by side."""
        H = np.zeros((len(rows.z), len(self.P)))
        for i, part in enumerate(parts):
            H[:, part] = rows.H[:, 3 * i : 3 * i + 3]
        x, self.P = update(self.P, Rows(rows.z, H, rows.R), w)
        self.correct(x)

    def gravity(self, f: Array, w: float) -> None:
        self.look(gravity_rows(self.chart, self.C, f, self.settings), w, slice(0, 3))

    def differential(self, now: Array, before: Array, rate: Array, dt: float, w: float) -> None:
        noises = np.array([self.settings.gyroscope, self.magnetic.noise])
        self.look(differential_rows(now, before, rate, self.b, dt, noises), w, slice(3, 6))

    def averaged(self, now: Array, before: Array, rate: Array, dt: float, w: float) -> None:
        """The noise of the new reading joins, and that of the old one goes. A reading of weight w has noise
        of its own, as of R / w, beside that: w on the gyroscope's small part alone would protect from
        nothing."""
        old, new = self.at["n"], slice(9, 12)
        self.P = grown(self.P, [self.magnetic.noise / np.sqrt(dt)])
        newest = np.zeros(3)
        if w > 0:
            rows = averaged_rows(now, before, self.own["n"], rate, self.b, dt, self.settings.gyroscope)
            doubt = (1 / max(w, 1e-9) - 1) * self.magnetic.noise**2 / dt * ONE
            rows = rows._replace(R=rows.R + doubt)
            H = np.zeros((3, 12))
            H[:, 3:6], H[:, old], H[:, new] = rows.H[:, :3], rows.H[:, 3:6], rows.H[:, 6:]
            x, self.P = update(self.P, Rows(rows.z, H, rows.R), 1.0)
            self.correct(x[:9])
            newest = x[new]
        left = [*range(6), *range(9, 12)]
        self.P, self.own["n"] = self.P[np.ix_(left, left)], newest

    def known(self, now: Array, field: Array, dt: float, w: float) -> None:
        rows = known_rows(self.C, now, field, self.magnetic.noise, dt)
        self.look(rows._replace(H=onto(self.chart, self.C, rows.H)), w, slice(0, 3))

    def anchored(self, now: Array, dt: float, w: float) -> float:
        """The weight of the update: none at the sample that sets the anchor. P does not know the errors that
        an anchor keeps, of the attitude and of the one reading that made it."""
        if w <= 0.5:
            self.anchor = None
            return 0.0
        if self.anchor is None:
            self.anchor = self.C @ now
            return 0.0
        self.known(now, self.anchor, dt, w)
        return w

    def wander(self, dt: float) -> None:
        m, F, Q = self.magnetic, np.eye(len(self.P)), np.zeros_like(self.P)
        for name, at in self.at.items():
            if name == "d":
                keep = np.exp(-dt / m.deviation_time)
                self.own["d"] = keep * self.own["d"]
                F[at, at] = keep * ONE
                Q[at, at] = m.deviation**2 * (1 - keep**2) * ONE
            else:
                Q[at, at] = (m.wander if name == "B" else m.hard_iron_wander) ** 2 * dt * ONE
        self.P = F @ self.P @ F.T + Q

    def state(self, now: Array, dt: float, w: float) -> None:
        none = np.zeros(3)
        rows = known_rows(
            self.C,
            now - self.own.get("h", none),
            self.own["B"] + self.own.get("d", none),
            self.magnetic.noise,
            dt,
        )
        # The deviation is in the axes of the attitude as estimated: an error of that turns the field of the
        # place against them, not the deviation, of which every direction is alike.
        rows = rows._replace(H=known_rows(self.C, now, self.own["B"], self.magnetic.noise, dt).H)
        slopes = {"B": self.C.T, "d": self.C.T, "h": ONE}
        H = np.hstack([onto(self.chart, self.C, rows.H), *(slopes[name] for name in self.at)])
        self.look(rows._replace(H=H), w, slice(0, 3), *self.at.values())

    def magnetic_look(self, walk: Walk, k: int, w: float) -> float:
        """What the field tells at sample k, with a gate open by w; the weight of the update."""
        how, dt, now, rate = self.magnetic.how, float(walk.dt[k]), walk.field[k], walk.rate[k]
        before = walk.field[max(k - 1, 0)]
        if how == "none" or dt == 0:
            return 0.0
        if not np.isfinite(now).all():
            w = 0.0
        if how in ("differential", "averaged") and (k == 0 or not np.isfinite(before).all()):
            w = 0.0
        if how == "averaged":
            self.averaged(now, before, rate, dt, w)
        elif how == "anchored":
            return self.anchored(now, dt, w)
        elif how == "state":
            self.wander(dt)
            if w > 0:
                self.state(now, dt, w)
        elif w > 0:
            self.differential(now, before, rate, dt, w)
        return w


def gone_through(chart: str, walk: Walk, settings: Settings, magnetic: Magnetic, start: Start) -> Run:
    """Each sample: the step, gravity, the field."""
    count, own = len(walk.dt), Filter(chart, settings, magnetic, start, walk.dt)
    gates = steady(walk.field, magnetic.samples, magnetic.threshold, magnetic.width)
    C, b, gravity, field = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    others = {name: np.zeros((count, 3)) for name in own.at}
    for k in range(count):
        own.predict(walk.rate[k], float(walk.dt[k]))
        if walk.dt[k] > 0:
            odd = abs(float(np.linalg.norm(walk.force[k])) - settings.gravity)
            gravity[k] = opened(odd, settings.threshold, settings.width)
        if gravity[k] > 0:
            own.gravity(walk.force[k], gravity[k])
        field[k] = own.magnetic_look(walk, k, gates[k])
        C[k], b[k] = own.C, own.b
        for name, of in others.items():
            of[k] = own.own[name]
    return Run(C, b, others, gravity, gates, field, own.P)


def euler(walk: Walk, settings: Settings, magnetic: Magnetic, start: Start) -> Run:
    """The states are Euler angles and bias."""
    return gone_through("euler", walk, settings, magnetic, start)


def twin(walk: Walk, settings: Settings, magnetic: Magnetic, start: Start) -> Run:
    """The states are the error of attitude, as a turn in navigation axes, and that of the bias."""
    return gone_through("twin", walk, settings, magnetic, start)


# ---- with a velocity that stays bounded


class PocketSettings(NamedTuple):
    gravity: float = 9.81
    gyroscope: float = 1e-3  # rad/s/sqrt(Hz)
    scale: float = 0.002  # sqrt(s): the gyroscope's noise by how fast it turns
    force: float = 0.05  # m/s^2/sqrt(Hz)
    bias: float = 1e-6  # rad/s^2/sqrt(Hz)
    bias_time: float = np.inf  # s
    hard_iron: float = 0.0  # uT/sqrt(s)
    field: float = 0.0  # uT/sqrt(s)
    level_speed: float = 0.5  # m/s/sqrt(Hz)
    vertical_speed: float = 0.2  # m/s/sqrt(Hz)
    noise: float = 0.1  # uT/sqrt(Hz)
    gate_noise: float = 2.0  # uT
    off_strength: float = 5.0  # uT
    off_vertical: float = 5.0  # uT
    unlikely: float = 3.0  # of the innovation's square over its variance, per axis
    change: float = 6.0  # uT, of the strength
    envelope: float = 0.5  # s
    hold: float = 1.0  # s
    latch: bool = False
    near: float = 8.0  # uT
    yaw_sigma: float = 0.2  # rad
    memory_waits: bool = False  # whether envelope and memory begin no sooner than the latch


class PocketStart(NamedTuple):
    """``P`` (15, 15) of t, v, g, h, B."""

    C: Array
    v: Array
    b: Array
    h: Array
    B: Array
    P: Array


class PocketRun(NamedTuple):
    """``odd`` is L of the gate, ``nis`` a part of it; both are NaN where there is no field."""

    attitude: Array
    velocity: Array
    bias: Array
    hard_iron: Array
    field: Array
    weight: Array
    odd: Array
    nis: Array
    memory: Array
    latched: Array
    P: Array


def pocket_predicted(
    C: Array, v: Array, b: Array, f: Array, rate: Array, dt: float, s: PocketSettings
) -> tuple[Array, Array, Array, Array, Array]:
    """C, v, b, F (15, 15) and Q (15, 15) over one step."""
    w, keep = rate - b, decay(dt, s.bias_time)
    new = C @ rotation(w * dt)
    middle = (C + new) / 2
    F = np.eye(15)
    F[TURN, BIAS] = -dt * middle
    F[SPEED, TURN] = -dt * skew(middle @ f)
    F[BIAS, BIAS] = keep * ONE
    turn = s.gyroscope**2 + (s.scale * float(np.linalg.norm(w))) ** 2
    Q = np.diag(np.repeat([turn, s.force**2, s.bias**2, s.hard_iron**2, s.field**2], 3)) * dt
    return new, v + (middle @ f - s.gravity * UP) * dt, keep * b, F, Q


def pocket_rows(C: Array, h: Array, field: Array, m: Array, noise: float, dt: float) -> Rows:
    H = np.zeros((3, 15))
    H[:, TURN], H[:, IRON], H[:, FIELD] = C.T @ skew(field), ONE, C.T
    return Rows(m - h - C.T @ field, H, noise**2 / dt * ONE)


class Envelope:
    """The highest and lowest of late: what is past is forgotten."""

    def __init__(self, time: float):
        self.time, self.high, self.low = time, np.nan, np.nan

    def see(self, x: float, dt: float) -> float:
        """How far they lie apart."""
        if np.isnan(self.high):
            self.high = self.low = x
        share = 1 - np.exp(-dt / self.time)
        self.high = max(x, self.high + (x - self.high) * share)
        self.low = min(x, self.low + (x - self.low) * share)
        return self.high - self.low


def oddity(
    P: Array, rows: Rows, seen: Array, level: Array, field: Array, spread: float, s: PocketSettings
) -> tuple[float, float]:
    """L and the normalised square of the innovation, of the field ``seen`` in body axes, ``level`` in those
    of navigation."""
    S = rows.H @ P @ rows.H.T + s.gate_noise**2 * ONE
    nis = float(rows.z @ np.linalg.inv(S) @ rows.z) / 3
    L = ((np.linalg.norm(seen) - np.linalg.norm(field)) / s.off_strength) ** 4
    L += ((level[2] - field[2]) / s.off_vertical) ** 4
    L += (nis / s.unlikely) ** 2 + (spread / s.change) ** 4
    return float(L), nis


def alike(level: Array, field: Array, near: float) -> bool:
    """Whether a field in level axes of any heading may be the one that is known."""
    across = np.hypot(level[0], level[1]) - np.hypot(field[0], field[1])
    return bool(abs(across) < near and abs(level[2] - field[2]) < near)


def mended(
    C: Array, P: Array, v: Array, level: Array, field: Array, sigma: float
) -> tuple[Array, Array, Array]:
    """With the yaw of the field; what is in navigation axes turns with them."""
    away = wrapped(np.arctan2(field[1], field[0]) - np.arctan2(level[1], level[0]))
    U, turned_ = rotation(away * UP), np.eye(15)
    turned_[TURN, TURN], turned_[SPEED, SPEED] = U, U
    P = turned_ @ P @ turned_.T
    P[2, :], P[:, 2] = 0.0, 0.0
    P[2, 2] = sigma**2
    return U @ C, P, U @ v


def pocket_corrected(x: Array, C: Array, v: Array, b: Array, h: Array, field: Array) -> tuple[Array, ...]:
    return rotation(x[TURN]) @ C, v + x[SPEED], b + x[BIAS], h + x[IRON], field + x[FIELD]


def pocket(walk: Walk, s: PocketSettings, start: PocketStart) -> PocketRun:
    """Each sample: the step, the velocity, the field. Without a field the gate's memory fades, and its
    envelopes stay."""
    C, v, b, h, field, P = (np.array(x, float) for x in start)
    envelope, memory, latched = Envelope(s.envelope), 0.0, not s.latch
    H_v = np.zeros((3, 15))
    H_v[:, SPEED] = ONE
    speeds = np.diag([s.level_speed, s.level_speed, s.vertical_speed]) ** 2
    found = []
    for dt, f, rate, m in zip(*walk, strict=True):
        C, v, b, F, Q = pocket_predicted(C, v, b, f, rate, dt, s)
        P = F @ P @ F.T + Q
        weight, L, nis = 0.0, np.nan, np.nan
        if dt > 0:
            x, P = update(P, Rows(-v, H_v, speeds / dt), 1.0)
            C, v, b, h, field = pocket_corrected(x, C, v, b, h, field)
        if dt > 0 and np.isfinite(m).all():
            level = C @ (m - h)
            if not latched and alike(level, field, s.near):
                latched = True
                C, P, v = mended(C, P, v, level, field, s.yaw_sigma)
            rows = pocket_rows(C, h, field, m, s.noise, dt)
            if latched or not s.memory_waits:
                spread = envelope.see(float(np.linalg.norm(m - h)), dt)
                L, nis = oddity(P, rows, m - h, level, field, spread, s)
                memory = max(L, memory * np.exp(-dt / s.hold))
            if latched:
                weight = 1 / (1 + memory)
                x, P = update(P, rows, weight)
                C, v, b, h, field = pocket_corrected(x, C, v, b, h, field)
        else:
            memory *= np.exp(-dt / s.hold)
        found.append((C, v, b, h, field, weight, L, nis, memory, latched))
    return PocketRun._make([*(np.array(x) for x in zip(*found, strict=True)), P])
