"""`record` seen from outside: a folder that vanishes, a disk that is full, a device that sends garbage at the speed of a network."""

import os
import shutil
import time

import pytest

from tests.approved import approved
from tests.skincal.record_support import recorder, write_devices


@pytest.mark.skipif(os.name == "nt", reason="open files cannot be taken away there")
@pytest.mark.parametrize("gone", ["deleted", "moved"])
def test_a_folder_that_vanishes_ends_the_recording_with_2(tmp_path, gone):
    with recorder(write_devices(tmp_path, 30), tmp_path / "s") as process:
        try:
            for line in process.stderr:
                if "accepted" in line:
                    break
            if gone == "deleted":
                shutil.rmtree(tmp_path / "s")
            else:
                (tmp_path / "s").rename(tmp_path / "t")
            said = process.stderr.read().splitlines()
            assert process.wait(10) == 2
        finally:
            process.kill()
    assert approved("session.folder_gone") in said[-1]
    assert "export" not in said[-1]
    assert sum("accepted" in line for line in said) <= 2, "a poke takes a second"
    assert not (tmp_path / "s").exists()


def test_a_disk_that_is_full_at_the_start_is_said_and_not_in_the_way_of_the_next_try(tmp_path):
    resource = pytest.importorskip("resource")
    options = write_devices(tmp_path, 1)

    def no_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50, 50))

    with recorder(options, tmp_path / "s", preexec_fn=no_room) as process:
        said = process.communicate(timeout=30)[1]
    assert process.returncode == 2
    assert "File too large" in said
    assert len(said.splitlines()) == 1
    assert "export" not in said
    assert not (tmp_path / "s").exists()
    with recorder([*options, "--seconds", "0.5"], tmp_path / "s") as process:
        process.communicate(timeout=30)
    assert process.returncode == 0
