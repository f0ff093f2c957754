"""Logs of robometry, written in the layout of its logger, become records."""

import h5py
import numpy as np
import pytest

from skincal.files.importers.preview import guess_streams
from skincal.files.importers.registry import RECORDING_IMPORTERS, RecordedPlace, importer_of
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from tests.skincal.files.test_rosbag import readings

NAMES = ("l_shoulder_pitch", "l_elbow", "l_wrist_prosup")
ROWS = 5000
TIMES = 1_700_000_000 + 0.01 * np.arange(ROWS)


class MatFile:
    """A MATLAB file, version 7.3, as matioCpp writes it: axes reversed, texts as arrays of UTF-16 units by reference."""

    def __init__(self, path, root="robot_logger_device"):
        self.path, self.root_name = path, root
        self.file = h5py.File(path, "w", userblock_size=512)
        self.root = self.file.create_group(root)

    def texts(self, group, name, words):
        references = self.file.require_group("#refs#")
        cells = np.empty((1, len(words)), h5py.ref_dtype)
        for column, word in enumerate(words):
            cell = references.create_dataset(f"r{len(references)}", data=np.array([[ord(letter)] for letter in word], "u2"))
            cells[0, column] = cell.ref
        group.create_dataset(name, data=cells, dtype=h5py.ref_dtype)

    def channel(self, name, values, names=(), unit="", times=TIMES):
        group = self.root
        for part in name.split("::"):
            group = group.require_group(part)
        group["data"] = values.reshape(len(values), 1, -1)
        group["timestamps"] = times.reshape(-1, 1)
        if names:
            self.texts(group, "elements_names", names)
        if unit:
            self.texts(group, "units_of_measure", [unit])

    def close(self):
        self.file.close()
        with self.path.open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
        return self.path


def write_log(path, unit="rad", names=NAMES, root="robot_logger_device", skin=True):
    log = MatFile(path, root)
    log.texts(log.root, "description_list", NAMES)
    rows = np.arange(ROWS, dtype=float)[:, None]
    log.channel("FTs::l_arm_ft_sensor", rows + np.arange(6), ("f_x", "f_y", "f_z", "mu_x", "mu_y", "mu_z"))
    log.channel("FTs::r_arm_ft_sensor", rows - np.arange(6))
    log.channel("joints_state::positions", 0.001 * rows + np.arange(3), names, unit)
    log.channel("joints_state::velocities", rows + np.arange(3), names)
    log.channel("accelerometers::head", rows + np.arange(3))
    if skin:
        log.channel("skins::l_forearm", np.tile(np.arange(24, dtype=float), (ROWS, 1)) + rows % 7)
    return log.close()


def open_log(path, wrench="FTs::l_arm_ft_sensor", skin="skins::l_forearm", joints="joints_state::positions", names=()):
    texts = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints}
    return importer_of(path).open_recording({stream: RecordedPlace(path, text) for stream, text in texts.items()}, names)


@pytest.mark.parametrize(
    ("unit", "root", "factor", "words"),
    [
        ("rad", "robot_logger_device", 1.0, None),
        ("deg", "robot_logger_device", np.pi / 180, None),
        ("", "robot_logger_device", 1.0, "radians were assumed"),
        ("", "telemetry", np.pi / 180, "degrees were assumed"),
    ],
)
def test_channels_become_streams(tmp_path, unit, root, factor, words):
    path = write_log(tmp_path / "log.mat", unit, NAMES if unit else (), root)
    opened = open_log(path, names=("l_elbow", "", "l_shoulder_pitch"))
    values, losses = readings(opened)
    assert losses == {}
    np.testing.assert_allclose(values["wrench"][0], TIMES, atol=1e-6)
    assert np.array_equal(values["wrench"][1], np.arange(ROWS)[:, None] + np.arange(6))
    assert np.array_equal(values["skin"][1][:7], np.arange(24) + np.arange(7)[:, None])
    angles = 0.001 * np.arange(ROWS)
    np.testing.assert_allclose(values["joints"][1], factor * np.column_stack([angles + 1, 0 * angles, angles]), atol=1e-12)
    assert words is None or any(words in sentence for sentence in opened.findings)


def test_likely_channels_are_proposed(tmp_path):
    path = write_log(tmp_path / "log.mat")
    found = guess_streams([path])
    assert [place.topic for place in found.places.values()] == [
        "FTs::l_arm_ft_sensor", "skins::l_forearm", "joints_state::positions"
    ]  # fmt: skip
    assert RecordedPlace.parse(str(found.wrench)) == found.wrench


@pytest.mark.parametrize(("more", "axis"), [(1, 0), (-1, 0), (3, -1), (-10, -1)])
def test_a_log_with_other_times_than_rows_is_read_to_their_common_end(tmp_path, more, axis):
    """A logger that is stopped between a time and its row writes one more of either."""
    log = MatFile(tmp_path / "log.mat")
    rows, n = np.arange(ROWS, dtype=float)[:, None], min(ROWS, ROWS + more)
    times = np.append(TIMES, TIMES[-1] + 0.01 * np.arange(1, 11))[: ROWS + more]
    for name, values in (("FTs::arm", rows + np.arange(6)), ("skins::patch", rows + np.arange(24))):
        log.channel(name, values, times=times)
        if axis:
            group = log.root["/".join(name.split("::"))]
            del group["data"]
            group["data"] = values.T
    path = log.close()
    assert [place.topic for place in guess_streams([path]).places.values()] == ["FTs::arm", "skins::patch"]
    places = {Stream.WRENCH: RecordedPlace(path, "FTs::arm"), Stream.SKIN: RecordedPlace(path, "skins::patch")}
    opened = importer_of(path).open_recording(places)
    values, losses = readings(opened)
    assert losses == {}
    np.testing.assert_array_equal(values["wrench"][1], rows[:n] + np.arange(6))
    np.testing.assert_array_equal(values["skin"][1], rows[:n] + np.arange(24))
    np.testing.assert_allclose(values["skin"][0], TIMES[:n], atol=1e-6)
    said = f"channel FTs::arm has {ROWS} rows and {ROWS + more} times; the first {n} of both are read"
    assert any(said in sentence for sentence in opened.findings)


def test_a_channel_that_cannot_be_read_stays_in_the_list_and_is_refused_by_its_lengths(tmp_path):
    log = MatFile(tmp_path / "log.mat")
    log.channel("FTs::short", np.zeros((ROWS, 6)), times=TIMES[:-11])
    log.channel("skins::few", np.zeros((ROWS, 16)), times=TIMES[:10])
    log.channel("skins::untimed", np.zeros((ROWS, 16)), times=TIMES[:0])
    path = log.close()
    for name, words in (
        ("FTs::short", f"channel FTs::short has {ROWS} rows and {ROWS - 11} times; expected one time a row"),
        ("skins::few", f"channel skins::few has {ROWS} rows and 10 times"),
        ("skins::untimed", "channel skins::untimed has no times; choose another channel: it has FTs::short, skins::few, skins"),
        ("gone", "has no channel gone; it has FTs::short, skins::few, skins::untimed."),
    ):
        with pytest.raises(InputError) as refusal:
            importer_of(path).open_recording({Stream.SKIN: RecordedPlace(path, name)})
        assert words in str(refusal.value)


def test_groups_that_link_to_themselves_and_other_files_are_walked_once(tmp_path):
    log = MatFile(tmp_path / "log.mat")
    for k in range(20):
        log.root[f"again{k}"] = log.root
        log.root[f"soft{k}"] = h5py.SoftLink("/robot_logger_device")
        log.root[f"other{k}"] = h5py.ExternalLink("gone.mat", "/")
    log.channel("FTs::l_arm_ft_sensor", np.zeros((ROWS, 6)))
    assert [place.topic for place in guess_streams([log.close()]).places.values()] == ["FTs::l_arm_ft_sensor"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"skin": ""}, "the log has no channel of a skin; it has FTs::l_arm_ft_sensor, "),
        ({"wrench": "FTs::gone"}, "has no channel FTs::gone; it has "),
        ({"wrench": "joints_state::positions"}, "has 3 values; expected six"),
        ({"names": ("l_elbow", "neck_yaw")}, "has no joint neck_yaw; it has l_shoulder_pitch"),
    ],
)
def test_wrong_channels_are_named(tmp_path, options, words):
    path = write_log(tmp_path / "log.mat", skin=False)
    with pytest.raises(InputError) as refusal:
        open_log(path, **({"skin": "joints_state::positions"} | options))
    assert words in str(refusal.value)


def test_other_and_damaged_files_give_a_sentence(tmp_path, rng):
    old = tmp_path / "old.mat"
    old.write_bytes(b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(200, b"\0"))
    read = next(each for each in RECORDING_IMPORTERS if each.name == "robometry").guess_streams
    with pytest.raises(InputError, match=r"version 5; expected version 7.*skincal import arrays"):
        read(old)
    empty = MatFile(tmp_path / "empty.mat").close()
    with pytest.raises(InputError, match="no channel with data and timestamps"):
        read(empty)
    for name, shape, words in (
        ("rows", (10**11, 6), "announces 100000000000 rows of 6 values; expected at most"),
        ("width", (10, 2**40), "announces 10 rows of 1099511627776 values; expected at most"),
    ):
        huge = MatFile(tmp_path / f"{name}.mat")
        group = huge.root.create_group("FTs::l_arm")
        for field, size in (("data", shape), ("timestamps", shape[:1])):
            group.create_dataset(field, size, "f8", chunks=tuple(min(n, 1000) for n in size))
        with pytest.raises(InputError, match=words):
            readings(open_log(huge.close(), "FTs::l_arm", "FTs::l_arm", "FTs::l_arm"))
    whole = write_log(tmp_path / "log.mat").read_bytes()
    damaged, expected = tmp_path / "damaged.mat", 0
    for at in [*rng.integers(0, len(whole), 12).tolist(), *range(512, 1100, 29)]:
        for data in (whole[:at], whole[:at] + bytes(8) + whole[at + 8 :]):
            damaged.write_bytes(data)
            try:
                readings(open_log(damaged))
            except InputError:
                expected += 1
    assert expected > 20
