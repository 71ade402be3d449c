"""The command line: `pedjax info | run | tune | sweep | roc | parameters`."""

from pedjax.cli.main import main

__all__ = ["main"]
