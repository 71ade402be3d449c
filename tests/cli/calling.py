"""The command line in process."""

import json

from pedjax.cli.main import main


def call(*args):
    return main([str(a) for a in args])


def refused(capsys, *args):
    """Exit status 1 and one sentence on standard error."""
    assert call(*args) == 1
    error = capsys.readouterr().err
    assert error.startswith("pedjax: ")
    assert error.count("\n") == 1
    return error


def metrics(out):
    return json.loads((out / "metrics.json").read_text())
