"""The part that calibration files are of."""

import pytest

from tests.skincal.files.files_support import Part, make_part


@pytest.fixture(scope="module")
def part(tmp_path_factory) -> Part:
    return make_part(tmp_path_factory.mktemp("part"))
