"""The driver: causal to the bit, in chunks to the bit, compiled as one loop and only once."""

import os
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import filtering, parameters
from pedjax.packing import pack
from pedjax.preparing import prepare
from pedjax.recording import nominal_rate
from pedjax.systems import SYSTEMS
from pedjax.walks import walk
from tests import tools

IEZ = SYSTEMS["iez"]
ADAPTIVE = {
    "gate__kind": "adaptive",
    "gate__follow": 0.3,
    "gate__growth": 0.5,
    "gate__width": 0.25,
    **tools.shoe_sigmas(),
}


@pytest.fixture(scope="module")
def prepared(minute_recording):
    params = parameters.cast(tools.iez(**ADAPTIVE), float)
    found = tools.cropped(walk(minute_recording), 0, 1600)
    return params, prepare(IEZ, params, found, float, 1600), found


def test_cropping_the_end_changes_no_bit(prepared):
    params, inputs, found = prepared
    state = IEZ.start(params, None, inputs.opening)
    _, whole = tools.scan(IEZ, params, inputs.samples, state)
    for stop in (1000, 777):
        cropped = prepare(IEZ, params, tools.cropped(found, 0, stop), float, stop)
        _, part = tools.scan(IEZ, params, cropped.samples, IEZ.start(params, None, cropped.opening))
        tools.same_bits(jax.tree.map(lambda x, n=stop: x[:n], whole), part)


def test_a_cropped_recording_runs_to_the_same_bits(minute_recording):
    params = tools.iez(**ADAPTIVE)
    whole = pedjax.run(minute_recording, params=params)
    part = pedjax.run(tools.crop(minute_recording, 40.0), params=params)
    count = len(part.time)
    assert count < len(whole.time)
    told = [
        (t.estimate, t.sigma, t.status, [(g.weight, g.log_ratio) for g in t.gates.values()])
        for t in (whole, part)
    ]
    assert set(whole.estimate) == set(tools.ORACLE_NAMES)
    tools.same_bits(jax.tree.map(lambda x: x[:count], told[0]), told[1])


def test_two_chunks_equal_one_to_the_bit(prepared):
    params, inputs, _ = prepared
    for cut in (800, 431):
        tools.assert_chunks_equal_the_whole(IEZ, params, inputs, cut)


def test_what_is_kept_is_the_callers_choice(prepared):
    params, inputs, _ = prepared
    samples = jax.tree.map(lambda x: x[:50], inputs.samples)
    _, kept = filtering.scan(
        IEZ, params, None, samples, IEZ.start(params, None, inputs.opening), lambda o: o.estimate.position
    )
    assert kept.shape == (50, 3)


def computations(text):
    """Name to body of every computation of an HLO module."""
    return {
        m.group(1): m.group(2)
        for m in re.finditer(r"^(?:ENTRY )?%?([\w.-]+) \([^\n]*\{\n(.*?)^\}", text, re.MULTILINE | re.DOTALL)
    }


def reached(name, known, seen):
    """A computation and all it calls."""
    if name in seen or name not in known:
        return
    seen.add(name)
    for called in re.findall(r"(?:calls|to_apply|body|condition)=%?([\w.-]+)", known[name]):
        reached(called, known, seen)


def loop_text(text):
    """Everything inside the while loops of an HLO module, and how many there are."""
    known = computations(text)
    bodies = re.findall(r" while\([^\n]*body=%?([\w.-]+)", text)
    seen: set[str] = set()
    for body in bodies:
        reached(body, known, seen)
    return "\n".join(known[name] for name in seen), len(bodies)


HINDRANCES = re.compile(r"custom-call|scatter|kind=kCustom|__onednn|\bsort\(|\bfft\(")


@pytest.mark.parametrize("lanes", [1, 4])
def test_the_loop_is_hoisted(configured, demos, lanes):
    """No custom call, scatter or custom fusion in a loop's body: XLA then compiles the scan as one kernel."""
    if not configured:
        pytest.skip("the fast compilation options are not in force (PEDJAX_FAST=0, or another jaxlib)")
    params = parameters.cast(tools.iez(**ADAPTIVE), float)
    params = parameters.with_leaves(params, {"stance.shoe.threshold": jnp.full((lanes, 1), 1e3)})
    batch = pack(IEZ, parameters.cast(tools.iez(), float), [walk(r) for r in demos[:2]])
    points = jax.jit(filtering.scan_points, static_argnums=(0, 3))
    text = points.lower(IEZ, params, batch.packed, batch.slots).compile().as_text()
    body, count = loop_text(text)
    assert count == 2  # chunks, and the samples of a chunk
    assert len(body) > 10_000
    found = HINDRANCES.search(body)
    assert found is None, body[max(found.start() - 300, 0) : found.end() + 100]


def test_a_loop_that_cannot_be_hoisted_is_noticed():
    def body(a, _):
        return jnp.linalg.solve(a, jnp.eye(3)), None

    text = jax.jit(lambda a: jax.lax.scan(body, a, length=5)[0]).lower(jnp.eye(3)).compile().as_text()
    found, count = loop_text(text)
    assert count >= 1
    assert HINDRANCES.search(found)


def python(code, **environment):
    kept = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "PEDJAX_FAST")}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**kept, **environment}, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_without_the_options_the_track_is_the_same(tmp_path):
    code = """
import sys, jax, numpy as np, pedjax
print(pedjax.configure().fast)
jax.config.update("jax_enable_x64", True)
np.save(sys.argv[1] if len(sys.argv) > 1 else TARGET, pedjax.run(pedjax.read("demo:1")).position)
"""
    tracks = []
    for fast in ("0", "1"):
        target = tmp_path / f"{fast}.npy"
        printed = python(f"TARGET = {str(target)!r}\n{code}", PEDJAX_FAST=fast)
        assert printed.strip() == str(fast == "1") or fast == "1"
        tracks.append(np.load(target))
    np.testing.assert_allclose(tracks[0], tracks[1], atol=1e-9)


def test_sums_are_right_without_configuring():
    """jaxlib 0.10.2 by itself is off by 20 here, without a word."""
    code = """
import numpy as np, jax, pedjax
from pedjax import lanes
a, b = np.random.default_rng(0).normal(size=(2, 3, 3, 20000)).astype("f4")
print(np.abs(np.asarray(jax.jit(lanes.matmul_t)(a, b)) - np.einsum("ikl,jkl->ijl", a, b)).max())
"""
    assert float(python(code, XLA_FLAGS="", PEDJAX_FAST="0")) < 1e-4


def test_configuring_too_late_warns():
    code = """
import warnings, jax.numpy as jnp, pedjax
jnp.zeros(3).block_until_ready()
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    print(pedjax.configure().fast, len(caught), "already started" in str(caught[0].message))
"""
    assert python(code).split() == ["False", "1", "True"]


def test_configuring_early_works_once_and_again():
    code = """
import os, pedjax
print(pedjax.configure().fast, pedjax.configure().fast, len(os.environ["XLA_FLAGS"].split()))
"""
    first, second, flags = python(code, XLA_FLAGS="--xla_force_host_platform_device_count=1").split()
    assert first == second
    assert flags in (("4", "5") if first == "True" else ("1",))  # one more where vectors are wide


def test_importing_starts_nothing():
    """And sets nothing but what keeps the wrong sums of some versions away."""
    code = """
import os, jaxlib, pedjax
from pedjax.runtime import _NO_CUSTOM_DOT, _WRONG_SUMS, _started
print(_started(), os.environ.get("XLA_FLAGS"), _NO_CUSTOM_DOT if jaxlib.__version__ in _WRONG_SUMS else None)
"""
    started, flags, expected = python(code).split()
    assert started == "False"
    assert flags == expected


def test_recordings_of_nearly_equal_length_compile_once(minute_recording):
    traces = []

    def step(p, site, state, sample):
        traces.append(sample.sensor.dt.shape)
        return IEZ.step(p, site, state, sample)

    counted = IEZ._replace(step=step)
    for seconds, threshold in ((59.0, 1e8), (58.9, 1e8), (58.0, 1e7)):
        params = tools.iez(stance__shoe__threshold=threshold)
        pedjax.run(tools.crop(minute_recording, seconds), counted, params)
        if len(traces) and seconds == 59.0:
            once = len(traces)
    assert once >= 1
    assert len(traces) == once


def test_rates_round_to_whole_hertz(minute_recording):
    assert nominal_rate(walk(minute_recording).imu) == 100.0
