"""What is chosen before JAX starts: what is in force, and what could not be had."""

import json
import os
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlib
import numpy as np
import pytest

import pedjax
from pedjax import runtime
from pedjax.errors import InputError
from tests.sweeping.processes import python

EARLY = """
import json, os, sys, warnings
import jax, jax.numpy as jnp, pedjax
warnings.simplefilter("error")
found = pedjax.configure(precision=sys.argv[1], devices=3, cache=sys.argv[2])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones((4, 4))).block_until_ready()
print(json.dumps({**found._asdict(), "cache": str(found.cache), "count": len(jax.devices()),
                  "dtype": str(jnp.ones(1).dtype), "flags": os.environ.get("XLA_FLAGS", "")}))
"""


def test_everything_asked_for_early_is_in_force(tmp_path):
    """Twice: the second process finds its programs compiled."""
    kept = []
    for _ in range(2):
        found = json.loads(python(EARLY, "float64", tmp_path))
        assert found["devices"] == found["count"] == 3
        assert found["precision"] == found["dtype"] == "float64"
        assert found["notes"] == []
        assert found["fast"] == (runtime._WHOLE_LOOP in found["flags"])
        cache = Path(found["cache"])
        assert cache.parent == tmp_path
        kept.append({p.name for p in cache.iterdir() if p.name.endswith("-cache")})
    assert kept[0]
    assert kept[0] == kept[1]


UNKNOWN = """
import os, warnings, jaxlib
jaxlib.__version__ = "9.8.7"
import jax.numpy as jnp, pedjax
from pedjax.runtime import lane_count
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    found = pedjax.configure(precision="float32")
assert [str(w.message) for w in caught] == list(found.notes)
print(len(caught), "jaxlib 9.8.7" in found.notes[0], found.fast, os.environ.get("XLA_FLAGS"))
print(float(jnp.ones(3).sum()), lane_count(jnp.float32))
"""


def test_an_unknown_jaxlib_works_and_warns_once():
    assert python(UNKNOWN).split() == ["1", "True", "False", "None", "3.0", "64"]


@pytest.fixture
def started():
    return jax.devices()


def test_what_is_in_force_now(configured, started):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = pedjax.configure(devices=1)
    assert found == (configured, 1, "float64", None, ())


def test_devices_asked_for_too_late_are_warned_of(started):
    with pytest.warns(UserWarning, match="already started with 1 CPU devices: 5 cannot be had") as caught:
        found = pedjax.configure(devices=5)
    assert len(caught) == len(found.notes) == 1
    assert jax.devices() == started


def test_a_cache_that_cannot_be_made_is_warned_of(tmp_path):
    (tmp_path / "file").write_text("")
    before = jax.config.jax_compilation_cache_dir
    with pytest.warns(UserWarning, match="compiled programs cannot be kept there") as caught:
        found = pedjax.configure(cache=tmp_path / "file")
    assert len(caught) == 1
    assert found.cache is None
    assert jax.config.jax_compilation_cache_dir == before


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"precision": "float16"}, "precision 'float16' is unknown; known are: float32, float64"),
        ({"devices": 0}, "devices = 0 must be at least 1"),
    ],
)
def test_what_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        pedjax.configure(**wrong)


def test_the_options_can_be_turned_off(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    monkeypatch.setenv("PEDJAX_FAST", "0")
    assert not pedjax.configure().fast
    monkeypatch.delenv("PEDJAX_FAST")
    assert not pedjax.configure(fast=False).fast
    assert os.environ["XLA_FLAGS"] == "--xla_cpu_enable_fast_math=false"


@pytest.mark.parametrize("version", ["0.9.2", "9.8.7"])
def test_an_unknown_version_leaves_the_flags_alone(monkeypatch, version):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    monkeypatch.setattr(jaxlib, "__version__", version)
    with pytest.warns(UserWarning, match=f"not known for jaxlib {version}"):
        assert not pedjax.configure().fast
    assert "XLA_FLAGS" not in os.environ


@pytest.mark.parametrize(("flags", "bits"), [(("_WHOLE_LOOP",), 256), (("_WHOLE_LOOP", "_WIDE_CPU"), 512)])
def test_lanes_fill_a_register(monkeypatch, flags, bits):
    monkeypatch.setenv("XLA_FLAGS", " ".join(getattr(runtime, name) for name in flags))
    for dtype in (jnp.float32, np.dtype("float64")):
        assert runtime.lane_count(dtype, "cpu") * jnp.dtype(dtype).itemsize * 8 == bits


def test_lanes_are_many_where_kernels_are_dispatched_one_by_one(monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    assert runtime.lane_count(jnp.float32, "cpu") == runtime.lane_count(jnp.float64, "cpu") == 64
    assert runtime.lane_count(jnp.float32, "gpu") > 1000


def test_double_precision_ends_with_its_block():
    with jax.enable_x64(False):
        with runtime.double_precision():
            assert jnp.ones(1).dtype == jnp.float64
        assert jnp.ones(1).dtype == jnp.float32


def test_where_compiled_programs_are_kept(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("PEDJAX_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert runtime.default_cache() == tmp_path / ".cache" / "pedjax"
    monkeypatch.setenv("XDG_CACHE_HOME", "/cache")
    assert runtime.default_cache() == Path("/cache/pedjax")
    monkeypatch.setenv("PEDJAX_CACHE", "/mine")
    assert runtime.default_cache() == Path("/mine")
