"""A filter that is compiled in a moment, with everything in its state that a kernel has to carry."""

from typing import NamedTuple

import jax.numpy as jnp

from pedjax import lanes


class State(NamedTuple):
    place: object
    P: object
    turned: object
    count: object
    seen: object
    idle: object


def start(p, opening):
    """`opening (2, R)`; parameters `(S, 1)`."""
    place = lanes.align(opening, 1, jnp.ndim(p["gain"])) + 0 * p["gain"]
    one = lanes.eye(2, place[0]) * (p["spread"] + 0 * place[0])
    return State(
        place, one, 2 * one, jnp.zeros(place.shape[1:], jnp.int32), jnp.zeros(place.shape[1:], bool), place
    )


def advance(p, state, sample):
    lane = state.seen.ndim
    force = lanes.align(sample["force"], 1, lane)
    flag = lanes.align(sample["flag"], 0, lane)
    place = state.place + p["gain"] * force
    F = lanes.eye(2, place[0]) + 0.1 * force[:, None] * force[::-1][None]
    P = lanes.matmul_t(lanes.matmul(F, state.P), F) + p["spread"] * lanes.eye(2, place[0])
    P = lanes.symmetric(P) / (1 + jnp.exp(-(place[0] ** 2))) / (1 + P[0, 0])
    turned = lanes.matmul(F, state.turned) / jnp.sqrt(1 + state.turned[0, 1] ** 2)
    seen = state.seen | (place[0] > p["limit"]) & flag
    count = state.count + jnp.where(flag, 1, 0)
    weight = jnp.where(place[1] > 0, 1.0, 0.5).astype(place.dtype) * P[0, 1]
    kept = {"place": place, "P": P, "seen": seen, "angle": jnp.arctan2(turned[0, 1], turned[1, 1])}
    status = jnp.where(seen & (count > 3), count, 0).astype(jnp.int32)
    return State(place, P, turned, count, seen, state.idle + 1), kept, {"weight": weight}, status
