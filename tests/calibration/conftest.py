"""The folder of real recordings."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data():
    folder = os.environ.get("PEDJAX_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("PEDJAX_DATA does not name the folder of real recordings")
    return Path(folder)
