"""The skin that consumers read, and the public iCub with it."""

from pathlib import Path

import pytest

from tests.consumers.robots import Skin, icub_urdf, make_skin, without_shapes


@pytest.fixture(scope="session")
def skin(tmp_path_factory) -> Skin:
    return make_skin(tmp_path_factory.mktemp("skin"))


@pytest.fixture(scope="session")
def icub(tmp_path_factory) -> Path:
    """Give the public iCub without its meshes."""
    return without_shapes(icub_urdf(), tmp_path_factory.mktemp("icub") / "icub.urdf")
