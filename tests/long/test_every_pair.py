"""A whole guided session over every pair of protocols. By its name: `python3 -m pytest tests/long/test_every_pair.py`."""

import pytest

from tests.skincal.simulation import test_guided_protocols as guided

parts = guided.parts


@pytest.mark.parametrize(("wrench", "skin"), guided.all_pairs())
def test_a_guided_session_over_each_pair_comes_to_its_end(parts, wrench, skin):
    guided.come_to_the_end(parts, wrench, skin)
