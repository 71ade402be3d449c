"""Python in a process of its own, where JAX has not started and may be killed."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def environment(**changes):
    """Ours, without what this process has chosen for its own JAX."""
    dropped = ("XLA_FLAGS", "PEDJAX_FAST", "PEDJAX_CACHE")
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return {**kept, "PYTHONPATH": str(ROOT), **{name: str(value) for name, value in changes.items()}}


def start(code, *args, **changes):
    """A process that runs `code` with `args`, its output to be read as text."""
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, args)],
        env=environment(**changes),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process, status=0, timeout=300):
    """What a process has said, once it ended with that status."""
    try:
        out, error = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert process.returncode == status, f"status {process.returncode}: {out[-1000:]}\n{error[-3000:]}"
    return out, error


def python(code, *args, **changes):
    """What `code` prints."""
    return finish(start(code, *args, **changes))[0]
