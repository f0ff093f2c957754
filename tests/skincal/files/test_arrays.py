"""Named arrays, written by the libraries that labs use, become positions within 0.1 mm of the truth, or a sentence."""

import json
import pickle
import re
import sys
import zipfile

import h5py
import numpy as np
import openpyxl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from skincal.cli import main
from skincal.files.importers.preview import guess_streams, open_places, preview_recording
from skincal.files.importers.registry import RecordedPlace, importer_of
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from tests.skincal.files.table_support import AXES, CHANNELS, POKES, START_S, poked_rows, positions_of

R = poked_rows()
N = len(R.times)
FRAMES = R.skin.reshape(-1, 4, 4)
MAX_ERROR_MM = 0.1
WRENCH_COLUMNS = dict(zip(AXES, R.wrench.T, strict=True))
GRID_COLUMNS = {f"r{k // 4}c{k % 4}": R.skin[:, k] for k in range(CHANNELS)}


def read(path, **topics):
    """Read a file by its proposals, or by the names of some streams."""
    found = guess_streams([path], CHANNELS)
    places = {stream: place for stream, place in found.places.items() if stream is not Stream.JOINTS}
    places |= {Stream(name): RecordedPlace(path, topic) for name, topic in topics.items()}
    for stream in (Stream.WRENCH, Stream.SKIN):
        if stream not in places:
            found.check_tied(stream)
    return open_places(places, channels=CHANNELS)


def assert_right(opened, *sentences):
    """The positions are right, nothing was lost, and each sentence is among the findings."""
    done = positions_of(opened)
    assert (done.accepted, set(map(str, done.losses.values()))) == (POKES, {"{}"})
    assert np.nanmax(done.errors_mm) < MAX_ERROR_MM
    assert not np.isnan(done.errors_mm).any()
    for sentence in sentences:
        assert any(sentence in finding for finding in done.findings), (sentence, done.findings)


def refusal(path, **topics):
    with pytest.raises(InputError) as refused:
        read(path, **topics)
    return str(refused.value)


def npz(path, **arrays):
    np.savez(path, **arrays)
    return path


# ------------------------------------------------------------------ numpy


def test_an_archive_of_numpy(tmp_path):
    path = npz(tmp_path / "log.npz", t=R.times, wrench=R.wrench, tactile=FRAMES, camera=np.zeros((N, 24, 32, 3), "u1"))
    opened = read(path)
    assert_right(
        opened,
        "wrench: read as fx fy fz mx my mz, in N and N m, as the file states no unit (else: wrench:N,Nmm); no frame",
        "time t names no unit and was read as seconds; else name it with its unit: --time t:ms, or ?time=t:ms after the array.",
        "frames of 4 x 4 are counted along the rows: channel 0 is [0, 0], channel 1 is [0, 1]; the other way is tactile?order=",
    )
    assert opened.frame_shape == (4, 4)


def test_transposed_arrays_are_found_by_the_length_of_their_time(tmp_path):
    path = npz(tmp_path / "log.npz", time_ms=R.times * 1e3, ft=R.wrench.T, skin=np.moveaxis(FRAMES, 0, -1).astype("u2"))
    assert_right(
        read(path),
        f"ft [6, {N}]: its axis 2 is time, as the time time_ms is as long.",
        f"skin [4, 4, {N}]: its axis 3 is time",
        "time time_ms: read as ms.",
    )


def test_one_matrix_for_everything_is_read_by_its_columns(tmp_path):
    path = npz(tmp_path / "log.npz", data=np.column_stack([R.times, R.wrench, R.skin]))
    topics = {"wrench": "data[1:7]?time=data[0]:s", "skin": "data[7:23]?time=data[0]:s"}
    assert_right(read(path, **topics), "channel 0 is the first value of a row")
    assert "a row of data has 23 values; data[7:24] is none of them" in refusal(
        path, wrench=topics["wrench"], skin="data[7:24]?time=50"
    )


def test_frames_that_are_counted_down_the_columns_follow_the_advice(tmp_path):
    turned = FRAMES.transpose(0, 2, 1)
    path = npz(tmp_path / "log.npz", t_s=R.times, wrench=R.wrench, tactile=turned)
    done = positions_of(read(path))
    assert np.nanmax(done.errors_mm) > 5
    advice = re.search(r"the other way is (\S+)\.", " ".join(done.findings))[1]
    assert_right(read(path, skin=advice), "counted down the columns: channel 0 is [0, 0], channel 1 is [1, 0]")


def test_units_that_the_file_lacks_are_stated_as_the_sentence_advises(tmp_path):
    wrench = R.wrench * [1, 1, 1, 1e3, 1e3, 1e3]
    path = npz(tmp_path / "log.npz", t=R.times * 1e3, wrench=wrench, skin=R.skin)
    said = refusal(path)
    assert "its rows lie 40 s apart, since its time names no unit" in said
    assert "state the unit: --time NAME:ms" in said
    assert_right(read(path, wrench="wrench:N,Nmm?time=t:ms", skin="skin?time=t:ms"))
    stamps = npz(tmp_path / "ns.npz", timestamps=((START_S + R.times) * 1e9).astype("i8"), wrench=R.wrench, skin=R.skin)
    assert_right(read(stamps), "time timestamps: read as nanoseconds since 1970, as its values are.")


def test_a_rate_takes_the_place_of_times(tmp_path):
    path = npz(tmp_path / "log.npz", wrench=R.wrench, skin=R.skin)
    assert f"no time of wrench [{len(R.times)}, 6] was found; no array is named as a time" in refusal(path)
    opened = read(path, wrench="wrench?time=25", skin="skin?time=25")
    assert_right(opened, "no times: counted at 25 rows a second, as named, from 0 s on.")


def test_force_and_torque_are_put_together_and_patches_side_by_side(tmp_path):
    names = {"force": R.wrench[:, :3], "torque": R.wrench[:, 3:], "left": R.skin[:, :10], "right": R.skin[:, 10:]}
    path = npz(tmp_path / "log.npz", t_s=R.times, **names)
    assert guess_streams([path], CHANNELS).wrench.topic == "force+torque"
    assert_right(read(path, skin="left+right"))
    assert_right(read(path, wrench="torque+force", skin="left+right"), "force is the force, torque the moment")


def test_two_candidates_are_asked_for(tmp_path):
    two = npz(tmp_path / "two.npz", t=R.times, wrench=R.wrench, tactile_left=R.skin, tactile_right=R.skin * 0)
    assert "The skin may be tactile_left or tactile_right; name the one that is meant." in refusal(two)
    assert_right(read(two, skin="tactile_left"))
    times = npz(tmp_path / "times.npz", t=R.times, stamp=R.times + 5, wrench=R.wrench, tactile=R.skin)
    assert "the time of wrench may be t or stamp; name it: --time t" in refusal(times)
    assert_right(read(times, wrench="wrench?time=t", skin="tactile?time=t"))
    own = npz(tmp_path / "own.npz", t_wrench=R.times, t_tactile=R.times, wrench=R.wrench, tactile=R.skin)
    assert_right(read(own), "wrench: time t_wrench names no unit", "skin: time t_tactile names no unit")


def test_lengths_that_differ_empty_arrays_and_axes_as_long_as_another_are_refused(tmp_path):
    short = npz(tmp_path / "a.npz", t=R.times[:-1], wrench=R.wrench, tactile=R.skin)
    assert f"the lengths differ: t has {N - 1}" in refusal(short)
    assert f"wrench [{N}, 6] and the time t ({N - 1} rows) differ in length" in refusal(
        short, wrench="wrench?time=t", skin="tactile?time=t"
    )
    empty = npz(tmp_path / "b.npz", t=R.times, wrench=R.wrench, tactile=np.empty((0, 16)))
    assert "tactile [0, 16] is empty" in refusal(empty, wrench="wrench", skin="tactile")
    square = npz(tmp_path / "c.npz", t=R.times[:50], wrench=R.wrench[:50], tactile=np.zeros((50, 50)))
    assert "has 50 along 2 axes" in refusal(square, wrench="wrench", skin="tactile")


def test_rows_without_values_or_times_are_counted(tmp_path):
    wrench, skin, times = np.repeat(R.wrench, 2, axis=0), np.repeat(R.skin, 2, axis=0), np.repeat(R.times, 2)
    wrench[1::2], skin[::2] = np.nan, np.nan
    times = np.append(times + np.tile([0, 1e-4], N), np.nan)
    wrench, skin = np.vstack([wrench, wrench[:1]]), np.vstack([skin, skin[:1]])
    path = npz(tmp_path / "log.npz", t=times, wrench=wrench, tactile=skin)
    assert_right(read(path), f"{N} rows without its values: not counted as lost.", "wrench: 1 row without a time: left out.")


def test_pictures_of_a_camera_are_no_taxels(tmp_path):
    path = npz(tmp_path / "log.npz", t=R.times[:60], wrench=R.wrench[:60], tactile=np.zeros((60, 24, 32, 3), "u1"))
    assert guess_streams([path], CHANNELS).skin is None
    said = refusal(path, wrench="wrench", skin="tactile")
    assert "tactile [60, 24, 32, 3] holds colour images of a camera: pixels are no taxels." in said


def test_pickle_is_refused_with_its_reason_and_never_read(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (tmp_path.joinpath("ran").touch, ())

    with (tmp_path / "log.pkl").open("wb") as file:
        pickle.dump(Bomb(), file)
    assert "is pickle, which runs the code in it while it is read" in refusal(tmp_path / "log.pkl")
    objects = np.array([Bomb()] * N, object)
    path = npz(tmp_path / "log.npz", t=R.times, wrench=R.wrench, skin=objects)
    assert "skin holds Python objects, which are pickle and run code while they are read" in refusal(
        path, wrench="wrench", skin="skin"
    )
    assert not (tmp_path / "ran").exists()


def test_a_folder_of_single_arrays_and_a_record_array(tmp_path):
    for name, values in {"t": R.times, "wrench": R.wrench, "tactile": FRAMES}.items():
        np.save(tmp_path / f"{name}.npy", values)
    assert_right(read(tmp_path))
    assert read(tmp_path / "wrench.npy").frame_shape == (4, 4)
    rows = np.empty(N, [("t_s", "f8"), ("ft", "f8", 6), ("skin", "f4", (4, 4))])
    rows["t_s"], rows["ft"], rows["skin"] = R.times, R.wrench, FRAMES
    inner = tmp_path / "inner"
    inner.mkdir()
    np.save(inner / "log.npy", rows)
    assert_right(read(inner))


# ------------------------------------------------------------------ HDF5 and MATLAB


def test_hdf5_with_groups_units_and_frames(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["ft/wrench"], file["ft/timestamps"] = R.wrench[:, [3, 4, 5, 0, 1, 2]], R.times * 1e3
        file["ft/timestamps"].attrs["units"] = "ms"
        file["ft/wrench"].attrs["names"] = ["mx", "my", "mz", "fx", "fy", "fz"]
        file["ft/wrench"].attrs["frame_id"] = "sensor"
        file["tactile/frames"], file["tactile/timestamps"] = FRAMES, R.times * 1e3
        file["tactile/timestamps"].attrs["units"] = "ms"
    assert_right(read(path), "its values are mx, my, mz, fx, fy, fz", "frame sensor.", "time ft/timestamps: read as ms.")


def test_hdf5_states_a_rate(tmp_path):
    with h5py.File(tmp_path / "log.hdf5", "w") as file:
        file["wrench"], file["tactile"] = R.wrench, R.skin
        file.attrs["sampling_rate"] = 25.0
    assert_right(read(tmp_path / "log.hdf5"), "counted at 25 rows a second, as the file states")


def matlab_7_3(path, **variables):
    """A file of MATLAB 7.3: axes in reverse order, structs as groups, cells as references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            if isinstance(values, list):
                cells = np.empty((1, len(values)), h5py.ref_dtype)
                for column, value in enumerate(values):
                    cell = file.require_group("#refs#").create_dataset(f"c{column}", data=np.asarray(value, float).T)
                    cell.attrs["MATLAB_class"] = np.bytes_("double")
                    cells[0, column] = cell.ref
                data = file.create_dataset(name, data=cells, dtype=h5py.ref_dtype)
                data.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                data = file.create_dataset(name.replace(".", "/"), data=np.atleast_2d(values).T)
                data.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("frames", ["last", "cells", "struct"])
def test_matlab_7_3(tmp_path, frames):
    skin = {
        "last": {"tactile": np.moveaxis(FRAMES, 0, -1)}, "cells": {"tactile": list(FRAMES)}, "struct": {"log.tactile": R.skin}
    }[frames]  # fmt: skip
    time = "log.t_s" if frames == "struct" else "t_s"
    path = matlab_7_3(tmp_path / "log.mat", **{time: R.times, "wrench": R.wrench, **skin})
    assert importer_of(path).name == "arrays"
    words = "channel 0 is the first value" if frames == "struct" else "channel 0 is [1, 1], channel 1 is [1, 2]"
    assert_right(read(path), words)


@pytest.mark.parametrize("frames", ["last", "cells", "struct"])
def test_matlab_5(tmp_path, frames):
    cells = np.empty((N, 1), object)
    for row, frame in enumerate(FRAMES):
        cells[row, 0] = frame
    log = {
        "last": {"t": R.times, "wrench": R.wrench, "tactile": np.moveaxis(FRAMES, 0, -1)},
        "cells": {"t": R.times, "wrench": R.wrench.T, "tactile": cells},
        "struct": {"log": {"time": R.times[:, None], "ft": {"wrench": R.wrench}, "skin": R.skin}},
    }[frames]
    scipy.io.savemat(tmp_path / "log.mat", log, do_compression=frames == "last")
    assert importer_of(tmp_path / "log.mat").name == "arrays"
    assert_right(read(tmp_path / "log.mat"))


# ------------------------------------------------------------------ pandas


@pytest.mark.parametrize("writer", ["parquet", "hdf", "excel", "csv"])
def test_tables_of_pandas_with_names_of_row_and_column(tmp_path, writer):
    table = pd.DataFrame({"t_s": R.times, **WRENCH_COLUMNS, "room_temperature": 21.5, **GRID_COLUMNS})
    path = tmp_path / {"parquet": "log.parquet", "hdf": "log.h5", "excel": "log.xlsx", "csv": "log.csv"}[writer]
    if writer == "hdf":
        table.to_hdf(path, key="log", format="fixed")
    else:
        getattr(table, f"to_{writer}")(path, index=False)
    assert_right(read(path), "channel 0 is r0c0, channel 15 is r3c3.")


def test_levels_of_pandas_and_dates_as_index(tmp_path):
    columns = {("ft", name): values for name, values in WRENCH_COLUMNS.items()}
    columns |= {("skin", str(k)): R.skin[:, k] for k in range(CHANNELS)}
    index = pd.to_datetime(R.times, unit="s", origin=pd.Timestamp("2024-05-01"))
    pd.DataFrame(columns, index=index).to_parquet(tmp_path / "log.parquet")
    assert_right(read(tmp_path / "log.parquet"), "read as dates in UTC", "columns skin/0 to skin/15.")


def test_equal_names_that_pandas_numbers_from_the_second_on(tmp_path):
    names = ["t_s", *AXES, "skin", *(f"skin.{k}" for k in range(1, CHANNELS))]
    values = np.column_stack([R.times, R.wrench, R.skin])
    pd.DataFrame(values, columns=names).to_csv(tmp_path / "log.csv", index=False)
    assert_right(read(tmp_path / "log.csv"))


def test_a_table_of_pandas_whose_names_are_pickle_says_how_to_write_it(tmp_path):
    table = pd.DataFrame({"t_s": R.times, **WRENCH_COLUMNS, **GRID_COLUMNS})
    table.to_hdf(tmp_path / "log.h5", key="log", format="table")
    said = refusal(tmp_path / "log.h5")
    assert (
        'names are pickle, which runs code while it is read: write it again with to_hdf(..., format="fixed"), to_parquet'
        in said
    )


def test_a_workbook_with_a_sheet_each_and_facts_above_the_names(tmp_path):
    book = openpyxl.Workbook()
    book.active.title = "Notes"
    book.active.append(["Monday", "arm 2"])
    for title, names, values in (("FT", AXES, R.wrench), ("Skin", [f"t{k}" for k in range(CHANNELS)], R.skin)):
        sheet = book.create_sheet(title)
        sheet.append([title, "recorded by hand"])
        sheet.append(["time (ms)", *names])
        for time, row in zip((R.times * 1e3).tolist(), values.tolist(), strict=True):
            sheet.append([time, *row])
    book.save(tmp_path / "log.xlsx")
    found = guess_streams([tmp_path / "log.xlsx"], CHANNELS)
    assert (found.wrench.topic, found.skin.topic) == ("FT!", "Skin!")
    assert_right(read(tmp_path / "log.xlsx"))
    assert "has no sheet gone; it has Notes, FT, Skin." in refusal(tmp_path / "log.xlsx", wrench="gone!")


# ------------------------------------------------------------------ LeRobot


def lerobot(folder, episodes=1, version="v3.0"):
    """A data set as LeRobot's documentation describes it: version 3 keeps episodes in one file, version 2 one in each."""
    parts = np.array_split(np.arange(N), episodes)
    number = np.concatenate([np.full(len(rows), k) for k, rows in enumerate(parts)])
    times = np.concatenate([R.times[rows] - R.times[rows[0]] for rows in parts]).astype("f4")

    def fixed(values):
        return pa.FixedSizeListArray.from_arrays(pa.array(values.astype("f4").ravel()), values.shape[1])

    table = pa.table(
        {
            "observation.wrench": fixed(R.wrench), "observation.tactile": pa.array(FRAMES.astype("f4").tolist()),
            "observation.state": fixed(np.zeros((N, 7))), "action": fixed(np.zeros((N, 6))), "timestamp": pa.array(times),
            "frame_index": pa.array(np.arange(N)), "episode_index": pa.array(number), "index": pa.array(np.arange(N)),
            "task_index": pa.array(np.zeros(N, int)),
        }
    )  # fmt: skip
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    (folder / "meta").mkdir()
    if version == "v3.0":
        pq.write_table(table, data / "file-000.parquet")
    else:
        for k, rows in enumerate(parts):
            pq.write_table(table.slice(rows[0], len(rows)), data / f"episode_{k:06d}.parquet")
    features = {
        "observation.wrench": {"dtype": "float32", "shape": [6], "names": list(AXES)},
        "observation.tactile": {"dtype": "float32", "shape": [4, 4], "names": ["row", "column"]},
        "observation.images.finger": {"dtype": "video", "shape": [240, 320, 3], "names": ["height", "width", "channels"]},
    }
    (folder / "meta" / "info.json").write_text(json.dumps({"codebase_version": version, "fps": 25, "features": features}))
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_data_set_of_lerobot(tmp_path, version):
    folder = lerobot(tmp_path / "set", version=version)
    assert importer_of(folder).name == "arrays"
    assert_right(read(folder), "its values are fx, fy, fz, mx, my, mz", "time timestamp: read as s.")
    assert_right(read(next(folder.glob("data/*/*.parquet"))))
    said = refusal(folder, wrench="observation.wrench", skin="observation.images.finger")
    assert "observation.images.finger holds images of a camera: pixels are no taxels" in said


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_follow_one_another_or_one_is_chosen(tmp_path, version):
    folder = lerobot(tmp_path / "set", episodes=2, version=version)
    opened = read(folder)
    assert any("2 episodes are placed one after another with 5 s between them; --episode N" in each for each in opened.findings)
    assert positions_of(opened).accepted in (POKES - 1, POKES)
    one = read(folder, wrench="observation.wrench?episode=1", skin="observation.tactile?episode=1")
    assert one.timelines[0].lines == N // 2
    assert "has no episode 7; it has 2 episodes, 0 to 1." in refusal(folder, wrench="observation.wrench?episode=7")


# ------------------------------------------------------------------ text


@pytest.mark.parametrize("title", ["Frame {k}, t = {t:.3f} s", "Frame {k} @ {t:.3f}", "time: {ms:.0f} ms", "{t:.3f}"])
def test_one_matrix_a_frame_as_text_with_a_table_of_the_wrench(tmp_path, title):
    blocks = []
    for k, (time, frame) in enumerate(zip(R.times, FRAMES, strict=True)):
        rows = "\n".join(",".join(f"{value:.0f}" for value in row) for row in frame)
        blocks.append(f"{title.format(k=k, t=time, ms=time * 1e3)}\n{rows}\n")
    (tmp_path / "mat.txt").write_text("\n".join(blocks))
    pd.DataFrame({"t_s": R.times, **WRENCH_COLUMNS}).to_csv(tmp_path / "ft.csv", index=False)
    assert importer_of(tmp_path / "mat.txt").name == "arrays"
    found = guess_streams([tmp_path / "mat.txt", tmp_path / "ft.csv"], CHANNELS)
    assert (found.wrench.path.name, found.skin.topic) == ("ft.csv", "frames")
    opened = open_places(found.places, channels=CHANNELS)
    assert_right(opened, "The files are of two kinds (CSV tables and Named arrays): their clocks must agree")
    assert opened.frame_shape == (4, 4)


def test_frames_of_a_mat_with_a_rate_in_the_head_a_cut_last_one_and_places_without_a_cell(tmp_path):
    text = "DATA_TYPE MOVIE\nSECONDS_PER_FRAME 0.04\n\n" + "\n\n".join(
        f"Frame {k + 1}\n" + "\n".join(",".join("B" if value == 0 else f"{value:.0f}" for value in row) for row in frame)
        for k, frame in enumerate(FRAMES)
    )
    (tmp_path / "mat.asf").write_text(text.rpartition("\n")[0])
    np.savez(tmp_path / "ft.npz", t_s=R.times, wrench=R.wrench)
    places = {
        Stream.WRENCH: RecordedPlace(tmp_path / "ft.npz", "wrench"), Stream.SKIN: RecordedPlace(tmp_path / "mat.asf", "frames")
    }  # fmt: skip
    opened = open_places(places, channels=CHANNELS)
    assert_right(opened, "the last frame has 3 rows of 4, as the recording was cut off", "25 rows a second, as the file states")
    (tmp_path / "uneven.txt").write_text("1 2\n3 4\n\n1 2\n3 4\n\n1 2 3\n4 5 6\n")
    with pytest.raises(InputError, match="frame 3 has 2 x 3 values, and the first one 2 x 2"):
        open_places({**places, Stream.SKIN: RecordedPlace(tmp_path / "uneven.txt", "frames?time=50")}, channels=CHANNELS)


# ------------------------------------------------------------------ errors


@pytest.mark.parametrize("suffix", ["npz", "h5", "parquet", "xlsx", "mat"])
def test_cut_files_give_a_sentence(tmp_path, suffix):
    path = tmp_path / f"log.{suffix}"
    table = pd.DataFrame({"t_s": R.times, **WRENCH_COLUMNS, **GRID_COLUMNS})
    match suffix:
        case "npz":
            np.savez_compressed(path, t=R.times, wrench=R.wrench, tactile=R.skin)
        case "h5":
            table.to_hdf(path, key="log", format="fixed")
        case "mat":
            scipy.io.savemat(path, {"t": R.times, "wrench": R.wrench, "tactile": R.skin})
        case _:
            getattr(table, {"parquet": "to_parquet", "xlsx": "to_excel"}[suffix])(path)
    whole = path.read_bytes()
    for size in (0, 10, len(whole) // 3, len(whole) - 40):
        path.write_bytes(whole[:size])
        said = refusal(path, wrench="wrench", skin="tactile")
        assert any(word in said for word in ("cut off", "empty", "damaged", "no text")), (size, said)


def test_encrypted_files_give_a_sentence(tmp_path):
    (tmp_path / "log.parquet").write_bytes(b"PARE" + bytes(100) + b"PARE")
    assert "is encrypted" in refusal(tmp_path / "log.parquet")
    (tmp_path / "log.xlsx").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600))
    assert "is encrypted, or of Excel before 2007; save it as .xlsx without a password" in _open_refusal(tmp_path / "log.xlsx")
    path = npz(tmp_path / "log.npz", t=R.times, wrench=R.wrench, tactile=R.skin)
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        start = archive.start_dir
    data[start + 8] |= 1
    path.write_bytes(data)
    assert "is encrypted; write it again without a password" in refusal(path)


def _open_refusal(path):
    with pytest.raises(InputError) as refused:
        open_places({Stream.WRENCH: RecordedPlace(path), Stream.SKIN: RecordedPlace(path)}, channels=CHANNELS)
    return str(refused.value)


@pytest.mark.parametrize(
    ("package", "suffix", "extra"), [("h5py", "h5", "hdf5"), ("pyarrow", "parquet", "parquet"), ("openpyxl", "xlsx", "excel")]
)
def test_a_missing_package_is_asked_for_by_one_sentence(tmp_path, monkeypatch, package, suffix, extra):
    path = tmp_path / f"log.{suffix}"
    table = pd.DataFrame({"t_s": R.times[:100], **{name: values[:100] for name, values in WRENCH_COLUMNS.items()}})
    if suffix == "h5":
        table.to_hdf(path, key="log")
    else:
        getattr(table, {"parquet": "to_parquet", "xlsx": "to_excel"}[suffix])(path)
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.setitem(sys.modules, name, None)
    said = _open_refusal(path)
    assert (
        f"read by the package {package}, which is not installed; install it: python -m pip install 'skincal[{extra}]'" in said
    )


def test_angles_without_a_unit_are_asked_for(tmp_path):
    angles = np.tile([0.1, 0.2, 0.3], (N, 1))
    path = npz(tmp_path / "log.npz", t=R.times, wrench=R.wrench, tactile=R.skin, joint_positions=angles)
    places = guess_streams([path], CHANNELS).places
    assert places[Stream.JOINTS].topic == "joint_positions"
    with pytest.raises(
        InputError, match="does not state the unit of the angles joint_positions; state it: joint_positions:rad"
    ):
        open_places(places, channels=CHANNELS)
    for unit in ("rad", "deg"):
        opened = open_places({**places, Stream.JOINTS: RecordedPlace(path, f"joint_positions:{unit}")}, channels=CHANNELS)
        record = next(iter(opened.sources[2]()))[0]
        first = np.frombuffer(record[-24:], "<f8")
        np.testing.assert_allclose(first, [0.1, 0.2, 0.3] if unit == "deg" else np.degrees([0.1, 0.2, 0.3]))


# ------------------------------------------------------------------ command and preview


def test_the_command_imports_arrays_and_says_what_the_file_does_not(tmp_path, capsys):
    rest = np.zeros((N, 384 - CHANNELS))
    path = npz(tmp_path / "log.npz", clock=R.times * 1e3, ft=R.wrench, tactile=np.column_stack([R.skin, rest]))
    common = ["import", "arrays", str(path), "--scene", "icub-forearm", "--pose", "1", "--out"]
    assert main([*common, str(tmp_path / "session"), "--time", "clock:ms", "--json"]) == 0
    said = capsys.readouterr().out
    assert json.loads(said)["pokes"] == POKES
    assert "as the file states no unit" in said
    assert main([*common, str(tmp_path / "other"), "--skin", "gone", "--time", "clock:ms"]) == 2
    assert f"has no array gone for the skin; it has clock [{N}], ft [{N}, 6], tactile [{N}, 384]." in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_a_preview_has_the_mean_frame(tmp_path):
    path = npz(tmp_path / "log.npz", t=R.times, wrench=R.wrench, tactile=FRAMES[:, :, ::-1])
    preview = preview_recording(guess_streams([path], CHANNELS))
    np.testing.assert_allclose(preview.frame, R.skin.mean(axis=0).reshape(4, 4)[:, ::-1], rtol=1e-6)
    flat = npz(tmp_path / "flat.npz", t=R.times, wrench=R.wrench, tactile=R.skin)
    assert preview_recording(guess_streams([flat], CHANNELS)).frame.shape == (1, CHANNELS)
