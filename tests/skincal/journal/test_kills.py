"""A session whose recorder is killed several times loses nothing, whoever else opens it; `tests/long` does it longer."""

import signal

import pytest

from tests.skincal.journal.kill_support import killed_in_a_row

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill -9")


def test_three_kills_in_a_row_with_a_second_opener_lose_no_accepted_poke(tmp_path):
    assert killed_in_a_row(tmp_path, 3, seed=1) > 0
