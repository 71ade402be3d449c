"""The kernel, run as ordinary JAX, against a plain scan; and that it becomes a program for a GPU."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.kernels.columns import Columns, Layout, rows_in_order, rows_of, walk
from pedjax.kernels.tangents import Dual, dual, tangents
from pedjax.systems import system
from tests.kernels import tools, toy

CHUNKS, LENGTH, RECORDINGS = 5, 6, 3
WHICH = np.array([[0, 1], [-1, -1], [2, -1], [-1, -1], [-1, 0]], np.int32)


def columns(dtype, seed=0):
    rng = np.random.default_rng(seed)
    total = CHUNKS * LENGTH
    samples = {
        "force": jnp.asarray(rng.normal(0.1, 0.5, (total, 2, 2)), dtype),
        "flag": jnp.asarray(rng.uniform(size=(total, 2)) < 0.6),
    }
    row = np.full((total, 2), -1, np.int32)
    row[3::4, 0] = np.arange(len(row[3::4]))
    row[1::9, 1] = np.arange(len(row[1::9]))[::-1]
    return Columns(samples, jnp.asarray(WHICH), jnp.asarray(row))


def values(count, dtype):
    rng = np.random.default_rng(1)
    one = {"gain": rng.uniform(0.5, 2, count), "spread": rng.uniform(0.1, 1, count)}
    return {k: jnp.asarray(v, dtype)[:, None] for k, v in one.items()} | {"limit": jnp.asarray(0.7, dtype)}


def starts(p, dtype):
    opening = jnp.asarray(np.random.default_rng(2).normal(size=(2, RECORDINGS)), dtype)
    return toy.start(p, opening)


def both(advance, p, first, given, rows=9, **options):
    run = jax.jit(partial(walk, advance, rows=rows, layout=Layout(4, 1), **options))
    expected = jax.jit(partial(tools.scanned, advance, rows=rows))
    return run(p, first, given), expected(p, first, given)


def close(found, expected, within):
    for x, y in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert (x.shape, x.dtype) == (y.shape, y.dtype)
        x, y = np.asarray(x, float), np.asarray(y, float)
        np.testing.assert_allclose(x, y, rtol=0, atol=within * max(np.abs(y).max(), 1e-12))


@pytest.mark.parametrize(("dtype", "within"), [(jnp.float32, 1e-6), (jnp.float64, 1e-14)])
@pytest.mark.parametrize("count", [1, 6])
def test_is_the_scan(dtype, within, count):
    p = values(count, dtype)
    found, expected = both(toy.advance, p, starts(p, dtype), columns(dtype))
    close(found, expected, within)
    assert np.asarray(expected.status).any()  # the codes stick, and end with their recording
    assert not np.asarray(expected.status).all()
    assert not np.asarray(found.kept["place"][8]).any()  # a row that no sample names


def test_first_states_that_sets_or_recordings_share():
    p = values(6, jnp.float64)
    first = starts(p, jnp.float64)
    first = first._replace(P=first.P[..., :1], turned=first.turned[..., :1, :1], count=first.count[:1])
    close(*both(toy.advance, p, first, columns(jnp.float64)), 1e-14)


def test_parameters_that_all_lanes_share():
    p = values(1, jnp.float64)
    first = starts(p | {"gain": jnp.linspace(0.5, 2, 6)[:, None]}, jnp.float64)
    p = {k: v.reshape(()) for k, v in p.items()} | {"limit": 0.7}  # a plain number takes their precision
    close(*both(toy.advance, p, first, columns(jnp.float64)), 1e-14)


def test_other_parameters_compile_nothing():
    run = jax.jit(lambda p, s, c: walk(toy.advance, p, s, c, 9, Layout(4, 1)))
    given = columns(jnp.float64)
    for scale in (1.0, 1.1):
        p = jax.tree.map(lambda x, k=scale: x * k, values(3, jnp.float64))
        run(p, starts(p, jnp.float64), given)
    assert run._cache_size() == 1


def test_a_matrix_that_does_not_start_symmetric_is_no_number():
    p = values(4, jnp.float64)
    first = starts(p, jnp.float64)
    first = first._replace(P=first.P.at[1, 0, 2].add(1e-3))
    run = jax.jit(partial(walk, toy.advance, rows=9, layout=Layout(4, 1)))
    found = run(p, first, columns(jnp.float64))
    bad = np.isnan(np.asarray(found.sums["weight"])).any(axis=(0, 2))
    assert bad.tolist() == [False, False, True, False]


def test_slopes_are_those_of_the_scan():
    p = values(5, jnp.float64)
    given = Dual(p, {"gain": jnp.ones_like(p["gain"]), "spread": None, "limit": None})
    first = dual(partial(starts, dtype=jnp.float64), given)
    found, expected = both(tangents(toy.advance), given, first, columns(jnp.float64))
    close(found, expected, 1e-13)

    def place(gain):
        q = p | {"gain": gain}
        run = tools.scanned(toy.advance, q, starts(q, jnp.float64), columns(jnp.float64), 9)
        return run.kept["place"]

    slope = jax.jvp(place, (p["gain"],), (jnp.ones_like(p["gain"]),))[1]
    close(found.kept.slope["place"], slope, 1e-13)


def test_rows_for_slots_of_chunks_and_in_order():
    slot = jnp.array([[-1, 0], [0, 1], [1, -1], [-1, -1], [0, 0], [-1, -1]])
    assert rows_of(slot, 2, 2).T.tolist() == [[-1, 0, 1, -1, 2, -1], [0, 1, -1, -1, 2, -1]]
    assert rows_in_order(slot).T.tolist() == [[-1, 0, 1, -1, 2, -1], [0, 1, -1, -1, 2, -1]]
    assert rows_of(slot, 2, 5).T.tolist() == [[-1, 0, 1, -1, 5, -1], [0, 1, -1, -1, 5, -1]]


def test_needs_whole_chunks():
    given = columns(jnp.float64)
    p = values(2, jnp.float64)
    with pytest.raises(ValueError, match="no multiple"):
        walk(toy.advance, p, starts(p, jnp.float64), given._replace(row=given.row[:-1]), 9)


def runner(name, case, interpret):
    """A system's whole columns, first states made in the kernel, as `filtering.points` runs them."""
    found = system(name)
    start = (lambda p, opening: found.start(p, None, opening), case.openings)

    def run(p, s, c):
        return walk(tools.advance_of(found), p, s, c, case.rows, Layout(32, 1), interpret, start)

    return jax.jit(run)


@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["iez", "ma2018"])
def test_becomes_a_program_for_a_gpu(name, dtype):
    """Pallas finds a Triton instruction for everything; whether they compile shows on a GPU."""
    case = tools.case(name, {}, dtype, tools.some(6))
    run = runner(name, case, False).trace(case.parameters, case.starts, case.columns)
    assert run.lower(lowering_platforms=("cuda",)).as_text().count("custom_call") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "dtype", "within"), [("iez", jnp.float32, 3e-6), ("ma2018", jnp.float64, 1e-12)]
)
def test_systems_are_their_scan(name, dtype, within):
    """The whole kernel, interpreted; compiled without optimising, which would take minutes."""
    case = tools.case(name, {}, dtype, tools.some(3))
    given = (case.parameters, case.starts, case.columns)
    quick = {"xla_backend_optimization_level": 0}
    found = runner(name, case, True).lower(*given).compile(compiler_options=quick)(*given)
    expected = jax.jit(tools.scanned, static_argnums=(0, 4))(
        tools.advance_of(system(name)), *given, case.rows
    )
    close(found, expected, within)
