"""Walks as files, and a command line that leaves nothing behind in the user's folders."""

import jax
import pytest

from pedjax.readers import write_csv


@pytest.fixture(scope="session")
def files(tmp_path_factory, demos):
    """The short demo walks as files."""
    folder = tmp_path_factory.mktemp("walks")
    paths = []
    for i, recording in enumerate(demos):
        path = folder / f"walk{i}.csv"
        write_csv(recording, path)
        paths.append(str(path))
    return paths


@pytest.fixture(scope="session", autouse=True)
def at_home(tmp_path_factory):
    """Programs are kept in a folder of our own; JAX has started, with one device."""
    jax.devices()
    before = jax.config.jax_compilation_cache_dir
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PEDJAX_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr("pedjax.runtime.available_cores", lambda: 1)
        yield
    jax.config.update("jax_compilation_cache_dir", before)
