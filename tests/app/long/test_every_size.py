"""Every page of the window at sizes between those of `tests/app/test_sizes.py`: `python3 -m pytest tests/app/long`."""

import pytest

from tests.app.test_sizes import look_at_every_page


@pytest.mark.timeout(400)
@pytest.mark.parametrize(("size", "percent"), [((1024, 700), 100), ((1366, 768), 150)])
def test_nothing_is_cut_on_any_page_at_other_sizes(bench, recorded, monkeypatch, size, percent):
    look_at_every_page(bench, recorded, monkeypatch, size, percent)
