"""Magnetic fields of buildings and streets: a background and what dipoles, wires and iron posts add to it.

Pure functions, differentiable by position and by every number of every source. Positions and fields are ENU
`(3, *L)` with lanes last, in m and µT; a group of N sources has the source axis first and may be empty.
Outside of iron and wires every field is free of divergence and curl. Sources do not magnetise each other, and
posts only answer to the background.

A point source is a body of 1 cm radius: a dipole is a ball and a wire a rod, evenly magnetised or carrying
its current evenly, which is exact outside and finite, as are the gradients, inside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax.errors import InputError, suggest
from pedjax.gates import gate
from pedjax.lanes import align, cross, dot, norm
from pedjax.simulation.earth import homogeneous

Mode = Literal["superpose", "nearest"]
"""What posts add: all of them, or at each point the nearest one only."""

_DIPOLE = 0.1  # µ0 / 4π in µT m³ / (A m²)
_WIRE = 0.2  # µ0 / 2π in µT m / A
_CORE = 0.01  # m, radius of a dipole's ball and of a wire
_ALWAYS = 1e9  # s


class Dipoles(NamedTuple):
    """Magnets and magnetised iron, small against their distance."""

    position: Array
    """`(N, 3)` m"""
    moment: Array
    """`(N, 3)` A m²"""


class Lines(NamedTuple):
    """Direct currents along infinite straight lines."""

    point: Array
    """`(N, 3)` m, anywhere on the line"""
    direction: Array
    """`(N, 3)`, of any length but zero: where the current flows to"""
    current: Array
    """`(N,)` A"""


class Cylinders(NamedTuple):
    """Infinite iron posts along Up: lamp posts, columns, and parked cars in the eyes of Munoz Diaz."""

    place: Array
    """`(N, 2)` m, east and north of the axis"""
    radius: Array
    """`(N,)` m"""
    permeability: Array
    """`(N,)` relative"""


class Movers(NamedTuple):
    """Dipoles that travel on a straight line and are on for a while: lifts, doors, cars, motors."""

    position: Array
    """`(N, 3)` m, where they are until they travel"""
    moment: Array
    """`(N, 3)` A m²"""
    velocity: Array
    """`(N, 3)` m/s, as long as they travel; then they stay"""
    travel: Array
    """`(N, 2)` s, from and until"""
    on: Array
    """`(N, 2)` s, from and until"""
    width: Array
    """`(N,)` s, scale of the soft switch; 0 is a jump, which has no gradient by its time"""


Group = Dipoles | Lines | Cylinders | Movers


class Field(NamedTuple):
    """A homogeneous background `(3,)` in µT and groups of sources; `compose` makes one."""

    background: Array
    dipoles: Dipoles
    lines: Lines
    cylinders: Cylinders
    movers: Movers


def compose(base: Field | ArrayLike, *groups: Group) -> Field:
    """A field, or a background `(3,)` in µT, with these sources added."""
    if not isinstance(base, Field):
        base = Field(
            jnp.asarray(base, float),
            Dipoles(*_empty(3, 3)),
            Lines(*_empty(3, 3, 0)),
            Cylinders(*_empty(2, 0, 0)),
            Movers(*_empty(3, 3, 3, 2, 2, 0)),
        )
    parts = base._asdict()
    for group in groups:
        name = type(group).__name__.lower()
        pairs = zip(parts[name], _arrays(group), strict=True)
        parts[name] = type(group)(*(jnp.concatenate(pair) for pair in pairs))
    return Field(**parts)


def _empty(*widths: int) -> list[Array]:
    return [jnp.zeros((0, width) if width else (0,)) for width in widths]


def _arrays(group: Group) -> list[Array]:
    return [jnp.asarray(x, float) for x in group]


def moving(position: ArrayLike, moment: ArrayLike, velocity: ArrayLike, travel: ArrayLike) -> Movers:
    """Dipoles `(N, 3)` m, A m², m/s that travel in `(N, 2)` s and are always on."""
    position, moment, velocity, travel = (jnp.asarray(x, float) for x in (position, moment, velocity, travel))
    n = len(position)
    return Movers(
        position, moment, velocity, travel, jnp.tile(jnp.array([-_ALWAYS, _ALWAYS]), (n, 1)), jnp.zeros(n)
    )


def switching(position: ArrayLike, moment: ArrayLike, on: ArrayLike, width: float = 0.0) -> Movers:
    """Dipoles `(N, 3)` m, A m² that stay and are on in `(N, 2)` s, switched softly over `width` s."""
    position, moment, on = (jnp.asarray(x, float) for x in (position, moment, on))
    n = len(position)
    return Movers(position, moment, jnp.zeros((n, 3)), jnp.zeros((n, 2)), on, jnp.full(n, width))


def field_at(field: Field, position: Array, time: ArrayLike = 0.0, mode: Mode = "superpose") -> Array:
    """The field `(3, *L)`, ENU in µT, at `position (3, *L)` m and `time (*L)` s.

    Dipoles, with r from the source: B = µ0/4π (3 r̂ (m·r̂) − m) / r³. Lines along t, with d across them:
    B = µ0 I / 2π  t × d / d². Posts of radius a and permeability µ in a horizontal background h, with r = r u
    from the axis and k = (µ − 1)/(µ + 1): B = h + k (a/r)² (2 u uᵀ − I) h outside, 2µ/(µ + 1) h inside
    (Munoz Diaz et al., Sensors 2017, Eq. 21; the square is lost in print, and any other power has divergence
    and curl). Posts that are superposed keep to the equations but not quite to their boundaries. `nearest`
    is the published way: it jumps where another post gets nearer, see `nearest_object`.
    """
    if mode not in get_args(Mode):
        raise InputError(f"mode '{mode}' is unknown{suggest(mode, get_args(Mode))}")
    position, time = _same_lanes(position, time)
    background = align(field.background, 1, time.ndim)

    def of_post(post: Cylinders) -> Array:
        return _of_post(post, position, background)

    posts = field.cylinders
    total = background + jnp.zeros_like(position)
    total = _add(lambda one: _of_dipole(_from(one.position, position), one.moment), field.dipoles, total)
    total = _add(lambda one: _of_mover(one, position, time), field.movers, total)
    total = _add(lambda one: _of_line(one, position), field.lines, total)
    if mode == "superpose":
        return _add(of_post, posts, total)
    if not len(posts.radius):
        return total
    which = nearest_object(field, position)
    return total + of_post(Cylinders(jnp.moveaxis(posts.place[which], -1, 0), *(x[which] for x in posts[1:])))


def nearest_object(field: Field, position: Array) -> Array:
    """Which post `(*L)` has its surface nearest to `position (3, *L)` m; −1 where there is none.

    In the mode `nearest` the field jumps where this changes: leave out what compares samples across it.
    """
    position, posts = jax.lax.stop_gradient((jnp.asarray(position), field.cylinders))

    def nearer(best: tuple[Array, Array], one: tuple[Array, Cylinders]) -> tuple[tuple[Array, Array], None]:
        number, post = one
        least = _beyond(post, position).astype(best[0].dtype)
        is_nearer = least < best[0]
        return (jnp.where(is_nearer, least, best[0]), jnp.where(is_nearer, number, best[1])), None

    lanes = position.shape[1:]
    none = jnp.full(lanes, jnp.inf, jnp.result_type(position, posts.radius)), jnp.full(lanes, -1)
    return jax.lax.scan(nearer, none, (jnp.arange(len(posts.radius)), posts))[0][1]


def inside(field: Field, position: Array, time: ArrayLike = 0.0) -> Array:
    """Whether `position (3, *L)` m is in a post or in the 1 cm of a dipole or wire `(*L)`.

    No sensor gets there; the field is finite, but not that of free space.
    """
    position, time = _same_lanes(position, time)

    def in_mover(one: Movers) -> Array:
        at, weight = _moved(one, time)
        return (norm(position - at) < _CORE) & (weight > 0)

    found = jnp.zeros(time.shape, bool)
    found = _any(lambda one: norm(_from(one.position, position)) < _CORE, field.dipoles, found)
    found = _any(in_mover, field.movers, found)
    found = _any(lambda one: norm(_across(one, position)[1]) < _CORE, field.lines, found)
    return _any(lambda one: _beyond(one, position) < 0, field.cylinders, found)


def _add(term: Callable[[Any], Array], group: Group, total: Array) -> Array:
    """`total` and the terms of a group's sources, taken one by one.

    Memory, also under gradients, is that of the lanes; all at once would be slower too.
    """

    @jax.checkpoint
    def add(total: Array, one: Group) -> tuple[Array, None]:
        return total + term(one).astype(total.dtype), None

    return jax.lax.scan(add, total, group)[0]


def _any(test: Callable[[Any], Array], group: Group, found: Array) -> Array:
    return jax.lax.scan(lambda found, one: (found | test(one), None), found, group)[0]


def _same_lanes(position: ArrayLike, time: ArrayLike) -> tuple[Array, Array]:
    position, time = jnp.asarray(position), jnp.asarray(time)
    lanes = jnp.broadcast_shapes(position.shape[1:], time.shape)
    position = jnp.broadcast_to(align(position, 1, len(lanes)), (3, *lanes))
    return position, jnp.broadcast_to(time, lanes)


def _from(source: Array, position: Array) -> Array:
    """From one source `(n,)` or `(n, *L)` to the first n coordinates of `position (3, *L)`."""
    return position[: len(source)] - align(source, 1, position.ndim - 1)


def _of_dipole(r: Array, moment: Array) -> Array:
    moment = align(moment, 1, r.ndim - 1)
    square = dot(r, r)
    is_outside = square >= _CORE**2
    safe = jnp.where(is_outside, square, 1.0)
    outside = (3.0 * r * (dot(r, moment) / safe) - moment) / (safe * jnp.sqrt(safe))
    return _DIPOLE * jnp.where(is_outside, outside, 2.0 / _CORE**3 * moment)


def _of_mover(mover: Movers, position: Array, time: Array) -> Array:
    at, weight = _moved(mover, time)
    return weight * _of_dipole(position - at, mover.moment)


def _moved(mover: Movers, time: Array) -> tuple[Array, Array]:
    """Where a mover is `(3, *L)` m, and how far it is on `(*L)`."""
    begin, end = mover.travel
    since = jnp.clip(time, begin, end) - begin
    at = align(mover.position, 1, time.ndim) + align(mover.velocity, 1, time.ndim) * since
    start, stop = mover.on
    return at, (1.0 - gate(time - start, mover.width)) * gate(time - stop, mover.width)


def _across(line: Lines, position: Array) -> tuple[Array, Array]:
    """The unit vector along a line, and from it straight to the position, both `(3, *L)`."""
    along = align(line.direction / jnp.sqrt(dot(line.direction, line.direction)), 1, position.ndim - 1)
    d = _from(line.point, position)
    return along, d - along * dot(along, d)


def _of_line(line: Lines, position: Array) -> Array:
    along, d = _across(line, position)
    along, d = jnp.broadcast_arrays(along, d)
    return _WIRE * line.current * cross(along, d) / jnp.maximum(dot(d, d), _CORE**2)


def _beyond(post: Cylinders, position: Array) -> Array:
    """Distance `(*L)` in m from the surface of a post."""
    return norm(_from(post.place, position)) - post.radius


def _of_post(post: Cylinders, position: Array, background: Array) -> Array:
    k = (post.permeability - 1.0) / (post.permeability + 1.0)
    area, h = post.radius**2, background[:2]
    r = _from(post.place, position)
    square = dot(r, r)
    is_outside = (square >= area) & (square > 0)
    safe = jnp.where(is_outside, square, 1.0)
    outside = area / safe * (2.0 * r * (dot(r, h) / safe) - h)
    level = k * jnp.where(is_outside, outside, h)
    return jnp.concatenate([level, jnp.zeros_like(level[:1])])


class Steel(NamedTuple):
    """How much iron a building has and where. Moments are RMS over dipoles of any direction."""

    room: tuple[float, float] = (4.0, 5.0)
    """m between inner walls, along x and along y; infinite for none"""
    storey: float = 3.0
    """m from floor (z = 0) to ceiling"""
    wall_density: float = 0.5
    """studs, pipes and radiators per m² of wall"""
    wall_moment: float = 18.0
    """A m²"""
    floor_density: float = 1.0
    """bars per m² of floor"""
    floor_moment: float = 2.0
    """A m²"""
    floor_depth: float = 0.2
    """m below the floor"""
    beam_density: float = 0.15
    """per m² of ceiling"""
    beam_moment: float = 180.0
    """A m²"""
    beam_rise: float = 0.3
    """m above the ceiling"""
    door_spacing: float = 5.0
    """m of wall for each steel frame, whose middle is 1 m high"""
    door_moment: float = 20.0
    """A m²"""
    elevators: int = 1
    """shafts, 1.2 m outside of the outer walls"""
    elevator_moment: float = 500.0
    """A m²"""


STYLES = {
    "office": Steel(),
    "corridor": Steel(room=(math.inf, math.inf), wall_moment=20.0, door_spacing=4.0),
    "hall": Steel(room=(math.inf, math.inf), storey=4.0, beam_moment=600.0, door_spacing=15.0, elevators=0),
}
"""Kinds of building. A corridor is a long and narrow extent of which both walls are felt."""


def building(
    key: Array,
    extent: tuple[tuple[float, float], tuple[float, float]],
    style: str | Steel = "office",
    background: ArrayLike | None = None,
    strength: ArrayLike = 1.0,
    path: Array | None = None,
    clearance: float = 0.5,
) -> Field:
    """A random building over `extent`, ((west, east), (south, north)) in m, with its floor at z = 0.

    Dipoles in walls, floor, ceiling, door frames and lift shafts, Munich around them unless told otherwise.
    The model is made up; its numbers were chosen so that 1 m high and half a metre from steel the field is
    off by 3 to 6 µT RMS, its norm varies by 4 to 10 µT along a straight line of 8 m, and near steel it is
    tens of µT off. A foot 0.1 m high feels the floor instead of the ceiling: as much RMS, but the norm varies
    by 8 to 24 µT, in shorter waves.

    `strength` scales all moments. Nobody walks through steel: what stands within `clearance` m of the walk
    `path (3, *L)` m is left out. The same key gives the same building.
    """
    if isinstance(style, str):
        if style not in STYLES:
            raise InputError(f"style '{style}' of a building is unknown{suggest(style, STYLES)}")
        style = STYLES[style]
    (west, east), (south, north) = extent
    if not (west < east and south < north):
        raise InputError(
            f"extent = {extent} must be ((west, east), (south, north)) with west < east, south < north"
        )
    walls = _walls(extent, style.room)
    spread = 3.0  # m, floor and ceiling go on outside
    area = (east - west + 2 * spread) * (north - south + 2 * spread)
    corner = jnp.array([west - spread, south - spread])
    size = jnp.array([east - west, north - south]) + 2 * spread
    keys = jax.random.split(key, 6)

    def scattered(key: Array, density: float, height: float) -> Array:
        n = round(density * area)
        return _upright(corner + size * _uniform(key, (n, 2)), jnp.full(n, height))

    lengths = np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1)
    studs = np.repeat(walls, np.round(style.wall_density * style.storey * lengths).astype(int), axis=0)
    frames = np.repeat(walls, np.floor(lengths / style.door_spacing).astype(int), axis=0)
    in_wall, in_height = jax.random.split(keys[0])
    heights = style.storey * _uniform(in_height, (len(studs),))
    parts = [
        (_upright(_on(in_wall, studs), heights), style.wall_moment),
        (_upright(_on(keys[1], frames), jnp.ones(len(frames))), style.door_moment),
        (scattered(keys[2], style.floor_density, -style.floor_depth), style.floor_moment),
        (scattered(keys[3], style.beam_density, style.storey + style.beam_rise), style.beam_moment),
        (_shafts(keys[4], walls[:4], style), style.elevator_moment),
    ]
    position = jnp.concatenate([at for at, _ in parts])
    rms = jnp.concatenate([jnp.full(len(at), moment) for at, moment in parts])
    direction = jax.random.normal(keys[5], position.shape, jnp.float32).astype(float)
    moment = jnp.asarray(strength) * rms[:, None] * direction / math.sqrt(3)
    if path is not None:
        moment = moment * _is_clear(position, path, style.storey, clearance)[:, None]
    return compose(homogeneous("munich") if background is None else background, Dipoles(position, moment))


def _walls(extent: tuple[tuple[float, float], tuple[float, float]], room: tuple[float, float]) -> np.ndarray:
    """Both ends of each wall `(M, 2, 2)` in m: the four outer ones, then inner ones about a room apart."""
    (west, east), (south, north) = extent

    def between(low: float, high: float, pitch: float) -> np.ndarray:
        rooms = max(round((high - low) / pitch), 1)
        return np.linspace(low, high, rooms + 1)[1:-1]

    walls = [((west, south), (east, south)), ((east, south), (east, north))]
    walls += [((east, north), (west, north)), ((west, north), (west, south))]
    walls += [((x, south), (x, north)) for x in between(west, east, room[0])]
    walls += [((west, y), (east, y)) for y in between(south, north, room[1])]
    return np.array(walls)


def _on(key: Array, walls: np.ndarray) -> Array:
    """One place `(M, 2)` m anywhere on each wall."""
    start, end = jnp.asarray(walls[:, 0]), jnp.asarray(walls[:, 1])
    return start + _uniform(key, (len(walls), 1)) * (end - start)


def _is_clear(position: Array, path: Array, storey: float, clearance: float) -> Array:
    """1 for iron `(N, 3)` above the ceiling, below the floor or away from the path, 0 in its way."""
    place = jnp.asarray(path)[:2].reshape(2, -1)
    nearest = jax.lax.map(lambda at: jnp.min(norm(place - at[:2, None])), position)
    height = position[:, 2]
    return jnp.where((height < 0) | (height > storey) | (nearest > clearance), 1.0, 0.0)


def _shafts(key: Array, outer: np.ndarray, style: Steel) -> Array:
    """Middles of the lift shafts `(N, 3)` m, outside of outer walls, which run counter-clockwise."""
    which, where = jax.random.split(key)
    walls = jnp.asarray(outer)[jax.random.randint(which, (style.elevators,), 0, 4, jnp.int32)]
    along = walls[:, 1] - walls[:, 0]
    out = jnp.stack([along[:, 1], -along[:, 0]], axis=1) / norm(along.T)[:, None]
    at = walls[:, 0] + _uniform(where, (style.elevators, 1)) * along
    return _upright(at + 1.2 * out, jnp.full(style.elevators, style.storey / 2))


def _uniform(key: Array, shape: tuple[int, ...]) -> Array:
    """Between 0 and 1, the same in either precision."""
    return jax.random.uniform(key, shape, jnp.float32).astype(float)


def _upright(place: Array, height: Array) -> Array:
    return jnp.concatenate([place, height[:, None]], axis=1)


_TILE = 16.0  # m along Easting, from 6 to 22; −20 to 15 along Northing
_LIGHTS = ((9.0, 0.4), (19.0, 0.4), (9.0, -12.4), (19.0, -12.4))
_CAR = (14.0, -3.0)


def street_template(
    tiles: int = 1,
    first: int = 0,
    background: ArrayLike | None = None,
    light_radius: ArrayLike = 0.1,
    car_radius: ArrayLike = 1.0,
    permeability: ArrayLike = 1000.0,
) -> Field:
    """Street lights and parked cars of Munoz Diaz et al. (Sensors 2017, Fig. 4); take mode `nearest` with it.

    A tile covers 6 to 22 m along Easting and −20 to 15 m along Northing, and holds four street lights and
    one car; tile n is shifted by 16 n m to the east, n from `first` on. In each tile the lights come first.
    The background is the Equator by default.

    Radii (m), permeability and places are assumptions, since the paper prints none: two lights at each
    kerb, y = 0.4 and −12.4 m, the car at y = −3 m, so that a pedestrian along y = 0 measures the 22 to 28 µT
    of its Fig. 10.
    """
    if tiles < 0:
        raise InputError(f"tiles = {tiles} must not be negative")
    shift = _TILE * np.stack([first + np.arange(tiles), np.zeros(tiles)], axis=1)
    place = (np.array([*_LIGHTS, _CAR]) + shift[:, None]).reshape(-1, 2)
    radius = jnp.tile(
        jnp.stack([jnp.asarray(light_radius, float)] * 4 + [jnp.asarray(car_radius, float)]), tiles
    )
    posts = Cylinders(
        jnp.asarray(place), radius, jnp.broadcast_to(jnp.asarray(permeability, float), radius.shape)
    )
    return compose(homogeneous("equator") if background is None else background, posts)


def floor_magnet(
    place: Sequence[float], depth: float = 0.3, moment: Sequence[float] = (20.0, 0.0, 0.0)
) -> Dipoles:
    """A strong magnet `depth` m below the floor at `place` (east, north) in m; `moment` in A m².

    By default a few cm of neodymium, which points east and so turns a compass that passes 0.4 m above it by
    more than half a right angle, and is hardly felt two metres on.
    """
    return Dipoles(jnp.array([[place[0], place[1], -depth]], float), jnp.array([moment], float))


@dataclass(frozen=True)
class Stretch:
    """A straight stretch of a corridor from `start` to `end` (east, north) in m, in the middle of which the
    horizontal field is turned by `turn` degrees, counter-clockwise where positive."""

    start: tuple[float, float] = (0.0, 0.0)
    end: tuple[float, float] = (0.0, 0.0)
    turn: float = 0.0

    def __post_init__(self) -> None:
        for key in ("start", "end"):
            value = np.asarray(getattr(self, key))
            if value.shape != (2,) or value.dtype.kind not in "iuf":
                raise InputError(f"stretch: {key} = {getattr(self, key)!r} must be two numbers, [x, y] in m")
        length = math.dist(self.start, self.end)
        if not length >= 1:
            raise InputError(f"{self}: start and end must be at least 1 m apart and are {length:g} m")
        if not 0 < abs(self.turn) <= 45:
            raise InputError(f"{self}: turn = {self.turn:g} must lie between -45 and 45 degrees, but not 0")

    def __str__(self) -> str:
        return "stretch from ({:g}, {:g}) to ({:g}, {:g})".format(*self.start, *self.end)


_FOOT = 0.1  # m, height in which the field is turned as asked
_SPACING = 0.5  # m along a wall from one dipole to the next, or less
_ALONG = math.cos(math.radians(30.0))


def magnetised_walls(
    stretches: Sequence[Stretch], background: ArrayLike, height: float = _FOOT, side: float = 2.0
) -> Dipoles:
    """Iron in both walls of stretches of a corridor, which turns a compass and hardly changes the strength.

    Each wall is a row of dipoles, `height` m high and `side` m beside the line from start to end. Their
    moments, alike and across the corridor, add a field T across it: even over the stretch to 5 %, gone
    about `side` m beyond its ends, and there turned round to 5 % of it, which fades over some metres. Along
    a horizontal field H of `background (3,)` µT a turn takes T = H tan(turn), and the strength F becomes
    √(F² + T²). It is exact 0.1 m above the middle of each stretch, whatever the others add there. A corridor
    across the field is refused, for there T makes the field stronger or weaker instead.
    """
    if not stretches:
        raise InputError("stretches is empty; give at least one with start, end and turn")
    if not 0.5 <= side <= 20:
        raise InputError(f"side = {side:g} must lie between 0.5 and 20 m")
    if not 0 <= height <= side / 2:
        raise InputError(f"height = {height:g} must lie between 0 and half of side, {side / 2:g} m")
    level = np.asarray(background, float)[:2]
    size = np.linalg.norm(level)
    if not size > 0:
        raise InputError("the background has no horizontal field to turn; take another one")
    rows = []
    for stretch in stretches:
        start, line = np.asarray(stretch.start, float), np.subtract(stretch.end, stretch.start)
        length = np.linalg.norm(line)
        if abs(line @ level) < _ALONG * length * size:
            raise InputError(
                f"{stretch}: walls turn the field only along a corridor that runs with it; "
                f"lay start and end within 30 degrees of ({level[0] / size:.2f}, {level[1] / size:.2f})"
            )
        across = np.array([-line[1], line[0]]) / length
        middle = start + np.linspace(0.0, 1.0, math.ceil(length / _SPACING) + 1)[:, None] * line
        place = np.concatenate([middle - side * across, middle + side * across])
        position = np.column_stack([place, np.full(len(place), height)])
        rows.append((position, np.tile([*across, 0.0], (len(place), 1))))
    scale = _turning(stretches, rows, level)
    position = np.concatenate([position for position, _ in rows])
    moment = np.concatenate([k * unit for k, (_, unit) in zip(scale, rows, strict=True)])
    return Dipoles(jnp.asarray(position, float), jnp.asarray(moment, float))


def _turning(
    stretches: Sequence[Stretch], rows: Sequence[tuple[np.ndarray, np.ndarray]], level: np.ndarray
) -> np.ndarray:
    """By how much `(N,)` to multiply the moments of each row, positions and moments `(K, 3)`, so that in the
    middle of each stretch nothing is left across the direction to which the field `(2,)` is turned."""
    angle = np.radians([stretch.turn for stretch in stretches])
    cos, sin = np.cos(angle), np.sin(angle)
    beside = np.stack([-sin * level[0] - cos * level[1], cos * level[0] - sin * level[1]], axis=1)
    middle = np.array([[*np.add(stretch.start, stretch.end) / 2, _FOOT] for stretch in stretches])
    felt = np.empty((len(stretches), len(stretches)))
    for n, (position, moment) in enumerate(rows):
        r = middle[:, None] - position
        square = np.sum(r**2, axis=-1, keepdims=True)
        each = (3.0 * r * np.sum(r * moment, axis=-1, keepdims=True) / square - moment) / square**1.5
        felt[:, n] = np.sum(_DIPOLE * each.sum(axis=1)[:, :2] * beside, axis=1)
    own = np.abs(np.diag(felt))
    for stretch, mine, all_of_them in zip(stretches, own, np.abs(felt).sum(axis=1), strict=True):
        if not all_of_them < 1.5 * mine:
            raise InputError(f"{stretch}: is too near to another one; put start and end further from it")
    return np.linalg.solve(felt, -beside @ level)


_APART = 8.0  # m from the start within which there is no bump
_CAR_SPEED, _CAR_SIDE = 8.0, 3.0  # m/s, m from the start
_GROUND = 0.7  # m below the foot, where what disturbs the start lies


def outdoors(
    route: np.ndarray,
    seed: int,
    bumps: int = 0,
    low: float = 6.0,
    high: float = 18.0,
    car: float = 0.0,
    start: float = 0.0,
    standing_s: float = 3.0,
) -> tuple[Dipoles, Movers]:
    """Street furniture, parked cars and covers beside a `route (N, 3)` in m; the same for the same seed.

    `bumps` dipoles stand 1 to 2.5 m beside it, evenly along it but none near its start, each felt by a foot
    on the route by `low` to `high` µT at most. `start` is felt where the route begins, in a direction of its
    own, and hardly a few metres on. `car` is felt there, too, where a car that drives by is nearest, at some
    time within the `standing_s` seconds of rest.
    """
    rng = np.random.default_rng([43, seed])
    foot = np.column_stack([route[:, :2], np.full(len(route), _FOOT)])
    step = np.linalg.norm(np.diff(foot[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    far = np.flatnonzero(np.linalg.norm(foot - foot[0], axis=1) > _APART)
    if bumps and not len(far):
        raise InputError(f"a walk that stays within {_APART:g} m of its start has no room for bumps")
    place, moment = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for n in range(int(bumps)):
        wanted = along[-1] * (n + rng.uniform(0.1, 0.9)) / bumps
        k = int(far[np.argmin(np.abs(along[far] - wanted))])
        ahead = foot[min(k + 1, len(foot) - 1), :2] - foot[max(k - 1, 0), :2]
        beside = np.array([-ahead[1], ahead[0]]) / max(float(np.linalg.norm(ahead)), 1e-9)
        at = np.append(
            foot[k, :2] + rng.choice([-1, 1]) * rng.uniform(1.0, 2.5) * beside, rng.uniform(-0.5, 1.0)
        )
        unit = _unit(rng)
        place.append(at[None])
        moment.append((rng.uniform(low, high) / _felt(at, unit, foot) * unit)[None])
    below = foot[0] - [0.0, 0.0, _GROUND]
    unit = _unit(rng)
    place.append(below[None])
    moment.append((start / _felt(below, unit, foot[:1]) * unit)[None])
    angle, unit = rng.uniform(0, 2 * np.pi), _unit(rng)
    passes = rng.uniform(0.2, 0.8) * standing_s
    drive = np.array([math.cos(angle), math.sin(angle), 0.0])
    nearest = foot[0] + _CAR_SIDE * np.array([-drive[1], drive[0], 0.0])
    size = car / _felt(nearest, unit, foot[:1])
    travel = np.array([[passes - 20.0, passes + 20.0]])
    begin = nearest - 20.0 * _CAR_SPEED * drive
    movers = moving(begin[None], (size * unit)[None], (_CAR_SPEED * drive)[None], travel)
    kept = slice(0, None if start else -1)
    dipoles = Dipoles(jnp.asarray(np.concatenate(place[kept])), jnp.asarray(np.concatenate(moment[kept])))
    return dipoles, movers if car else jax.tree.map(lambda x: x[:0], movers)


def _unit(rng: np.random.Generator) -> np.ndarray:
    x = rng.normal(size=3)
    return np.asarray(x / np.linalg.norm(x))


def _felt(place: np.ndarray, unit: np.ndarray, route: np.ndarray) -> float:
    """The largest field in µT that a dipole of 1 A m² makes along a route `(N, 3)`."""
    r = route - place
    square = np.sum(r**2, axis=1, keepdims=True)
    each = _DIPOLE * (3 * r * (r @ unit)[:, None] / square - unit) / square**1.5
    return float(np.linalg.norm(each, axis=1).max())
