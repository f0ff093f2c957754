import re
from itertools import chain

import numpy as np
import pytest

from skincal.cli import main
from skincal.files.importers.csv_log import open_recording
from skincal.files.importers.registry import RecordedPlace
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream
from skincal.model.skin_axes import ValueOrder
from skincal.streams.decoders.auto_detect import make_decoder
from tests.approved import approved, approved_pattern
from tests.skincal.import_support import read_recording

TIMES = [0.5, 0.51, 0.52, 0.53]
WRENCH = np.array([[0.1 * k, -2.0, 3.5e-7, 0.25, 0.5, k] for k in range(4)])
SKIN = np.array([[200 + k, 3.0, 7.5] for k in range(4)])


def table(header, rows, separator=","):
    lines = [separator.join(header)] if header else []
    return "\n".join(lines + [separator.join(map(repr, row)) for row in np.asarray(rows).tolist()]) + "\n"


def with_time(values, factor=1.0):
    return np.column_stack([np.array(TIMES) * factor, values])


WRENCH_TEXT = table(["t_s", "fx", "fy", "fz", "mx", "my", "mz"], with_time(WRENCH))
SKIN_TEXT = table(["t_s", "t0", "t1", "t2"], with_time(SKIN))


@pytest.fixture
def read(tmp_path):
    def read(wrench=WRENCH_TEXT, skin=SKIN_TEXT, joints=None):
        paths = []
        for name, content in (("w.csv", wrench), ("s.csv", skin), ("j.csv", joints)):
            path = tmp_path / name
            if content is not None:
                path.write_text(content, encoding="utf-8")
            paths.append(path)
        links, chunks, findings = read_recording("csv", paths[0], paths[1], None if joints is None else paths[2])
        decoders = {link.name: make_decoder(link.format, SKIN.shape[1], link.carries) for link in links}
        batches = {link.name: [] for link in links}
        times = []
        for chunk in chunks:
            batches[chunk.link] += decoders[chunk.link].feed(chunk.data)
            times.append(chunk.host_ns)
        assert times == sorted(times)
        return batches, {name: decoder.counts for name, decoder in decoders.items()}, findings

    return read


def wrench_of(batches):
    return np.vstack([batch.values for batch in batches["wrench"]])


def skin_of(batches):
    return np.vstack([batch.values for batch in batches["skin"]])


def test_what_was_written_is_decoded_bit_for_bit(read):
    batches, counts, findings = read()
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)
    np.testing.assert_array_equal(skin_of(batches), SKIN)
    np.testing.assert_allclose(np.concatenate([batch.device_s for batch in batches["wrench"]]), TIMES, atol=1e-9)
    assert not any(counts.values())
    assert findings == (
        approved("csv_log.rate", link="wrench", lines=4, seconds=0.0, rate=100),
        approved("csv_log.rate", link="skin", lines=4, seconds=0.0, rate=100),
    )


@pytest.mark.parametrize(
    ("name", "factor"),
    [("t", 1), ("Time_ms", 1e3), ("timestamp [us]", 1e6), ("stamp_ns", 1e9), ("t(ms)", 1e3), ("TIME_S", 1)],
)
def test_the_times_unit_is_in_its_name(read, name, factor):
    header = [name, "Fx_N", "Fy_N", "Fz_N", "Tx_Nm", "Ty_Nm", "Tz_Nm"]
    batches, _, findings = read(wrench=table(header, with_time(WRENCH, factor)))
    np.testing.assert_allclose(np.concatenate([batch.device_s for batch in batches["wrench"]]), TIMES, atol=1e-9)
    assert any(approved("csv_log.read_as_seconds") in finding for finding in findings) == (name == "t")


@pytest.mark.parametrize("separator", [";", "\t", "  "])
def test_other_separators(read, separator):
    header = ["t_s", "fx", "fy", "fz", "mx", "my", "mz"]
    batches, _, _ = read(wrench=table(header, with_time(WRENCH), separator))
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)


def test_decimal_commas_quotes_comments_and_a_byte_order_mark(read):
    content = table(['"t_s"', "fx", "fy", "fz", "mx", "my", "mz"], with_time(WRENCH), ";").replace(".", ",")
    batches, counts, _ = read(wrench="\ufeff# from the lab\n" + content + "\n\n")
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)
    assert not counts["wrench"]


def test_a_header_in_a_comment_names_the_columns(read):
    """`numpy.savetxt` writes it so. Read by place, the joints' radians would be degrees."""
    batches, _, findings = read(joints="# t_s, shoulder_rad\n" + "".join(f"{time},0.5\n" for time in TIMES))
    np.testing.assert_allclose(np.vstack([batch.values for batch in batches["joints"]]), 0.5, rtol=1e-9)
    assert not any("no header" in finding for finding in findings)


def test_a_separator_within_quotes_belongs_to_its_field(read):
    rows = [f'"2024-05-01 12:00:00,{k}23",' + ",".join(f"{x!r}" for x in WRENCH[k].tolist()) for k in range(4)]
    text = '"datetime","fx","fy","fz","mx","my","mz"\n' + "\n".join(rows) + "\n"
    batches, counts, _ = read(wrench=text, skin=dated([f"2024-05-01 12:00:00.{k}23" for k in range(4)], "datetime")["skin"])
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)
    assert not counts["wrench"]


def test_columns_in_any_order_with_a_counter_and_moments_in_newton_millimetres(read):
    order = [6, 5, 4, 3, 2, 1, 0]
    header = ["t_s", "fx", "fy", "fz", "mx_nmm", "my_nmm", "mz_nmm"]
    values = with_time(WRENCH * [1, 1, 1, 1e3, 1e3, 1e3])[:, order]
    rows = np.column_stack([[5, 6, 7, 9], values])
    batches, counts, _ = read(wrench=table(["seq", *(header[i] for i in order)], rows))
    np.testing.assert_allclose(wrench_of(batches), WRENCH, rtol=1e-15)
    assert [seq for batch in batches["wrench"] for seq in batch.seq] == [5, 6, 7, 9]
    assert counts["wrench"] == {Loss.MISSING: 1}


def test_skin_columns_go_by_their_numbers_where_they_have_some(read):
    batches, _, _ = read(skin=table(["t_s", "taxel10", "taxel2", "taxel1"], with_time(SKIN)))
    np.testing.assert_array_equal(skin_of(batches), SKIN[:, ::-1])
    batches, _, _ = read(skin=table(["t_s", "thumb", "index finger", "palm"], with_time(SKIN)))
    np.testing.assert_array_equal(skin_of(batches), SKIN)


def test_joints_in_degrees_or_radians_become_radians(read):
    angles = np.array([[0.0, 94.0], [1.0, 45.0], [2.0, 30.0], [3.0, -90.0]])
    for header, values in ((["j0_deg", "j1_deg"], angles), (["j0_rad", "j1 [rad]"], np.radians(angles))):
        batches, _, _ = read(joints=table(["t_s", *header], with_time(values)))
        np.testing.assert_allclose(np.vstack([b.values for b in batches["joints"]]), np.radians(angles), rtol=1e-14)


def test_without_a_header_columns_go_by_their_place(read):
    batches, _, findings = read(wrench=table([], with_time(WRENCH)), skin=table([], with_time(SKIN)))
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)
    np.testing.assert_array_equal(skin_of(batches), SKIN)
    assert sum(approved("csv_log.first_read_as_seconds") in finding for finding in findings) == 2


def test_bad_rows_are_counted_not_lost_silently(read):
    rows = WRENCH_TEXT.splitlines()
    rows[2] = "0.51,1,2,3"
    rows[3] = "0.52,1,2,x y,4,5,6"
    rows[4] = "0.53,1,2,,4,5,6"
    rows += ["0.54,1,2,3,4,5,6,7", "later,1,2,3,4,5,6"]
    batches, counts, findings = read(wrench="\n".join(rows))
    assert counts["wrench"] == {Loss.BAD_WIDTH: 2, Loss.UNREADABLE: 1, Loss.NOT_A_NUMBER: 1}
    assert np.isfinite(wrench_of(batches)).all(axis=1).tolist() == [True, False]
    assert approved("csv_log.no_time_row", link="wrench", count=1) in findings


def test_an_empty_field_of_the_skin_is_a_dead_taxel(read):
    batches, counts, _ = read(skin=SKIN_TEXT.replace(",3.0,", ",,", 1))
    assert np.isnan(skin_of(batches)).tolist() == [[False, True, False]] + [[False] * 3] * 3
    assert counts["skin"] == {Loss.NOT_A_NUMBER: 1}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"wrench": ""}, approved("csv_log.empty")),
        ({"wrench": "t_s,fx,fy,fz,mx,my,mz\n"}, approved("csv_log.no_row")),
        ({"wrench": "fx,fy,fz,mx,my,mz\n1,2,3,4,5,6\n"}, approved("csv_log.no_time_column")),
        ({"wrench": "t_s,fx,fy,fz,mx\n1,2,3,4,5\n"}, approved("csv_log.columns_missing")),
        ({"wrench": "0.5,1,2,3\n"}, approved("csv_log.no_header", columns=4)),
        ({"skin": "t_s\n0.5\n"}, approved("csv_log.time_alone")),
        ({"joints": "t_s,j0\n0.5,94\n"}, approved("csv_log.column_without_unit", column="j0")),
        ({"skin": "t_s,t0,t1,t2\n900,1,2,3\n"}, approved("recording.other_time")),
    ],
)
def test_wrong_input_is_said(read, given, said):
    with pytest.raises(InputError, match=re.escape(said)):
        read(**given)


@pytest.mark.parametrize("header", [["time", "t0", "t1", "t2"], []])
def test_milliseconds_that_are_not_named_are_not_taken_for_seconds(read, header):
    with pytest.raises(InputError, match=approved_pattern("csv_log.not_seconds")):
        read(skin=table(header, with_time(SKIN, 1e3)))


def test_joints_may_come_slowly_and_seconds_that_are_named_are_believed(read):
    slow = [[0.5, 94.0], [1.5, 94.0]]
    batches, _, _ = read(
        joints=table(["t", "j0_deg"], slow), skin=table(["t_s", "t0", "t1", "t2"], with_time(SKIN, 1e3)[:2] - 499.5)
    )
    assert len(np.vstack([batch.values for batch in batches["joints"]])) == 2
    assert len(skin_of(batches)) == 2


def axes(form):
    """Names of the columns of a wrench, of this form."""
    return [form.format(kind, axis) for kind in ("force", "torque") for axis in "xyz"]


ROS = ["field.header.seq", "field.header.stamp", "field.header.frame_id"]


@pytest.mark.parametrize(
    ("time", "factor", "wrench", "skin"),
    [
        ("%time", 1e9, axes("field.wrench.{}.{}"), ["field.layout.data_offset", *(f"field.data{k}" for k in (0, 2, 10))]),
        ("__time", 1, axes("/ft/wrench/{}/{}"), ["/skin1/layout/data_offset", *(f"/skin1/data[{k}]" for k in (0, 2, 10))]),
        ("rosbagTimestamp", 1e9, axes("{}_{}"), ["layout.data_offset", "data_0", "data_2", "data_10"]),
        ("/ft/header/stamp", 1, axes("wrench_{}_{}"), ["layout.data_offset", "t0", "t2", "t10"]),
    ],
)
def test_columns_of_ros_bags_and_plotjuggler_are_understood(read, time, factor, wrench, skin):
    times, notes = (np.array(TIMES) + 1.7e9) * factor, [[k + 5, 1.0, 0.0] for k in range(4)]
    forces = table([time, *ROS, *wrench], np.column_stack([times, notes, WRENCH]))
    batches, counts, findings = read(
        wrench=forces, skin=table([time, *skin[:1], *reversed(skin[1:])], np.column_stack([times, [0] * 4, SKIN[:, ::-1]]))
    )
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)
    np.testing.assert_array_equal(skin_of(batches), SKIN)
    assert [seq for batch in batches["wrench"] for seq in batch.seq] == [5, 6, 7, 8]
    assert not any(counts.values())
    stamps = np.concatenate([batch.device_s for batch in batches["wrench"]])
    np.testing.assert_allclose(stamps, np.array(TIMES) + 1.7e9, atol=1e-6)
    said = approved("csv_log.read_as_nanoseconds", column=time.lower())
    assert any(said in finding for finding in findings) == (factor == 1e9)


def test_columns_of_two_sensors_are_not_mixed(read):
    names = axes("/left/{}/{}") + axes("/right/{}/{}")
    said = approved_pattern("csv_log.twice", first="/left/force/x", second="/right/force/x", axis="fx")
    with pytest.raises(InputError, match=said):
        read(wrench=table(["t_s", *names], with_time(np.hstack([WRENCH, WRENCH]))))


def test_a_time_that_is_text_is_shown(read):
    for seen in ("31.01.2026 10:00", "2026-01-31", "2026-01-31T10:00", "2026-02-30T10:00:00.5Z", "10:00"):
        with pytest.raises(InputError, match=approved_pattern("csv_log.text_time", seen=seen)):
            read(**dated([seen] * 4))


def dated(stamps, header="t"):
    """Texts of the two tables at these times, the first four of their rows."""
    both = ((["fx", "fy", "fz", "mx", "my", "mz"], WRENCH), (["t0", "t1", "t2"], SKIN))
    return {
        stream: "\n".join(
            [",".join([header, *names])] * bool(header)
            + [",".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, values.tolist(), strict=True)]
        )
        for stream, (names, values) in zip(("wrench", "skin"), both, strict=True)
    }


NOON = 1_714_564_800.0
"""2024-05-01, 12:00 UTC, seconds since 1970."""


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        ([f"2024-05-01T12:00:00.{k}23Z" for k in range(4)], [0.1 * k + 0.023 for k in range(4)]),
        ([f"2024-05-01 14:00:00.00{k}+02:00" for k in range(4)], [0.001 * k for k in range(4)]),
        ([f"2024-05-01t07:30:00.{k}-0430" for k in range(4)], [0.1 * k for k in range(4)]),
        # As pandas writes dates as text: a whole second has no fraction.
        (["2024-05-01 12:00:00", *(f"2024-05-01 12:00:00.0{k}0000" for k in (1, 2, 3))], [0.0, 0.01, 0.02, 0.03]),
        ([f"2024-05-01T12:00:00.00000{k}789z" for k in range(4)], [1e-6 * k + 0.789e-6 for k in range(4)]),
        ([f"2024-05-01T12:00:0{k}.999999999+00" for k in range(4)], [k + 0.999999999 for k in range(4)]),
    ],
)
@pytest.mark.parametrize("header", ["t", "datetime", ""])
def test_dates_are_times(read, stamps, seconds, header):
    batches, counts, findings = read(**dated(stamps, header))
    np.testing.assert_array_equal(wrench_of(batches), WRENCH)
    np.testing.assert_array_equal(skin_of(batches), SKIN)
    assert not any(counts.values())
    stamped = np.concatenate([batch.device_s for batch in batches["wrench"]])
    # Digits beyond a microsecond are dropped.
    np.testing.assert_allclose(stamped - NOON, seconds, rtol=0, atol=1.3e-6)
    without_zone = stamps[0].endswith("00:00")
    assert (approved("csv_log.dates_without_zone") in findings) == (without_zone and header == "t")
    assert (approved("csv_log.dates_first") in findings) == (without_zone and not header)


@pytest.mark.parametrize(
    ("before", "after"),
    [("2024-02-28T23:59:59", "2024-02-29T00:00:00"), ("2023-02-28T23:59:59", "2023-03-01T00:00:00"),
     ("2023-12-31T23:59:59", "2024-01-01T00:00:00")],
)  # fmt: skip
def test_a_recording_over_midnight_goes_on(read, before, after):
    batches, _, findings = read(**dated([f"{before}.98Z", f"{before}.99Z", f"{after}.00Z", f"{after}.01Z"]))
    stamps = np.concatenate([batch.device_s for batch in batches["wrench"]])
    np.testing.assert_allclose(np.diff(stamps), 0.01, atol=1e-6)
    assert not any("gap" in finding or "stamp" in finding for finding in findings)


def test_a_date_that_is_none_among_others_is_left_out_and_counted(read):
    stamps = ["2024-05-01T12:00:00.00Z", "2024-05-01T12:00:60.01Z", "NaT", "2024-05-01T12:00:00.03Z"]
    batches, _, findings = read(**dated(stamps))
    np.testing.assert_array_equal(wrench_of(batches), WRENCH[[0, 3]])
    assert sum("2 rows without a time" in finding for finding in findings) == 2


@pytest.mark.parametrize(
    ("first", "other"),
    [
        ("2024-05-01T12:00:00.5Z", "0.51"),
        ("0.51", "2024-05-01T12:00:00.5Z"),
        ("2024-05-01T12:00:00.5Z", "2024-05-01T12:00:00.6"),
    ],
)
def test_times_of_two_kinds_are_refused(read, first, other):
    with pytest.raises(InputError, match=approved_pattern("csv_log.dates_mixed", first=first, other=other)):
        read(**dated([first, first, other, first]))


def test_dates_of_whole_seconds_are_refused(read):
    with pytest.raises(InputError, match=approved_pattern("csv_log.dates_coarse")):
        read(**dated(["2024-05-01T12:00:00Z"] * 4))


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(InputError, match=approved_pattern("layout_file.no_such_file")):
        read_recording("csv", tmp_path / "none.csv", tmp_path / "none.csv")


def test_bytes_that_are_no_text_are_said_and_not_shown(read):
    with pytest.raises(InputError, match=approved_pattern("csv_log.no_text", file="w.csv")):
        read(wrench="\x07\x1b[31m,\x00\x01\n1,2\n")
    with pytest.raises(InputError, match=approved_pattern("csv_log.no_plausible_time")):
        read(wrench=table(["t", "fx", "fy", "fz", "mx", "my", "mz"], with_time(WRENCH, 1e20)))


TAXELS = range(1, 4)
BY_TAXEL = [(number, axis) for number in TAXELS for axis in "xyz"]
BY_AXIS = [(number, axis) for axis in "xyz" for number in TAXELS]
VECTORS = np.arange(36.0).reshape(4, 9)


def write_vectors(folder, names):
    """Write tables of a wrench and of a skin of three axes; return both."""
    (folder / "ft.csv").write_text(WRENCH_TEXT, encoding="utf-8")
    (folder / "skin.csv").write_text(table(["t_s", *names], with_time(VECTORS)), encoding="utf-8")
    return folder / "ft.csv", folder / "skin.csv"


@pytest.mark.parametrize(
    "form", ["S{0}_{1}", "S{0}_b{1}", "taxel_{0}.f{1}", "{1}{0}", "Force_{1}_{0}", "skin[{0}].{1} [N]", "t{0}{1}"]
)
@pytest.mark.parametrize("order", [BY_TAXEL, BY_AXIS])
@pytest.mark.parametrize("channels", [0, 9])
def test_columns_of_a_number_and_an_axis_are_taxels_of_three_axes(tmp_path, form, order, channels):
    places = zip((Stream.WRENCH, Stream.SKIN), write_vectors(tmp_path, [form.format(*each) for each in order]), strict=True)
    found = open_recording({stream: RecordedPlace(path) for stream, path in places}, channels)
    assert "skin: its columns are x, y and z of 3 taxels, 1 to 3." in found.findings
    assert found.value_order is (ValueOrder.BY_TAXEL if order is BY_TAXEL else ValueOrder.BY_AXIS)


OTHERS = [f"m{number}_{axis}" for number, axis in BY_TAXEL]  # Markers of a camera, or inertial sensors


@pytest.mark.parametrize("channels", [12, 0])
def test_a_skin_is_found_among_other_columns_of_a_number_and_an_axis(tmp_path, channels):
    names, rng = [*(f"t{number}" for number in range(12)), *OTHERS], np.random.default_rng(1)
    (tmp_path / "skin.csv").write_text(table(["t_s", *names], with_time(rng.normal(size=(4, len(names))))), encoding="utf-8")
    (tmp_path / "ft.csv").write_text(WRENCH_TEXT, encoding="utf-8")
    places = {Stream.WRENCH: RecordedPlace(tmp_path / "ft.csv"), Stream.SKIN: RecordedPlace(tmp_path / "skin.csv")}
    found = open_recording(places, channels)
    assert any("are not read; the taxels are t0 to t11." in finding for finding in found.findings)
    assert found.value_order is None


def test_as_many_columns_without_an_axis_as_with_one_are_asked_about(tmp_path):
    names = [*(f"t{number}" for number in range(9)), *OTHERS]
    (tmp_path / "skin.csv").write_text(table(["t_s", *names], with_time(np.tile(VECTORS, 2))), encoding="utf-8")
    (tmp_path / "ft.csv").write_text(WRENCH_TEXT, encoding="utf-8")
    wrench = RecordedPlace(tmp_path / "ft.csv")
    with pytest.raises(InputError, match=r"t0 to t8 and m1_x, m1_y, .* have 9 channels each, as the scene") as refusal:
        open_recording({Stream.WRENCH: wrench, Stream.SKIN: RecordedPlace(tmp_path / "skin.csv")}, 9)
    assert "skin.csv::t" in str(refusal.value)
    for begin, order in (("t", None), ("m", ValueOrder.BY_TAXEL)):
        found = open_recording({Stream.WRENCH: wrench, Stream.SKIN: RecordedPlace(tmp_path / "skin.csv", begin)}, 9)
        assert found.value_order is order


def import_vectors(folder, names, scene_skin):
    """Import both tables into a scene with this `[skin]`; return the exit code."""
    scene = folder / "scene.toml"
    scene.write_text(f'name = "pad"\nlink = "pad"\n[skin]\n{scene_skin}\n', encoding="utf-8")
    options = zip(("--wrench", "--skin"), map(str, write_vectors(folder, names)), strict=True)
    return main(["import", "csv", *chain(*options), "--scene", str(scene), "--out", str(folder / "s")])


@pytest.mark.parametrize(
    ("scene_skin", "words"),
    [
        ('channels = 3\naxes = 3\norder = "xxyyzz"', 'write order = "xyzxyz" into [skin] of scene.toml'),
        ("channels = 9", 'write axes = 3, channels = 3 and order = "xyzxyz" into [skin] of scene.toml'),
    ],
)
def test_names_of_three_axes_that_contradict_the_scene_are_refused(tmp_path, capsys, scene_skin, words):
    names = [f"s{number}_{axis}" for number, axis in BY_TAXEL]
    assert import_vectors(tmp_path, names, scene_skin) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


def test_names_of_three_axes_in_no_order_are_refused(tmp_path, capsys):
    names = [f"s{number}_{axis}" for number in TAXELS for axis in "zxy"]
    assert import_vectors(tmp_path, names, "channels = 3\naxes = 3") == 2
    assert "do not rise in the order of the file" in capsys.readouterr().err
