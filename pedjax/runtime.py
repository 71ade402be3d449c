"""The process-wide choices that must be made before JAX starts, in one explicit call."""

from __future__ import annotations

import hashlib
import os
import platform
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp

from pedjax.errors import InputError

_WHOLE_LOOP = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=10000000000000"
"""Compile a scanned filter as one loop instead of dispatching every small kernel of its body."""

_NO_CUSTOM_DOT = "--xla_cpu_experimental_ynn_fusion_type="
"""A small product handed to a library would keep its loop from that."""

_WRONG_SUMS = ("0.10.2", "0.11.0")
"""Versions of jaxlib whose library kernels give wrong sums of products over about ten thousand lanes in
float32 on a CPU (github.com/jax-ml/jax/issues/39103), without a word."""

_PLAIN_FUSION = "--xla_cpu_use_fusion_emitters=false"
"""So would the fusion kernels of jaxlib 0.10, which later ones have no choice about."""

_FAST_CPU = {
    (0, 10): (_PLAIN_FUSION, _WHOLE_LOOP, _NO_CUSTOM_DOT),
    (0, 11): (_WHOLE_LOOP, _NO_CUSTOM_DOT),
    (0, 12): (_WHOLE_LOOP, _NO_CUSTOM_DOT),
}
"""By version of jaxlib: two to twenty times faster. An unknown option would abort the process."""

_WIDE_CPU = "--xla_cpu_prefer_vector_width=512"
"""Use the whole vector registers where the processor has wide ones: twice the speed in lanes."""

PRECISIONS = ("float32", "float64")


class Runtime(NamedTuple):
    """What is in force: the fast compilation options, the number of `devices` wanted of a CPU (None: JAX's
    own choice), the precision, the folder of compiled programs, and what could not be had."""

    fast: bool
    devices: int | None
    precision: str
    cache: Path | None
    notes: tuple[str, ...]


def configure(
    fast: bool = True,
    *,
    precision: str | None = None,
    devices: int | None = None,
    cache: str | Path | None = None,
) -> Runtime:
    """Choose how programs are compiled; call it before anything else uses JAX.

    `fast` asks for the fast compilation options (`PEDJAX_FAST=0` in the environment turns them off);
    `precision`, float32 or float64, is that of everything that does not choose its own (tuning always runs in
    float64); `devices` splits the CPU into that many, for sweeps; `cache` keeps compiled programs in that
    folder, so that the next process need not compile them.

    What cannot be had, because it is not known to this jaxlib or JAX has already started, is warned of, and
    everything works without it. The command line makes this call; importing pedjax never does (it only keeps
    faulty kernels out of reach, `avoid_wrong_sums`).
    """
    notes: list[str] = []
    if precision is not None:
        if precision not in PRECISIONS:
            raise InputError(f"precision '{precision}' is unknown; known are: {', '.join(PRECISIONS)}")
        jax.config.update("jax_enable_x64", precision == "float64")
    if devices is not None:
        _split_cpu(devices, notes)
    in_force = _fast_options(notes) if fast and os.environ.get("PEDJAX_FAST", "1") != "0" else False
    folder = None if cache is None else _keep_compiled(Path(cache), notes)
    for note in notes:
        warnings.warn(note, stacklevel=2)
    return Runtime(in_force, devices, str(jnp.result_type(float)), folder, tuple(notes))


def avoid_wrong_sums() -> None:
    """Keep the kernels of `_WRONG_SUMS` from being used, unless the user has chosen among them."""
    import jaxlib

    flags = os.environ.get("XLA_FLAGS", "")
    if jaxlib.__version__ not in _WRONG_SUMS or _NO_CUSTOM_DOT.split("=")[0] in flags:
        return
    if _started():
        warnings.warn(
            f"jaxlib {jaxlib.__version__} adds up wrongly in some large float32 products, and JAX has "
            "already started: import pedjax before using JAX, or take another version of jaxlib",
            stacklevel=3,
        )
        return
    os.environ["XLA_FLAGS"] = f"{flags} {_NO_CUSTOM_DOT}".strip()


def _fast_options(notes: list[str]) -> bool:
    """Put the fast options into XLA_FLAGS; whether they are in force."""
    import jaxlib

    version = tuple(int(part) for part in jaxlib.__version__.split(".")[:2])
    if version not in _FAST_CPU:
        notes.append(
            f"fast compilation options are not known for jaxlib {jaxlib.__version__}; filters run without "
            "them, perhaps several times slower"
        )
        return False
    flags = os.environ.get("XLA_FLAGS", "")
    wanted = [*_FAST_CPU[version], *([_WIDE_CPU] if _has_wide_vectors() else [])]
    missing = [option for option in wanted if option.split("=")[0] not in flags]
    if not missing:
        return True
    if _started():
        notes.append(
            "JAX has already started: call pedjax.configure() before using it, or filters run several "
            "times slower"
        )
        return False
    os.environ["XLA_FLAGS"] = " ".join([flags, *missing]).strip()
    return True


def _split_cpu(devices: int, notes: list[str]) -> None:
    if devices < 1:
        raise InputError(f"devices = {devices} must be at least 1")
    if not _started():
        jax.config.update("jax_num_cpu_devices", devices)
    elif len(jax.local_devices(backend="cpu")) != devices:
        have = len(jax.local_devices(backend="cpu"))
        notes.append(f"JAX has already started with {have} CPU devices: {devices} cannot be had any more")


def _keep_compiled(folder: Path, notes: list[str]) -> Path | None:
    """The cache for this machine's processor below `folder`: programs of another one could not run here."""
    place = folder / hashlib.sha256(_processor().encode()).hexdigest()[:12]
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        notes.append(f"{place}: compiled programs cannot be kept there ({error.strerror})")
        return None
    jax.config.update("jax_compilation_cache_dir", str(place))
    # the two hundred small programs of a command cost as much to compile as a large one
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return place


def default_cache() -> Path:
    """Where the command line keeps compiled programs: `PEDJAX_CACHE`, or the user's cache folder."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("PEDJAX_CACHE") or Path(home) / "pedjax")


def _processor() -> str:
    """What the processor calls itself, and its features where the system lists them."""
    known = [platform.machine(), platform.processor()]
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return " ".join(known)
    for key in ("model name", "flags", "Features"):
        known += [line for line in lines if line.startswith(key)][:1]
    return "\n".join(known)


def _has_wide_vectors() -> bool:
    return " avx512f " in f"{_processor()} "


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def lane_count(dtype: jnp.dtype, platform_name: str | None = None) -> int:
    """How many runs to put side by side in one loop of the filter, or one kernel.

    On a CPU as many as fill one vector register: a step then has no loop over lanes left, and its state
    stays in the nearest cache (`python -m benchmarks` draws the rate against this number). Without the fast
    options every kernel of a step is dispatched by itself, which more lanes share. A GPU is full with several
    warps on each of its hundred and some processors.
    """
    where = platform_name or jax.default_backend()
    if where != "cpu":
        return 65536
    flags = os.environ.get("XLA_FLAGS", "")
    if _WHOLE_LOOP not in flags:
        return 64
    register = 64 if _WIDE_CPU in flags else 32
    return register // jnp.dtype(dtype).itemsize


def _started() -> bool:
    """Whether a backend is up (asking JAX for its devices would start one)."""
    from jax._src import xla_bridge

    return bool(getattr(xla_bridge, "_backends", {}))


@contextmanager
def double_precision() -> Iterator[None]:
    """float64 inside this block: float32 gradients of a long walk are off by percents."""
    with jax.enable_x64(True):
        yield
