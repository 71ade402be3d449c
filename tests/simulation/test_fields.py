"""Magnetic fields against Maxwell's equations, closed forms and finite differences."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import InputError
from pedjax.detectors.field import inclination
from pedjax.lanes import norm
from pedjax.simulation import fields
from pedjax.simulation.earth import declination, homogeneous
from pedjax.simulation.fields import Cylinders, Dipoles, Lines, Movers, Stretch, compose, field_at

MU0 = 4e-7 * math.pi * 1e6  # µT m / A
at = jax.jit(field_at, static_argnames="mode")
MUNICH = np.array([0.0, 48 * math.cos(math.radians(64)), -48 * math.sin(math.radians(64))])


def groups(rng, n=4):
    """Some of each source, in x and y of ±3 m and below 0."""

    def place(k):
        return np.concatenate([rng.uniform(-3, 3, (n, 2)), rng.uniform(-1, 0, (n, k - 2))], axis=1)

    return {
        "dipoles": Dipoles(place(3), rng.normal(size=(n, 3)) * 20),
        "lines": Lines(place(3), rng.normal(size=(n, 3)) * [1, 1, 0.1], rng.normal(size=n) * 30),
        "cylinders": Cylinders(place(2), rng.uniform(0.05, 0.3, n), rng.uniform(5, 2000, n)),
        "movers": Movers(
            place(3),
            rng.normal(size=(n, 3)) * 20,
            rng.normal(size=(n, 3)) * 0.1,
            np.array([[1.0, 3.0]] * n),
            np.array([[0.0, 5.0]] * n),
            np.full(n, 0.3),
        ),
    }


def everything(rng):
    return compose(MUNICH, *groups(rng).values())


def derivative(field, points, time=0.0, mode="superpose"):
    """dB/dx `(3, 3, K)` at points `(3, K)`."""
    one = jax.jacfwd(lambda p: field_at(field, p, time, mode))
    return np.moveaxis(jax.jit(jax.vmap(one))(points.T), 0, -1)


def assert_source_free(jacobian):
    """Neither divergence nor curl, to 1e-9 of the derivatives."""
    size = np.linalg.norm(jacobian, axis=(0, 1))
    assert (size > 0).all()
    assert (np.abs(np.trace(jacobian)) < 1e-9 * size).all()
    assert (np.abs(jacobian - jacobian.swapaxes(0, 1)).max(axis=(0, 1)) < 1e-9 * size).all()


def outside(field, rng, n=200, time=0.0):
    """Points `(3, n)` up to 4 m away, outside of all iron and half a metre off the floor or more."""
    points = np.concatenate([rng.uniform(-4, 4, (2, 4 * n)), rng.uniform(0.5, 2.5, (1, 4 * n))])
    clear = points[:, ~np.asarray(fields.inside(field, jnp.asarray(points), time))]
    assert clear.shape[1] >= n
    return jnp.asarray(clear[:, :n])


@pytest.mark.parametrize("name", ["dipoles", "lines", "cylinders", "movers", "everything"])
def test_no_divergence_and_no_curl(name, rng):
    sources = groups(rng)
    field = compose(MUNICH, *(sources.values() if name == "everything" else [sources[name]]))
    points = outside(field, rng, time=2.0)
    assert_source_free(derivative(field, points, time=2.0))


def test_no_divergence_and_no_curl_in_made_up_places(rng):
    steel = fields.building(jax.random.key(0), ((-4.0, 4.0), (-4.0, 4.0)))
    assert_source_free(derivative(steel, outside(steel, rng)))
    street = fields.street_template(2, first=-1)
    points = outside(street, rng)
    for mode in ("superpose", "nearest"):
        assert_source_free(derivative(street, points, mode=mode))


def test_first_power_of_the_radius_would_have_divergence():
    h, radius = np.array([0.0, 25.0]), 0.4

    def printed(p):
        r = jnp.sqrt(p @ p)
        u = p / r
        return h + radius / r * (2 * u * (u @ h) - h)

    jacobian = jax.jacfwd(printed)(jnp.array([0.7, 0.9]))
    assert abs(jnp.trace(jacobian)) > 0.1 * jnp.linalg.norm(jacobian)


def test_dipole_is_its_closed_form(rng):
    source, moment, points = rng.normal(size=3), rng.normal(size=3), 3 + rng.normal(size=(3, 20))
    found = at(compose(np.zeros(3), Dipoles(source[None], moment[None])), points)
    r = points.T - source
    distance = np.linalg.norm(r, axis=1, keepdims=True)
    unit = r / distance
    expected = MU0 / (4 * np.pi) * (3 * unit * (unit @ moment)[:, None] - moment) / distance**3
    np.testing.assert_allclose(found.T, expected, rtol=1e-12, atol=1e-15)


def test_dipole_is_a_small_current_loop():
    """Biot and Savart's law round a loop; what is left of it falls with the square of its radius."""
    points = np.array([[0.3, 1.0, -0.4], [0.7, 0.1, 0.5], [0.5, 0.8, -0.6]])
    found = at(compose(np.zeros(3), Dipoles(np.zeros((1, 3)), np.array([[0.0, 0.0, 2.0]]))), points)
    left = []
    for radius in (1e-2, 1e-3):
        angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        place = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle])
        step = radius * np.stack([-np.sin(angle), np.cos(angle), 0 * angle]) * (2 * np.pi / 200)
        r = points[:, None] - place[:, :, None]
        along = (
            np.cross(np.broadcast_to(step[:, :, None], r.shape), r, axis=0) / np.linalg.norm(r, axis=0) ** 3
        )
        loop = MU0 / (4 * np.pi) * 2.0 / (np.pi * radius**2) * along.sum(axis=1)
        left.append(np.abs(loop - found).max() / np.abs(found).max())
    assert left[1] < 1e-5
    assert left[0] / left[1] == pytest.approx(100, rel=0.02)


def test_line_obeys_amperes_law(rng):
    """Right-handed circulation µ0 I round the wire, none round a circle beside it."""
    direction = rng.normal(size=3)
    field = compose(MUNICH, Lines(np.array([[0.1, 0.2, 0.3]]), direction[None], np.array([7.0])))
    unit = direction / np.linalg.norm(direction)
    e1 = np.cross(unit, [1.0, 0.0, 0.0])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(unit, e1)
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    for centre, enclosed in ((np.zeros(3), 7.0), (2 * e1, 0.0)):
        circle = np.array([0.1, 0.2, 0.3]) + centre + 0.2 * e2
        ring = circle[:, None] + 0.9 * (e1[:, None] * np.cos(angle) + e2[:, None] * np.sin(angle))
        tangent = 0.9 * (e2[:, None] * np.cos(angle) - e1[:, None] * np.sin(angle)) * (2 * np.pi / 400)
        np.testing.assert_allclose((at(field, ring) * tangent).sum(), MU0 * enclosed, atol=1e-9)


def post(radius=0.5, permeability=1000.0, background=(0.0, 25.0, -40.0), place=(0.0, 0.0)):
    sources = Cylinders(np.array([place]), np.array([radius]), np.array([permeability]))
    return compose(np.array(background), sources)


def test_surface_of_a_post():
    """Twice the background where it enters, next to nothing beside it, and both boundary conditions."""
    field = post()
    pole, side = at(field, jnp.array([[0.0, 0.5], [0.5, 0.0], [1.0, 1.0]])).T
    np.testing.assert_allclose(pole, [0.0, 2 * 25 / (1 + 1 / 1000), -40.0], rtol=1e-12)
    np.testing.assert_allclose(pole[1], 50.0, rtol=2e-3)
    np.testing.assert_allclose(side, [0.0, 2 * 25 / (1 + 1000), -40.0], rtol=1e-12, atol=1e-12)
    angle = np.linspace(0, 2 * np.pi, 37)
    u = np.stack([np.cos(angle), np.sin(angle), 0 * angle])
    just = 1e-14
    out, within = (at(field, 0.5 * (1 + sign * just) * u)[:2] for sign in (1, -1))
    np.testing.assert_allclose((out * u[:2]).sum(0), (within * u[:2]).sum(0), atol=1e-12 * 25)
    tangent = np.stack([-np.sin(angle), np.cos(angle)])
    # H = B / µ has no jump along the surface
    np.testing.assert_allclose((out * tangent).sum(0), (within * tangent).sum(0) / 1000, atol=2e-12 * 25)


def test_inside_a_post():
    field, points = post(), jnp.array([[0.0, 0.1, 0.49, 0.51], [0.0] * 4, [0.0] * 4])
    assert fields.inside(field, points).tolist() == [True, True, True, False]
    np.testing.assert_allclose(at(field, points)[1, :3], 2 * 1000 / 1001 * 25, rtol=1e-14)
    np.testing.assert_array_equal(
        at(post(permeability=1.0), points), np.array([[0.0], [25.0], [-40.0]]) + 0 * points
    )


def test_published_trigonometric_form(rng):
    """With the angle from north towards east, Munoz Diaz et al. 2017, Eq. 21, and the square put back."""
    points = rng.uniform(1, 3, (3, 10))
    rho, r = np.arctan2(points[0], points[1]), np.hypot(points[0], points[1])
    k = 999 / 1001 * (0.5 / r) ** 2
    expected = np.stack([25 * k * np.sin(2 * rho), 25 * (1 + k * np.cos(2 * rho)), 0 * r - 40.0])
    np.testing.assert_allclose(at(post(), points), expected, rtol=1e-13)


def test_nearest_is_superposition_of_one_post(rng):
    points = rng.uniform(-2, 2, (3, 4, 5))
    one = post(place=(0.2, -0.1))
    np.testing.assert_allclose(at(one, points, mode="nearest"), at(one, points), rtol=1e-14)


def test_nearest_takes_the_post_whose_surface_is_nearest():
    small, big = post(0.1, place=(0.0, 0.0)), post(1.0, place=(3.0, 0.0))
    both = compose(small, big.cylinders)
    points = jnp.array([[-0.5, 0.9, 1.1, 2.5, 5.0], [0.0] * 5, [0.0] * 5])
    nearest = fields.nearest_object(both, points)
    assert nearest.tolist() == [0, 0, 1, 1, 1]  # the surfaces are equally near at 1.05 m
    expected = np.where(nearest == 0, at(small, points), at(big, points))
    np.testing.assert_allclose(at(both, points, mode="nearest"), expected, rtol=1e-14)
    superposed = at(small, points) + at(big, points) - both.background[:, None]
    np.testing.assert_allclose(at(both, points), superposed, rtol=1e-14)
    assert int(fields.nearest_object(both, points[:, 0])) == 0


def test_nearest_jumps_only_where_the_object_changes():
    street = fields.street_template(2)
    walk = jnp.stack([jnp.arange(6.0, 38.0, 0.01), jnp.zeros(3200), jnp.ones(3200)])
    field, number = at(street, walk, mode="nearest"), fields.nearest_object(street, walk)
    jump, changes = np.abs(np.diff(field, axis=1)).max(axis=0), np.diff(number) != 0
    assert 4 <= changes.sum() <= 12
    assert jump[~changes].max() < 0.2
    assert jump[changes].max() > 0.5


def test_moving():
    mover = fields.moving([[1.0, 0.0, 0.0]], [[0.0, 0.0, 30.0]], [[0.0, 2.0, 0.5]], [[1.0, 3.0]])
    field, point = compose(MUNICH, mover), jnp.array([0.0, 1.0, 1.0])
    time = jnp.array([-5.0, 1.0, 1.5, 2.25, 3.0, 99.0])
    found = at(field, point, time)
    assert found.shape == (3, 6)
    for moved, b in zip((0.0, 0.0, 0.5, 1.25, 2.0, 2.0), found.T, strict=True):
        here = np.array([[1.0, 2 * moved, 0.5 * moved]])
        np.testing.assert_allclose(b, at(compose(MUNICH, Dipoles(here, mover.moment)), point), rtol=1e-13)


def test_switching():
    place, moment = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.0, 0.0, 30.0], [0.0, 5.0, 0.0]]
    field = compose(MUNICH, fields.switching(place, moment, [[0.0, 2.0], [2.0, 3.0]]))
    still = [
        compose(MUNICH, Dipoles(np.array([p]), np.array([m]))) for p, m in zip(place, moment, strict=True)
    ]
    point = jnp.array([0.3, 0.2, 1.0])
    expected = [MUNICH, at(still[0], point), at(still[0], point), at(still[1], point), MUNICH]
    found = at(field, point, jnp.array([-1e-9, 0.0, 1.999, 2.0, 3.0]))
    np.testing.assert_allclose(found.T, np.array(expected), rtol=1e-13)


def test_soft_switch_has_a_gradient_by_its_time():
    def strength(on, width):
        door = fields.switching([[1.0, 0.0, 0.0]], [[0.0, 0.0, 30.0]], [[0.0, 1.0]], width)
        door = door._replace(on=jnp.stack([on, on + 1])[None])
        return norm(field_at(compose(MUNICH, door), jnp.zeros(3), 0.1))

    slope = jax.grad(strength)(jnp.array(0.0), 0.1)
    step = 1e-5
    between = (strength(jnp.array(step), 0.1) - strength(jnp.array(-step), 0.1)) / (2 * step)
    np.testing.assert_allclose(slope, between, rtol=1e-7)
    assert abs(slope) > 1.0
    assert jax.grad(strength)(jnp.array(0.0), 0.0) == 0


@pytest.mark.parametrize("mode", ["superpose", "nearest"])
def test_gradients_by_all_source_parameters(mode, rng):
    field = everything(rng)
    points = outside(field, rng, n=6, time=1.5)
    weight = jnp.asarray(rng.normal(size=points.shape))

    @jax.jit
    def loss(field, points):
        return jnp.sum(weight * field_at(field, points, 1.5, mode))

    slopes = jax.jit(jax.grad(loss, argnums=(0, 1)))(field, points)
    leaves, tree = jax.tree.flatten((field, points))
    for k, slope in enumerate(jax.tree.leaves(slopes)):
        direction = rng.normal(size=leaves[k].shape)
        step = 1e-5

        def moved(sign, k=k, direction=direction, step=step):
            changed = [leaf + sign * step * direction if j == k else leaf for j, leaf in enumerate(leaves)]
            return loss(*jax.tree.unflatten(tree, changed))

        between = (moved(1) - moved(-1)) / (2 * step)
        np.testing.assert_allclose(jnp.sum(slope * direction), between, rtol=1e-5, atol=1e-8)


def test_values_and_gradients_are_finite_on_every_source(rng):
    field = compose(everything(rng), Cylinders(np.array([[1.0, 1.0]]), np.zeros(1), np.ones(1)))
    on = [field.dipoles.position, field.movers.position, field.lines.point]
    on += [np.pad(field.cylinders.place, ((0, 0), (0, 1)))]
    points = jnp.concatenate(on).T
    assert fields.inside(field, points)[:-1].all()

    def total(field, points, mode):
        return jnp.sum(field_at(field, points, 0.5, mode) ** 2)

    for mode in ("superpose", "nearest"):
        found = jax.jit(jax.value_and_grad(total, argnums=(0, 1)), static_argnums=2)(field, points, mode)
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(found))


def test_a_dipole_is_a_ball_of_a_centimetre():
    """The field goes through its surface without a jump, and one circumference of it changes nothing."""
    field = compose(np.zeros(3), Dipoles(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])))
    pole = jnp.array([[0.0, 0.0], [0.0, 0.0], [0.01 * (1 + 1e-12), 0.01 * (1 - 1e-12)]])
    outer, inner = at(field, pole).T
    np.testing.assert_allclose(outer, inner, rtol=1e-10)
    np.testing.assert_allclose(at(field, jnp.zeros(3))[2], 2 / 3 * MU0 / (4 / 3 * np.pi * 1e-6), rtol=1e-12)
    wire = compose(np.zeros(3), Lines(np.zeros((1, 3)), np.array([[0.0, 0.0, 2.0]]), np.ones(1)))
    b = at(wire, jnp.array([[0.0, 0.005, 0.01, 0.02], [0.0] * 4, [1.0] * 4]))[1]
    np.testing.assert_allclose(b, MU0 / (2 * np.pi) * np.array([0.0, 50.0, 100.0, 50.0]), rtol=1e-12)


@pytest.mark.parametrize("lanes", [(), (1,), (7,), (2, 3), (0,)])
def test_any_lanes(lanes, rng):
    field, points = everything(rng), rng.uniform(-3, 3, (3, *lanes))
    for mode in ("superpose", "nearest"):
        found = at(field, points, 0.5, mode=mode)
        assert found.shape == (3, *lanes)
        flat = points.reshape(3, -1)
        each = [at(field, flat[:, i], 0.5, mode=mode) for i in range(flat.shape[1])]
        if each:
            np.testing.assert_allclose(found.reshape(3, -1).T, np.array(each), rtol=1e-12)
    assert fields.inside(field, points).shape == fields.nearest_object(field, points).shape == lanes


def test_time_has_lanes_too(rng):
    field, points, time = everything(rng), rng.uniform(-3, 3, (3, 1, 4)), np.linspace(0, 4, 5)[:, None]
    found = at(field, points, time)
    assert found.shape == (3, 5, 4)
    np.testing.assert_allclose(found[:, 2, 3], at(field, points[:, 0, 3], 2.0), rtol=1e-13)
    assert fields.inside(field, points, time).shape == (5, 4)


def test_empty_groups_add_nothing(rng):
    empty, points = compose([0.0, 20.0, -40.0]), rng.uniform(-3, 3, (3, 6))
    for mode in ("superpose", "nearest"):
        np.testing.assert_array_equal(at(empty, points, mode=mode), np.tile([[0.0], [20.0], [-40.0]], 6))
    assert not fields.inside(empty, points).any()
    assert (fields.nearest_object(empty, points) == -1).all()
    slope = jax.grad(lambda f: field_at(f, jnp.zeros(3)).sum())(empty)
    np.testing.assert_array_equal(slope.background, 1.0)
    sources = groups(rng)
    for name, group in sources.items():
        alone = compose(np.zeros(3), group) if name != "cylinders" else compose([0.0, 20.0, -40.0], group)
        rest = [other for key, other in sources.items() if key != name]
        left = compose([0.0, 20.0, -40.0], *rest)
        both = compose(left, group)
        added = at(alone, points) - alone.background[:, None]
        np.testing.assert_allclose(at(both, points), at(left, points) + added, rtol=1e-11)


def test_one_program_for_all_positions_and_strengths(rng):
    traces = []

    @jax.jit
    def traced(field, position, time):
        traces.append(1)
        return field_at(field, position, time)

    for _ in range(3):
        traced(everything(rng), rng.normal(size=(3, 8)), rng.uniform())
    assert len(traces) == 1


def test_single_precision_is_kept(rng):
    field = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), everything(rng))
    points = jnp.asarray(outside(field, rng, n=20), jnp.float32)
    for mode in ("superpose", "nearest"):
        found = at(field, points, jnp.float32(0.5), mode=mode)
        assert found.dtype == jnp.float32
        double = at(jax.tree.map(lambda x: x.astype(float), field), points.astype(float), 0.5, mode=mode)
        np.testing.assert_allclose(found, double, rtol=1e-4, atol=1e-4)


def test_unknown_words_are_named():
    with pytest.raises(InputError, match="did you mean 'nearest'"):
        field_at(compose(MUNICH), jnp.zeros(3), mode="neares")
    with pytest.raises(InputError, match="did you mean 'office'"):
        fields.building(jax.random.key(0), ((0, 1), (0, 1)), "ofice")
    with pytest.raises(InputError, match="extent"):
        fields.building(jax.random.key(0), ((1, 0), (0, 1)))
    with pytest.raises(InputError, match="tiles"):
        fields.street_template(-1)


EXTENTS = {
    "office": ((0.0, 16.0), (0.0, 12.0)),
    "corridor": ((0.0, 30.0), (-1.2, 1.2)),
    "hall": ((0.0, 25.0), (0.0, 20.0)),
}


def walks(style, height):
    """Straight lines `(3, K, 81)`, 8 m long, a sample each 0.1 m."""
    (west, east), (south, north) = EXTENTS[style]
    ys = [0.0, 0.3] if style == "corridor" else np.linspace(south + 1.2, north - 1.2, 4)
    x, start, y = np.broadcast_arrays(
        np.arange(81) * 0.1, np.arange(west + 1, east - 9, 3.0)[:, None, None], 0.0
    )
    x, y = np.broadcast_arrays((x + start)[:, :, :], np.asarray(ys)[None, :, None] + y)
    return np.stack([x, y, np.full(x.shape, height)]).reshape(3, -1, 81)


@pytest.mark.parametrize("style", fields.STYLES)
@pytest.mark.parametrize("height", [0.1, 1.0])
def test_buildings_disturb_as_buildings_do(style, height):
    """Over ten seeds: RMS of the disturbance, spread of the norm over 8 m, and its largest values."""
    path = walks(style, height)

    @jax.jit
    def disturbed(key):
        return field_at(fields.building(key, EXTENTS[style], style, path=path), path)

    rms, spread, most = [], [], []
    for seed in range(10):
        b = np.asarray(disturbed(jax.random.key(seed)))
        off = np.linalg.norm(b - MUNICH[:, None, None], axis=0)
        rms.append(np.sqrt(np.mean(off**2)))
        spread.append(np.median(np.ptp(np.linalg.norm(b, axis=0), axis=-1)))
        most.append(off.max())
    assert 3.0 < np.min(rms) <= np.max(rms) < 6.0
    low, high = {0.1: (8.0, 24.0), 1.0: (4.0, 10.0)}[height]
    assert low < np.min(spread) <= np.max(spread) < high
    assert 5.0 < np.median(spread) < 20.0
    assert 7.0 < np.median(most) < np.max(most) < 35.0


def test_steel_is_felt_from_near():
    """At a quarter of a metre some places are off by more than 30 µT, but few."""
    path = walks("office", 1.0)
    off = []
    for seed in range(4):
        field = fields.building(jax.random.key(seed), EXTENTS["office"], path=path, clearance=0.25)
        off.append(np.linalg.norm(np.asarray(at(field, path)) - MUNICH[:, None, None], axis=0))
    assert 0.0 < np.mean(np.array(off) > 30.0) < 0.02


def test_buildings_are_reproducible_scaled_and_clear_of_the_path():
    key, extent = jax.random.key(3), EXTENTS["office"]
    one, again = fields.building(key, extent), fields.building(key, extent)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    with jax.enable_x64(False):
        single = fields.building(jax.random.key(3), extent)
    assert single.dipoles.moment.dtype == jnp.float32
    np.testing.assert_allclose(single.dipoles.moment, one.dipoles.moment, rtol=1e-5)
    np.testing.assert_allclose(single.dipoles.position, one.dipoles.position, rtol=1e-5, atol=1e-5)
    other = fields.building(jax.random.key(4), extent)
    assert np.abs(other.dipoles.moment - one.dipoles.moment).max() > 1.0
    point = jnp.array([3.0, 2.0, 1.0])
    slope = jax.grad(lambda s: field_at(fields.building(key, extent, strength=s), point).sum())(1.0)
    np.testing.assert_allclose(slope, (at(one, point) - MUNICH).sum(), rtol=1e-10)
    path = jnp.array([[1.0, 5.0], [1.0, 1.0], [0.1, 0.1]])
    clear = fields.building(key, extent, path=path)
    gone = np.asarray((clear.dipoles.moment == 0).all(axis=1))
    place, height = np.asarray(clear.dipoles.position[:, :2]), np.asarray(clear.dipoles.position[:, 2])
    near = np.linalg.norm(place[:, None] - np.asarray(path[:2].T), axis=-1).min(axis=1) <= 0.5
    np.testing.assert_array_equal(gone, near & (height >= 0) & (height <= 3))


def test_street_of_the_paper():
    """Five posts a tile along Easting; 22 to 28 µT along the walk, as in Fig. 10 of Munoz Diaz et al."""
    street = fields.street_template(3, first=1)
    place, radius = np.asarray(street.cylinders.place), np.asarray(street.cylinders.radius)
    np.testing.assert_allclose(place[5:10] - place[:5], np.tile([16.0, 0.0], (5, 1)))
    assert (place[:5, 0] > 22).all()
    assert (place[:5, 0] < 38).all()
    assert sorted(set(radius)) == [0.1, 1.0]
    assert (radius == 1.0).sum() == 3
    walk = jnp.stack([jnp.linspace(22.0, 70.0, 4800), jnp.zeros(4800), jnp.ones(4800)])
    for mode in ("nearest", "superpose"):
        b = norm(at(street, walk, mode=mode))
        assert 22 < b.min() < 24.9
        assert 26 < b.max() < 28
    np.testing.assert_array_equal(street.background, homogeneous("equator"))
    assert len(fields.street_template(0).cylinders.radius) == 0
    slope = jax.grad(lambda a: field_at(fields.street_template(1, car_radius=a), walk[:, 0]).sum())(1.0)
    assert slope != 0


def test_floor_magnet():
    """It turns the compass of a foot above it by more than 45 degrees, and is not felt two metres on."""
    field = compose(MUNICH, fields.floor_magnet((4.0, 1.0)))
    over, beside = at(field, jnp.array([[4.0, 6.0], [1.0, 1.0], [0.1, 0.1]])).T
    assert abs(declination(over)) > np.pi / 4
    assert abs(declination(beside)) < 0.03
    assert abs(inclination(beside) - np.radians(64)) < 0.03


WALLS = (Stretch((0, 0), (0, 8), 15.0), Stretch((3, 50), (0, 30), -30.0), Stretch((40, 20), (40, 8), 30.0))


def along(stretch, *metres):
    """Points `(3, K)` m from the start of a stretch on, 0.1 m high."""
    start, end = np.array(stretch.start, float), np.array(stretch.end, float)
    ahead = (end - start) / np.linalg.norm(end - start)
    return np.stack([*(start + np.array(metres)[:, None] * ahead).T, np.full(len(metres), 0.1)])


def turned(field, points):
    """By how much the horizontal field is turned, counter-clockwise, in degrees."""
    turn = -np.degrees(declination(at(field, points)) - declination(field.background))
    return (np.asarray(turn) + 180.0) % 360.0 - 180.0


def test_magnetised_walls_have_no_divergence_and_no_curl(rng):
    walls = compose(MUNICH, fields.magnetised_walls(WALLS, MUNICH))
    assert_source_free(derivative(walls, outside(walls, rng)))


@pytest.mark.parametrize("facing", [0.0, 100.0, 250.0])
def test_magnetised_walls_turn_the_field_and_keep_its_strength(facing):
    """In the middle the turn is exact; over the stretch it is even, beyond its ends soon gone, and what the
    field gains in strength is what a field across it adds."""
    c, s = np.cos(np.radians(facing)), np.sin(np.radians(facing))
    rotate = np.array([[c, -s], [s, c]])
    background = np.array([*(rotate @ MUNICH[:2]), MUNICH[2]])
    stretches = [Stretch(tuple(rotate @ each.start), tuple(rotate @ each.end), each.turn) for each in WALLS]
    field = compose(background, fields.magnetised_walls(stretches, background))
    for stretch in stretches:
        length = math.dist(stretch.start, stretch.end)
        middle = along(stretch, length / 2)
        np.testing.assert_allclose(turned(field, middle), stretch.turn, atol=0.1)
        inside = along(stretch, *np.linspace(2.0, length - 2.0, 30))
        np.testing.assert_allclose(turned(field, inside), stretch.turn, rtol=0.04)
        beyond = along(stretch, -10.0, length + 10.0)
        np.testing.assert_allclose(turned(field, beyond), 0.0, atol=0.5)
        everywhere = along(stretch, *np.linspace(-12.0, length + 12.0, 400))
        extremes = np.sort([0.0, stretch.turn]) + abs(stretch.turn) * np.array([-0.06, 0.06])
        assert (turned(field, everywhere) > extremes[0]).all()
        assert (turned(field, everywhere) < extremes[1]).all()
    for stretch in (stretches[0], stretches[2]):  # along the field
        middle = along(stretch, math.dist(stretch.start, stretch.end) / 2)
        across = np.linalg.norm(background[:2]) * math.tan(math.radians(stretch.turn))
        expected = math.hypot(np.linalg.norm(background), across)
        assert norm(at(field, middle))[0] == pytest.approx(expected, abs=0.05)
        assert expected < 48.0 + 1.6


def test_stretches_are_turned_as_asked_beside_each_other():
    near = (Stretch((0, 0), (0, 8), 30.0), Stretch((0, 11), (0, 19), -20.0))
    field = compose(MUNICH, fields.magnetised_walls(near, MUNICH))
    for stretch in near:
        np.testing.assert_allclose(turned(field, along(stretch, 4.0)), stretch.turn, atol=1e-6)
    with pytest.raises(InputError, match="too near to another one; put start and end further"):
        fields.magnetised_walls((near[0], near[0]), MUNICH)


def test_wider_corridors_turn_the_field_more_slowly():
    steepest = []
    for side in (2.0, 4.0):
        field = compose(MUNICH, fields.magnetised_walls(WALLS[2:], MUNICH, side=side))
        turn = turned(field, along(WALLS[2], *np.linspace(-6.0, 6.0, 121)))
        steepest.append(np.abs(np.diff(turn)).max() / 0.1)
    assert steepest[1] == pytest.approx(steepest[0] / 2, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stretches": ()}, "stretches is empty; give at least one"),
        (
            {"stretches": [Stretch((0, 0), (8, 0), 15.0)]},
            r"lay start and end within 30 degrees of \(0.00, 1.00\)",
        ),
        ({"side": 0.1}, "side = 0.1 must lie between"),
        ({"height": 1.5}, "height = 1.5 must lie between 0 and half of side, 1 m"),
        ({"background": homogeneous("north_pole")}, "no horizontal field to turn; take another"),
    ],
)
def test_impossible_walls_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        fields.magnetised_walls(**{"stretches": WALLS, "background": MUNICH, **change})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (((0, 0), (0, 8), 60.0), r"from \(0, 0\) to \(0, 8\): turn = 60 must lie between -45 and 45"),
        (((0, 0), (0, 8)), "turn = 0 must lie"),
        (((0, 0), (0, 0.5), 15.0), "start and end must be at least 1 m apart and are 0.5 m"),
        (((0, 0), (0, 8, 1), 15.0), r"end = \(0, 8, 1\) must be two numbers"),
    ],
)
def test_impossible_stretches_are_refused(given, message):
    with pytest.raises(InputError, match=message):
        Stretch(*given)


ROUTE = np.column_stack([np.linspace(0, 60, 90), 3 * np.sin(np.linspace(0, 4, 90)), np.zeros(90)])


def felt(groups, at, time=0.0):
    """Strength in microtesla of what is added at places (N, 3)."""
    field = compose(jnp.zeros(3), *groups)
    return np.linalg.norm(np.asarray(fields.field_at(field, jnp.asarray(at).T, time)), axis=0)


def test_bumps_are_as_high_as_asked_for_and_not_at_the_start():
    foot = np.add(ROUTE, [0.0, 0.0, 0.1])
    dipoles, movers = fields.outdoors(ROUTE, 3, bumps=5, low=6.0, high=18.0)
    assert len(dipoles.position) == 5
    assert len(movers.position) == 0
    for k in range(5):  # alone: all moments but one are none
        alone = fields.Dipoles(dipoles.position, dipoles.moment * (np.arange(5) == k)[:, None])
        assert 5.999 < felt([alone], foot).max() < 18.001
    assert felt([dipoles], foot[:1])[0] < 2.0
    again, _ = fields.outdoors(ROUTE, 3, bumps=5)
    np.testing.assert_array_equal(again.moment, dipoles.moment)
    assert not np.array_equal(fields.outdoors(ROUTE, 4, bumps=5)[0].moment, dipoles.moment)


def test_a_start_is_disturbed_where_it_is_and_a_car_passes_while_one_stands():
    foot = np.add(ROUTE, [0.0, 0.0, 0.1])
    dipoles, _ = fields.outdoors(ROUTE, 3, start=15.0)
    assert felt([dipoles], foot[:1])[0] == pytest.approx(15.0, rel=1e-6)
    assert felt([dipoles], foot[10:]).max() < 0.5
    _, movers = fields.outdoors(ROUTE, 3, car=20.0, standing_s=7.0)
    time = np.arange(0.0, 12.0, 0.02)
    seen = felt([movers], np.tile(foot[:1], (len(time), 1)), time)
    assert 19.9 < seen.max() < 26.0  # 20 where it is nearest; on its side a dipole may be felt more
    assert 0.2 * 7.0 - 0.05 < time[seen.argmax()] < 0.8 * 7.0 + 0.05
    assert seen[time > 9.0].max() < 0.5
    with pytest.raises(InputError, match="stays within 8 m of its start has no room for bumps"):
        fields.outdoors(ROUTE[:5], 3, bumps=2)
