"""A publisher in C++ on Fast DDS, the default middleware of ROS 2, built here and read over the loopback interface.

Debian: `apt-get install libfastrtps-dev fastddsgen g++`.
"""

import shutil
import subprocess
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
if not (shutil.which("fastddsgen") and shutil.which("g++")):
    pytest.skip("Fast DDS is not installed (Debian: libfastrtps-dev, fastddsgen, g++)", allow_module_level=True)

from skincal.model.readings import Stream
from skincal.streams.links import LinkSpec, open_link
from tests.skincal.ros.dds_peer import DOMAIN
from tests.skincal.streams.test_ros2_link import decode

SOURCES = Path(__file__).resolve().parents[1] / "ros"
HZ, COUNT = 1000, 3000
QUIET_READS = 30


@pytest.fixture(scope="module")
def publisher(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fastdds")
    shutil.copy(SOURCES / "fastdds_wrench.idl", folder)
    subprocess.run(["fastddsgen", "-replace", "-typeros2", "fastdds_wrench.idl"], cwd=folder, check=True, capture_output=True)
    sources = [*map(str, folder.glob("*.cxx")), str(SOURCES / "fastdds_publisher.cpp")]
    used = [each for each in sources if not each.endswith(("Main.cxx", "Publisher.cxx", "Subscriber.cxx"))]
    command = ["g++", "-O0", "-I.", *used, "-o", "publisher", "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "publisher"


@pytest.mark.timeout(300)
def test_every_wrench_of_a_fast_dds_publisher_is_read(publisher):
    child = subprocess.Popen([publisher, str(DOMAIN), str(HZ), str(COUNT)], stdout=subprocess.PIPE, text=True)
    try:
        data, quiet = b"", 0
        with closing(open_link(LinkSpec("link", f"ros2:/ft/wrench?domain={DOMAIN}", (Stream.WRENCH,)))) as link:
            while len(data) < 1000 or quiet < QUIET_READS:
                new = link.read(0.1)
                data, quiet = data + new, 0 if new else quiet + 1
        assert child.stdout.readline() == "sent\n"
    finally:
        child.kill()
        child.communicate()
    (batch,), decoder = decode(data, Stream.WRENCH)
    assert batch.values[:, 0].tolist() == list(range(1, COUNT + 1))
    assert set(batch.values[:, 5]) == {-0.5}
    assert np.all(np.diff(batch.device_s) > 0)
    assert batch.device_s[-1] - batch.device_s[0] == pytest.approx((COUNT - 1) / HZ, rel=0.2)
    assert decoder.counts.total() == 0
