"""The process-wide choices that must be made before JAX starts, in one explicit call."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import jax

_FAST_CPU = (
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=10000000000000",
    "--xla_cpu_experimental_ynn_fusion_type=",
)
"""Compile a scanned filter as one loop instead of dispatching every small kernel of its body: four to
twenty times faster. Known to jaxlib 0.10; an unknown option would abort the process, hence the check."""

_KNOWN_JAXLIB = ((0, 10),)


def configure(fast: bool = True) -> bool:
    """Choose the fast compilation options; call it before anything else uses JAX.

    Returns whether they are in force. Where they are not known to this jaxlib, or JAX has already started,
    everything works without them, several times slower, and a warning says so. The command line makes this
    call; importing pedjax never does. `PEDJAX_FAST=0` in the environment turns it off.
    """
    if not fast or os.environ.get("PEDJAX_FAST", "1") == "0":
        return False
    flags = os.environ.get("XLA_FLAGS", "")
    if all(option.split("=")[0] in flags for option in _FAST_CPU):
        return True
    import jaxlib

    version = tuple(int(part) for part in jaxlib.__version__.split(".")[:2])
    if version not in _KNOWN_JAXLIB:
        warnings.warn(
            f"fast compilation options are not known for jaxlib {jaxlib.__version__}; filters run without "
            "them, several times slower",
            stacklevel=2,
        )
        return False
    if _started():
        warnings.warn(
            "JAX has already started: call pedjax.configure() before using it, or filters run several "
            "times slower",
            stacklevel=2,
        )
        return False
    missing = [option for option in _FAST_CPU if option.split("=")[0] not in flags]
    os.environ["XLA_FLAGS"] = " ".join([flags, *missing]).strip()
    return True


def _started() -> bool:
    """Whether a backend is up (asking JAX for its devices would start one)."""
    from jax._src import xla_bridge

    return bool(getattr(xla_bridge, "_backends", {}))


@contextmanager
def double_precision() -> Iterator[None]:
    """float64 inside this block: float32 gradients of a long walk are off by percents."""
    with jax.enable_x64(True):
        yield
