"""Tables as spreadsheets, makers, ROS and PlotJuggler write them, imported to positions; the truth is the simulated skin's."""

import re
from dataclasses import replace

import numpy as np
import pytest

from skincal.files.importers.preview import guess_streams
from skincal.files.importers.registry import RecordedPlace
from skincal.model.errors import InputError
from skincal.model.readings import Loss
from tests.skincal.files.table_support import (
    AXES,
    CHANNELS,
    POKES,
    START_S,
    TAXEL_NAMES,
    Table,
    fields,
    import_tables,
    poked_rows,
    skin_table,
    wrench_table,
)

ROWS = poked_rows()
RAW = poked_rows(700.0)
"""Raw values around 1000."""
MAX_ERROR_MM = 0.1


def german(table: Table, thousands: str = "") -> Table:
    """Decimal commas, and a mark between thousands."""

    def convert(text: str) -> str:
        whole, point, rest = text.partition(".")
        grouped = (
            f"{int(whole):,}".replace(",", thousands) if whole.lstrip("-").isdigit() and abs(int(whole)) >= 1000 else whole
        )
        return grouped + ("," if point else "") + rest

    return replace(table, separator=";", columns=[[convert(text) for text in column] for column in table.columns])


def milliseconds(table: Table) -> Table:
    return replace(
        table, names=("t_ms", *table.names[1:]), columns=[[f"{1000 * t:.0f}" for t in ROWS.times], *table.columns[1:]]
    )


def lists(form: str) -> Table:
    def write(values: list[float]) -> str:
        return form.format(", ".join(f"{value:.0f}" for value in values), " ".join(f"{value:.0f}." for value in values))

    return Table(("t_s", "taxels"), [ROWS.seconds(), [write(row) for row in ROWS.skin.tolist()]])


def one_table(names: tuple[str, ...] = ("t_s", *AXES, *TAXEL_NAMES), more: tuple[list[str], ...] = ()) -> Table:
    return Table(names, [ROWS.seconds(), *fields(ROWS.wrench, "{:.5f}"), *fields(ROWS.skin, "{:.0f}"), *more])


def plotjuggler(empty: str = "") -> Table:
    """A table of messages at different times: the fields of other topics are empty."""
    n = len(ROWS.times)
    wrench = [[text for value in column for text in (value, empty)] for column in fields(ROWS.wrench, "{:.5f}")]
    skin = [[text for value in column for text in (empty, value)] for column in fields(ROWS.skin, "{:.0f}")]
    times = [f"{START_S + t + 0.001 * k:.3f}" for t in ROWS.times for k in (0, 1)]
    names = [f"/ft/wrench/{kind}/{axis}" for kind in ("force", "torque") for axis in "xyz"]
    order = sorted(range(CHANNELS), key=str)
    return Table(
        ("__time", "/ft/header/seq", *names, *(f"/skin/data[{k}]" for k in order)),
        [times, [str(k // 2) if k % 2 == 0 else empty for k in range(2 * n)], *wrench, *(skin[k] for k in order)],
    )


COUNTS = "Counts per Unit Force: 1000000.0\nTorque Units: N-m\nCounts per Unit Torque: 1000000.0\n"
MAKER = f'Start Time: 5/1/24 9:40 AM\nRDT Sample Rate: 25\n"PLEASE NOTE: the rate, as it was read"\nForce Units: N\n{COUNTS}'


def maker_program(counts: bool = True) -> Table:
    """The demo program of a maker: facts first, then counts in quotes."""
    scale, form = (1e6, "{:.0f}") if counts else (1.0, "{:.5f}")
    columns = [["0"] * len(ROWS.times), *([str(k + first) for k in range(len(ROWS.times))] for first in (100, 7000))]
    columns += [*fields(ROWS.wrench * scale, form), ROWS.seconds()]
    names = ("Status (hex)", " RDT Sequence", " F/T Sequence", " Fx", " Fy", " Fz", " Tx", " Ty", " Tz", " Time")
    return Table(names, [[f'"{text}"' for text in column] for column in columns], before=MAKER, separator=",")


def dated(form: str, names: tuple[str, ...] = ("Date", "Time")) -> tuple[Table, Table]:
    def with_moments(table: Table) -> Table:
        moments = [moment.split("|") for moment in ROWS.moments(form)]
        columns = [list(column) for column in zip(*moments, strict=True)]
        return replace(table, names=(*names, *table.names[1:]), columns=[*columns, *table.columns[1:]])

    return with_moments(wrench_table(ROWS)), with_moments(skin_table(ROWS))


def echoed(values: Table, frame: str | None = "ft_link") -> Table:
    """`ros2 topic echo --csv`: seconds, nanoseconds, frame, values."""
    seconds = [str(START_S + int(t)) for t in ROWS.times]
    nanoseconds = [str(round(1e9 * (t % 1.0))) for t in ROWS.times]
    frames = [] if frame is None else [[frame] * len(seconds)]
    return replace(values, names=(), columns=[seconds, nanoseconds, *frames, *values.columns[1:]])


def axes(force: str, torque: str) -> list[str]:
    """Names of the columns of a wrench, by the form of each kind."""
    return [form.format(axis) for form in (force, torque) for axis in "XYZ"]


W, S = wrench_table(ROWS), skin_table(ROWS)
FORMS: dict[str, tuple[Table, Table]] = {
    "plain": (W, S),
    # Thousands separators, where the file proves them.
    "quoted thousands": (W, skin_table(RAW, columns=[RAW.seconds(), *fields(RAW.skin, "{:,.0f}")])),
    "quoted thousands, two groups": (
        W,
        milliseconds(skin_table(RAW, columns=[RAW.seconds(), *fields(RAW.skin * 1000, "{:,.0f}")])),
    ),
    "quoted thousands with decimals": (W, milliseconds(skin_table(RAW, columns=[RAW.seconds(), *fields(RAW.skin, "{:,.1f}")]))),
    "German thousands": (german(W), german(skin_table(RAW), ".")),
    "Swiss thousands": (german(W), german(skin_table(RAW), "\u2019")),
    "French thousands": (german(W), german(skin_table(RAW), "\u202f")),
    "thousands in tabs": (W, replace(skin_table(RAW, columns=[RAW.seconds(), *fields(RAW.skin, "{:,.0f}")]), separator="\t")),
    "volts of three decimals": (W, replace(skin_table(RAW), columns=[RAW.seconds(), *fields(RAW.skin / 4, "{:.3f}")])),
    "volts of three decimals in tabs": (
        W,
        replace(skin_table(RAW), columns=[RAW.seconds(), *fields(RAW.skin / 4, "{:.3f}")], separator="\t"),
    ),
    # Spreadsheets.
    "separator line": (replace(german(W), before="sep=;\n"), replace(S, before='"sep=,"\n')),
    "separator line of a tab": (replace(W, separator="\t", before="sep=\t\n"), S),
    "unit line": (
        replace(W, below_names="s,N,N,N,Nm,Nm,Nm\n"),
        replace(S, below_names="(s)," + ",".join(["(counts)"] * CHANNELS) + "\n"),
    ),
    "comma at the end": (replace(W, end=","), replace(S, end=",")),
    "comma at the end, names too": (replace(W, names=(*W.names, ""), end=","), replace(S, names=(*S.names, ""), end=",,")),
    "comma at the end, no names": (replace(W, names=(), end=","), replace(S, names=(), end=",")),
    "two encodings": (replace(W, encoding="utf-16"), replace(S, encoding="utf-8-sig")),
    "utf-16 without a mark": (replace(W, encoding="utf-16-le"), replace(S, encoding="utf-16-be")),
    "Windows": (
        replace(W, names=("t_s", *axes("F{} [N]", "M{} [N\u00b7m]")), encoding="cp1252"),
        S,
    ),
    "quotes around everything": (
        replace(W, columns=[[f'"{text}"' for text in column] for column in W.columns]),
        replace(S, names=tuple(f'"{name}"' for name in S.names)),
    ),
    # Names.
    "unit with space": (replace(W, names=("t_s", *axes("F{} [N]", "M{} [N m]"))), S),
    "unit with a hyphen": (replace(W, names=("Time (sec)", *axes("F{} (N)", "T{} (N-m)"))), S),
    "newton centimetres": (
        replace(
            W,
            names=("t_s", "fx", "fy", "fz", "mx [N cm]", "my [N cm]", "mz [N cm]"),
            columns=[*W.columns[:4], *fields(ROWS.wrench[:, 3:] * 100, "{:.4f}")],
        ),
        S,
    ),
    "pounds": (
        replace(
            W,
            names=("t_s", *axes("F{} (lbf)", "T{} (lbf-in)")),
            columns=[
                W.columns[0],
                *fields(ROWS.wrench[:, :3] / 4.4482216152605, "{:.7f}"),
                *fields(ROWS.wrench[:, 3:] / (4.4482216152605 * 0.0254), "{:.7f}"),
            ],
        ),
        S,
    ),
    "comma in names": (
        replace(W, names=("Time, s", *axes("Force, {} (N)", "Torque, {} (Nm)"))),
        S,
    ),
    "clock of a board": (
        replace(milliseconds(W), names=("millis", *AXES)), replace(milliseconds(S), names=("ms", *TAXEL_NAMES))
    ),
    "clock of a board, microseconds": (
        W,
        replace(S, names=("micros", *TAXEL_NAMES), columns=[[f"{1e6 * t:.0f}" for t in ROWS.times], *S.columns[1:]]),
    ),
    "counter first": (
        replace(W, names=("sample", *W.names), columns=[[str(k) for k in range(len(ROWS.times))], *W.columns]),
        replace(S, names=("no.", *S.names), columns=[[str(k) for k in range(len(ROWS.times))], *S.columns]),
    ),
    # Makers and ROS.
    "maker program": (maker_program(), S),
    "maker program, values in units": (maker_program(counts=False), S),
    "ros2 topic echo": (echoed(W), echoed(S, "patch")),
    "ros2 topic echo, no frame": (echoed(W, ""), echoed(S, None)),
    "seconds and nanoseconds by name": (
        replace(echoed(W, None), names=("header.stamp.sec", "header.stamp.nanosec", *AXES)),
        replace(echoed(S, None), names=("sec", "nsec", *TAXEL_NAMES)),
    ),
    "skin as a list": (W, lists("[{0}]")),
    "skin as a list of numpy": (W, lists("[{1}]")),
    "skin as an array": (W, lists("array([{0}], dtype=float32)")),
    "skin as a list over two lines": (W, replace(lists("[{0}]"), columns=[lists("[{0}]").columns[0], [
        text.replace(", ", ",\n ") for text in lists("[{0}]").columns[1]
    ]])),
    # Dates.
    "date and time": dated("%Y-%m-%d|%H:%M:%S.{ms}"),
    "German date and time": dated("%d.%m.%Y|%H:%M:%S,{ms}"),
    "English date and time": dated("%m/%d/%Y|%I:%M:%S.{ms} %p"),
    "German date": dated("%d.%m.%Y %H:%M:%S.{ms}", ("timestamp",)),
    "date in words": dated("%b %d, %Y %I:%M:%S.{ms} %p", ("time",)),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_a_table_as_a_program_writes_it_gives_the_true_positions(tmp_path, name):
    wrench, skin = FORMS[name]
    done = import_tables(wrench.write(tmp_path / "w.csv"), skin.write(tmp_path / "s.csv"))
    assert done.losses == {"wrench": {}, "skin": {}}
    assert done.accepted == POKES
    assert np.nanmax(done.errors_mm) < MAX_ERROR_MM
    assert not np.isnan(done.errors_mm).any()


@pytest.mark.parametrize("empty", ["", "nan"])
def test_one_table_holds_wrench_and_skin(tmp_path, empty):
    """Columns known by name are never taxels; rows of the other topic are no losses."""
    for table, rows in ((one_table(), len(ROWS.times)), (plotjuggler(empty), len(ROWS.times))):
        place = table.write(tmp_path / "all.csv")
        done = import_tables(place, place)
        assert done.losses == {"wrench": {}, "skin": {}}
        assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)
        assert f"wrench: {rows} lines in {(rows - 1) / 25:.1f} s, 25 a second." in done.findings
    said = f"wrench: {rows} rows of the table without its values: not counted as lost."
    assert said in done.findings


def test_one_table_of_other_columns_gives_the_family_of_the_scenes_number(tmp_path):
    n = len(ROWS.times)
    more = {
        "j0_deg": ["12.5"] * n, "temp1": ["31"] * n, "temp2": ["32"] * n, "state": ["idle"] * n, "battery": ["3.7"] * n,
        "loop count": [str(k) for k in range(n)], "millis": [str(40 * k) for k in range(n)],
    }  # fmt: skip
    place = one_table(("t_s", *AXES, *TAXEL_NAMES, *more), tuple(more.values())).write(tmp_path / "all.csv")
    done = import_tables(place, place)
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)
    assert "skin: columns temp1, temp2, battery, loop count are not read; the taxels are t0 to t15." in done.findings
    found = guess_streams([place.path], CHANNELS)
    assert [str(each.topic) for each in (found.wrench, found.skin, found.joints)] == ["", "t", ""]
    assert (found.wrench.path, found.skin.path, found.joints.path) == (place.path,) * 3


def test_a_skin_of_two_is_chosen_by_the_begin_of_its_names(tmp_path):
    names = ("t_s", *(f"left_{name}" for name in TAXEL_NAMES), *(f"right_{name}" for name in TAXEL_NAMES))
    other = fields(np.full_like(ROWS.skin, 200.0), "{:.0f}")
    place = Table(names, [ROWS.seconds(), *other, *fields(ROWS.skin, "{:.0f}")]).write(tmp_path / "s.csv")
    wrench = W.write(tmp_path / "w.csv")
    with pytest.raises(InputError, match="left_t0 to left_t15 and right_t0 to right_t15 have 16 channels each") as refusal:
        import_tables(wrench, place)
    # The advice, followed.
    advised = re.search(r"s\.csv::right_t", str(refusal.value))
    done = import_tables(wrench, RecordedPlace(place.path, advised[0].partition("::")[2]))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)


def test_a_missing_number_is_a_channel_without_readings_and_no_taxel_gets_its_neighbours_place(tmp_path):
    keep = [k for k in range(CHANNELS) if k != 5]
    names, columns = ("t_s", *(TAXEL_NAMES[k] for k in keep)), [S.columns[0], *(S.columns[1 + k] for k in keep)]
    done = import_tables(W.write(tmp_path / "w.csv"), Table(names, columns).write(tmp_path / "s.csv"))
    assert done.unknown() == [5]
    assert np.nanmax(done.errors_mm) < MAX_ERROR_MM
    assert "skin: 1 column missing (t5): no readings of that channel." in done.findings


def test_as_many_columns_as_channels_with_a_gap_in_their_numbers_are_refused(tmp_path):
    """Sixteen of the seventeen taxels of a skin, or sixteen taxels whose numbers skip one: the names do not tell."""
    names = [f"t{k + (k >= 5)}" for k in range(CHANNELS)]
    wrench, skin = W.write(tmp_path / "w.csv"), Table(("t_s", *names), S.columns).write(tmp_path / "s.csv")
    words = r"t0 to t16 are 16 columns, as many as the scene has channels, but t5 is missing.*channels of the scene is 17; else"
    with pytest.raises(InputError, match=words):
        import_tables(wrench, skin)
    # The advice, followed.
    done = import_tables(wrench, Table(S.names, S.columns).write(tmp_path / "s.csv"))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)


def skin_of(path, names, order=range(CHANNELS), more=()):
    """Write a skin whose columns are the channels of `order`; `more` columns stand behind the time."""
    columns = [S.columns[0], *(["21.5"] * len(ROWS.times) for _ in more), *(S.columns[1 + channel] for channel in order)]
    return Table(("t_s", *more, *names), columns).write(path)


@pytest.mark.parametrize("name", ["t{}_raw", "T{} pressure", "taxel {} (kPa)", "/skin/t{}/value"])
def test_numbers_with_a_word_behind_them_are_channels_in_any_order_of_the_file(tmp_path, name):
    order = sorted(range(CHANNELS), key=str)
    done = import_tables(W.write(tmp_path / "w.csv"), skin_of(tmp_path / "s.csv", [name.format(k) for k in order], order))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)


@pytest.mark.parametrize("name", ["r{0}c{1}", "skin[{0}][{1}]", "module{0}_taxel{1}"])
def test_names_of_row_and_column_are_read_row_by_row_with_a_word_and_refused_in_another_order(tmp_path, name):
    wrench, names = W.write(tmp_path / "w.csv"), [name.format(*divmod(k, 4)) for k in range(CHANNELS)]
    done = import_tables(wrench, skin_of(tmp_path / "s.csv", names))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)
    words = f"taken in the order of the file, channel 0 is {names[0]}, channel 15 is {names[15]}."
    assert any(words in finding for finding in done.findings)
    by_columns = [4 * (k % 4) + k // 4 for k in range(CHANNELS)]
    with pytest.raises(InputError, match=r"do not rise in the order of the file.*name the taxels t0, t1"):
        import_tables(wrench, skin_of(tmp_path / "s.csv", [names[k] for k in by_columns], by_columns))
    # The advice, followed.
    done = import_tables(wrench, skin_of(tmp_path / "s.csv", [f"t{k}" for k in by_columns], by_columns))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)


@pytest.mark.parametrize("stray", ["temperature", "temp1", "temp0"])
@pytest.mark.parametrize("lost", [0, 5, 15])
def test_a_column_that_is_no_taxel_does_not_take_the_place_of_a_missing_one(tmp_path, stray, lost):
    wrench, order = W.write(tmp_path / "w.csv"), [k for k in range(CHANNELS) if k != lost]
    skin = skin_of(tmp_path / "s.csv", [f"t{k}" for k in order], order, more=(stray,))
    if lost != 5:
        with pytest.raises(
            InputError, match=f"{stray} and t.* together are 16 columns.*add a missing taxel as an empty column"
        ):
            import_tables(wrench, skin)
        # The advice, followed.
        columns = [S.columns[0], *(column if k != lost else [""] * len(column) for k, column in enumerate(S.columns[1:]))]
        skin = Table(S.names, columns).write(tmp_path / "s.csv")
    done = import_tables(wrench, skin)
    assert done.accepted == POKES - 2
    assert np.nanmax(done.errors_mm) < MAX_ERROR_MM


def test_numbers_that_are_missing_within_and_at_an_end_are_asked_for_and_no_number_of_channels_is_advised(tmp_path):
    order = [k for k in range(CHANNELS) if k not in (0, 5)]
    skin = skin_of(tmp_path / "s.csv", [f"t{k}" for k in order], order)
    with pytest.raises(InputError, match=r"t1 to t15 without t5 \(14 columns\).*as an empty column") as refusal:
        import_tables(W.write(tmp_path / "w.csv"), skin)
    assert "channels of the scene is" not in str(refusal.value)


@pytest.mark.parametrize("count", [1e6, 1e4, 1e3])
def test_counts_with_thousands_separators_are_divided_as_those_without(tmp_path, count):
    facts = f'Force Units:,N\nTorque Units:,Nm\nCounts per Unit Force:,"{count:,.0f}"\nCounts per Unit Torque:,"1,000,000"\n'
    counts = ROWS.wrench * np.repeat([count, 1e6], 3)
    columns = [*fields(counts, "{:,.0f}"), ROWS.seconds()]
    wrench = Table(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "Time"), columns, before=facts).write(tmp_path / "w.csv")
    done = import_tables(wrench, S.write(tmp_path / "s.csv"))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)


@pytest.mark.parametrize(
    ("units", "scales"),
    [(("N", "N-mm"), (1, 1e3)), (("lbf", "lbf-in"), (1 / 4.4482216153, 1 / 0.1129848290)), (("kN", "kNm"), (1e-3, 1e-3))],
)
def test_units_before_the_names_count_without_counts(tmp_path, units, scales):
    columns = [*fields(ROWS.wrench * np.repeat(scales, 3), "{:.9f}"), ROWS.seconds()]
    facts = f"Force Units:,{units[0]}\nTorque Units:,{units[1]}\n"
    wrench = Table(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "Time"), columns, before=facts).write(tmp_path / "w.csv")
    done = import_tables(wrench, S.write(tmp_path / "s.csv"))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)
    assert "wrench: the values are in the units of the lines before the names." in done.findings


def test_days_of_a_spreadsheet_are_no_seconds(tmp_path):
    days = [f"{45413.5 + time / 86400:.10f}" for time in ROWS.times]
    tables = [Table(("time", *each.names[1:]), [days, *each.columns[1:]]) for each in (W, S)]
    with pytest.raises(InputError, match="Spreadsheets may write days: write seconds as t_s"):
        import_tables(*(table.write(tmp_path / f"{k}.csv") for k, table in enumerate(tables)))


@pytest.mark.parametrize(("keep", "missing"), [(range(15), "t15"), (range(1, 16), "t0 or t16")])
def test_a_number_that_is_missing_at_an_end_is_asked_for(tmp_path, keep, missing):
    names, columns = ("t_s", *(TAXEL_NAMES[k] for k in keep)), [S.columns[0], *(S.columns[1 + k] for k in keep)]
    wrench, skin = W.write(tmp_path / "w.csv"), Table(names, columns).write(tmp_path / "s.csv")
    with pytest.raises(InputError, match=f"15 columns.*16 channels. If {missing} is missing, add it as an empty column"):
        import_tables(wrench, skin)
    # The advice, followed.
    name = missing.partition(" or ")[0]
    done = import_tables(wrench, Table((*names, name), [*columns, [""] * len(ROWS.times)]).write(tmp_path / "s.csv"))
    assert done.unknown() == [int(name[1:])]
    assert np.nanmax(done.errors_mm) < MAX_ERROR_MM


def test_a_column_more_in_a_table_without_names_is_no_taxel(tmp_path):
    clock = [str(40 * k) for k in range(len(ROWS.times))]
    skin = Table((), [S.columns[0], clock, *S.columns[1:]])
    wrench = W.write(tmp_path / "w.csv")
    with pytest.raises(InputError, match=r"17 columns after the time.* 16 channels. Column 2 only rises, as a clock"):
        import_tables(wrench, skin.write(tmp_path / "s.csv"))
    # The advice, followed.
    done = import_tables(wrench, replace(skin, names=("t_s", "millis", *TAXEL_NAMES)).write(tmp_path / "s.csv"))
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)


def test_another_number_of_columns_than_channels_is_said_without_a_channel_that_is_dead(tmp_path):
    wrench = W.write(tmp_path / "w.csv")
    wide = Table((*S.names, *(f"t{k}" for k in range(16, 22))), [*S.columns, *S.columns[1:7]])
    with pytest.raises(InputError, match=r"t0 to t21 \(22 columns\), and the scene has 16 channels") as refusal:
        import_tables(wrench, wide.write(tmp_path / "s.csv"))
    assert "[skin] channels of the scene is 22" in str(refusal.value)
    assert import_tables(wrench, wide.write(tmp_path / "s.csv"), 22).losses == {"wrench": {}, "skin": {}}


def test_a_force_plate_needs_its_moments(tmp_path):
    plate = replace(W, names=("Time (s)", "Fx", "Fy", "Fz", "Ax", "Ay", "Tz"))
    with pytest.raises(
        InputError, match=r"centre of pressure of a force plate.*height of the plate's surface.*export the moments"
    ):
        import_tables(plate.write(tmp_path / "w.csv"), S.write(tmp_path / "s.csv"))


@pytest.mark.parametrize(
    ("skin", "words"),
    [
        (milliseconds(skin_table(RAW, columns=[RAW.seconds(), *fields(RAW.skin, "{:,.0f}")])), "may be 1"),
        (german(milliseconds(skin_table(RAW)), "."), "may be 1"),
        (skin_table(RAW, columns=[RAW.seconds(), *fields(RAW.skin, "{:,.0f}")[:-1], ["1,5", *["700"] * (len(ROWS.times) - 1)]]),
         "the comma is decimal in '1,5' \\(row 1\\), and cannot be so beside '0.000' \\(row 1\\)"),
    ],
    ids=["quoted", "German", "both uses"],
)  # fmt: skip
def test_thousands_that_no_field_proves_are_refused_with_field_and_row(tmp_path, skin, words):
    place = skin.write(tmp_path / "s.csv")
    with pytest.raises(InputError, match=words) as refusal:
        import_tables(milliseconds(W).write(tmp_path / "w.csv"), place)
    if words == "may be 1":
        field, row = re.search(r"'(1[.,]\d{3})' \(row (\d+)\)", str(refusal.value)).groups()
        assert field in place.path.read_text().splitlines()[int(row)]
        # The advice, followed: no separators, and a decimal point.
        plain = milliseconds(skin_table(RAW)).write(tmp_path / "s.csv")
        assert np.nanmax(import_tables(milliseconds(W).write(tmp_path / "w.csv"), plain).errors_mm) < MAX_ERROR_MM


@pytest.mark.parametrize(
    ("wrench", "words"),
    [
        (replace(W, names=("t_s", "fx [furlong]", *AXES[1:])), "unit of column 'fx \\[furlong\\]' is not known"),
        (replace(W, below_names="ms,N,N,N,Nm,Nm,Nm\n"), "'t_s' has the unit 'ms' below its name"),
        (replace(W, before='"a quote\n'), "a quote has no end"),
        (replace(W, names=("t_s", *AXES[:-1], "fx")), "both are fx"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, wrench, words):
    with pytest.raises(InputError, match=words):
        import_tables(wrench.write(tmp_path / "w.csv"), S.write(tmp_path / "s.csv"))


def test_a_list_that_is_cut_short_is_refused(tmp_path):
    skin = Table(("t_s", "taxels"), [ROWS.seconds(), ["[200. 201. ... 199.]"] * len(ROWS.times)])
    with pytest.raises(InputError, match="the list in its column 2 is cut short"):
        import_tables(W.write(tmp_path / "w.csv"), skin.write(tmp_path / "s.csv"))


def test_an_empty_field_after_the_last_column_is_none_and_a_filled_one_is_counted(tmp_path):
    skin = S.write(tmp_path / "s.csv").path
    lines = skin.read_text().splitlines()
    skin.write_text("\n".join(line + ("," if k % 7 else ",5" if k else "") for k, line in enumerate(lines)) + "\n")
    done = import_tables(W.write(tmp_path / "w.csv"), RecordedPlace(skin))
    assert done.losses["skin"][Loss.BAD_WIDTH] == len(range(7, len(lines), 7))
