"""Noises that adapt against naive loops, look by look."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.filters import adaptive
from pedjax.filters.adaptive import Adaptive
from pedjax.filters.covariance import STATES
from pedjax.filters.kalman import Rows
from tests.reference import alignment as naive

LAWS = ("printed", "trace", "innovation", "windowed")
COUNT, LANES, ROWS = 40, 4, 2


def settings(law, **changes):
    return parameters.cast(parameters.replace(Adaptive(), {"law": law, **changes}), float)


@jax.jit
def gone_through(p, looks):
    """All looks `(T, ...)`: the memories, the rows' noise and α after each."""
    like = jnp.zeros(looks[-1].shape[1:])

    def one(memory, look):
        P, innovation, noise, H, now = look
        memory, rows, alpha = adaptive.adapted(p, memory, P, Rows(innovation, noise, {"t": H}), now)
        return memory, (memory, rows, alpha)

    return jax.lax.scan(one, adaptive.start(p, like), looks)[1]


def looks_at(seed=0, now=1.0, size=0.1):
    """Innovations of two rows, some of them large; noise that is not diagonal; P in blocks."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(COUNT, 15, 20, LANES)) * 0.02
    full = np.einsum("tikl,tjkl->tijl", factor, factor)
    P = {
        a + b: jnp.asarray(full[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3])
        for i, a in enumerate(STATES)
        for j, b in enumerate(STATES)
        if i <= j
    }
    z = size * rng.normal(size=(COUNT, ROWS, LANES)) * np.where(rng.random((COUNT, 1, LANES)) < 0.3, 6, 1)
    R = np.broadcast_to(np.array([[0.01, 0.0], [0.0, 0.03]])[..., None], (COUNT, ROWS, ROWS, LANES))
    H = rng.normal(size=(COUNT, ROWS, 3, LANES))
    now = np.broadcast_to(now, (COUNT, LANES)) if np.ndim(now) == 0 else now
    return P, *(jnp.asarray(x) for x in (z, R, H, now))


def of_lane(looks, k):
    """z, H P Hᵀ, R and whether it is a look, one by one."""
    P, z, R, H, now = looks
    for t in range(COUNT):
        h = np.asarray(H[t, ..., k])
        yield (
            np.asarray(z[t, :, k]), h @ np.asarray(P["tt"][t, ..., k]) @ h.T, np.asarray(R[t, ..., k]),
            bool(now[t, k]),
        )  # fmt: skip


@pytest.mark.parametrize("law", LAWS)
def test_each_law_equals_the_loops(law):
    """Over looks some of which are none."""
    rng = np.random.default_rng(1)
    looks = looks_at(1, now=(rng.random((COUNT, LANES)) < 0.8) * 1.0)
    p = settings(law, softness=1e-3, scale=1.7, window=6)
    _, rows, alpha = gone_through(p, looks)
    some = 0
    for k in range(LANES):
        loop = naive.Noise(law, 1.7, 6)
        for t, (z, HPH, R, now) in enumerate(of_lane(looks, k)):
            expected = loop.see(z, HPH, R, now)
            some += expected > 0.01
            assert alpha[t, k] == pytest.approx(expected, rel=1e-9, abs=0.0015), (t, k)
            factor = max(float(alpha[t, k]), 1e-9) if law == "printed" else 1 + float(alpha[t, k])
            np.testing.assert_allclose(rows.noise[t, ..., k], factor * R, rtol=1e-12)
    np.testing.assert_array_equal(rows.innovation, looks[1])
    assert some > 20


@pytest.mark.parametrize("law", ["innovation", "windowed"])
def test_softness_rounds_the_corner_and_its_limit_is_none(law):
    looks = looks_at(2)
    hard, soft = (gone_through(settings(law, softness=s), looks)[2] for s in (1e-3, 0.8))
    for k in range(LANES):
        exact, loop = [], naive.Noise(law)
        signed = naive.Noise(law, signed=True)
        for z, HPH, R, now in of_lane(looks, k):
            exact.append((loop.see(z, HPH, R, now), signed.see(z, HPH, R, now)))
        corner, x = np.transpose(exact)
        np.testing.assert_allclose(hard[:, k], corner, atol=1e-3 * np.log(2) + 1e-12)
        np.testing.assert_allclose(soft[:, k], [naive.softened(y, 0.8) for y in x], rtol=1e-9)
    assert (hard == 0).any() or hard.min() < 1e-9
    assert (soft >= hard).all()
    assert (soft > hard + 0.1).any()


@pytest.mark.parametrize("law", LAWS)
def test_the_noise_is_never_less_but_for_the_printed_law(law):
    looks = looks_at(3)
    _, rows, alpha = gone_through(settings(law), looks)
    share = np.asarray(rows.noise[:, 0, 0] / looks[2][:, 0, 0])
    assert (np.asarray(alpha) >= 0).all()
    if law == "printed":
        assert share.min() < 0.05
    else:
        assert share.min() >= 1.0
    assert (share > 0).all()


def test_the_printed_law_is_sure_of_what_is_as_large_as_usual():
    """Innovations that are all alike, of two looks and more: next to no noise."""
    P, z, R, H, now = looks_at(4)
    looks = P, 0 * z + 0.1, R, H, now
    _, rows, alpha = gone_through(settings("printed", window=3), looks)
    usual = 3 / 2 * ROWS * 0.01
    np.testing.assert_allclose(alpha[5:], usual - ROWS * 0.01, rtol=1e-9)
    assert (np.asarray(rows.noise[5:, 0, 0]) < 0.02 * np.asarray(R[5:, 0, 0])).all()
    first = np.asarray(rows.noise[0, 0, 0] / R[0, 0, 0])
    np.testing.assert_allclose(first, 1e-9)
    np.linalg.cholesky(np.moveaxis(np.asarray(rows.noise), -1, 1))  # it is still a covariance


@pytest.mark.parametrize("law", ["printed", "trace", "windowed"])
def test_as_many_looks_are_remembered_as_the_window_has(law):
    """A change of the looks before changes α, and none of those further back."""
    P, z, R, H, now = looks_at(5)
    p = settings(law, window=5, softness=1.0)
    last = [np.asarray(gone_through(p, looks_at(5))[2][-1])]
    for back in range(1, 8):
        other = P, z.at[COUNT - back].mul(1.5), R, H, now
        last.append(np.asarray(gone_through(p, other)[2][-1]))
    for back in range(1, 6):
        assert (np.abs(last[back] - last[0]) > 1e-6).all(), back
    for back in (6, 7):
        np.testing.assert_array_equal(last[back], last[0])


@pytest.mark.parametrize("law", ["printed", "trace", "windowed"])
def test_what_is_no_look_is_not_remembered(law):
    p, looks = settings(law), looks_at(6, now=0.0)
    memory, _, _ = gone_through(p, looks)
    for x in jax.tree.leaves(memory):
        np.testing.assert_array_equal(x, 0.0)
    now = np.ones((COUNT, LANES))
    now[20] = 0.0
    P, z, R, H, now = looks_at(6, now=now)
    changed = P, z.at[20].mul(100.0), R, H, now
    a, b = (gone_through(p, x)[0] for x in ((P, z, R, H, now), changed))
    for ours, theirs in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_laws_that_remember_nothing_have_no_memory():
    assert adaptive.start(settings("innovation"), jnp.zeros(3)) == ()
    assert adaptive.start(settings("none"), jnp.zeros(3)) == ()
    memory = adaptive.start(settings("windowed", window=4), jnp.zeros(3))
    assert len(memory.squares) == 4


@pytest.mark.parametrize("law", LAWS)
def test_slopes_of_alpha_equal_differences(law):
    looks, p = looks_at(7), settings(law, softness=0.6, scale=1.2)
    names = ("scale", "softness") if law in ("innovation", "windowed") else ("scale",)

    @jax.jit
    @jax.value_and_grad
    def total(values):
        q = parameters.with_leaves(p, {n: values[n] for n in names})
        moved = looks[0], looks[1] * values["z"], *looks[2:]
        return jnp.sum(gone_through(q, moved)[2] * jnp.arange(LANES))

    values = {"z": jnp.asarray(1.1), **{n: getattr(p, n) for n in names}}
    found = total(values)[1]
    for name, x in values.items():
        h = 1e-6 * x
        up, down = (total({**values, name: x + s})[0] for s in (h, -h))
        assert found[name] == pytest.approx(float((up - down) / (2 * h)), rel=1e-5), name
        assert found[name] != 0


@partial(jax.jit, static_argnames="dtype")
def summed(p, looks, dtype):
    def total(p, looks):
        return sum(jnp.sum(x) for x in jax.tree.leaves(gone_through(p, looks)))

    return jax.grad(total, argnums=(0, 1))(p, looks)


@pytest.mark.parametrize("law", LAWS)
def test_slopes_are_finite_for_no_innovation_and_a_huge_one(law):
    dtype = jnp.float32
    P, z, R, H, now = looks_at(8)
    looks = jax.tree.map(
        lambda x: x.astype(dtype), (P, z.at[:5].set(0.0).at[9].set(1e4), R, H.at[3].set(0.0), now)
    )
    for x in jax.tree.leaves(summed(parameters.cast(settings(law), dtype), looks, dtype)):
        assert np.isfinite(x).all()
