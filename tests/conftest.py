"""What all tests share: repeatable random data.

Every run tries the same examples, so a red test is red again for whoever repeats it. To search for new ones:
`.venv/bin/python -m pytest --hypothesis-profile=search`.
"""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# No deadline: a shared machine pauses a process for longer than any test takes.
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("search", settings.get_profile("repeatable"), derandomize=False, max_examples=2000, print_blob=True)
settings.load_profile("repeatable")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Give random numbers that are the same in every run of this test, in whatever order tests run."""
    return np.random.default_rng(zlib.crc32(request.node.nodeid.encode()))
