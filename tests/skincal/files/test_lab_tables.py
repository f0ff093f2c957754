"""Tables of labs: LabVIEW files, dates over midnight, units in comments, hexadecimal numbers, German and French names."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from skincal.files.importers.registry import RECORDING_IMPORTERS
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from tests.skincal.files.table_support import (
    AXES,
    CHANNELS,
    POKES,
    TAXEL_NAMES,
    Table,
    fields,
    import_tables,
    poked_rows,
    skin_table,
    wrench_table,
)

ROWS = poked_rows()
N = len(ROWS.times)
W, S = wrench_table(ROWS), skin_table(ROWS)
IN_NMM = replace(W, columns=[*W.columns[:4], *fields(ROWS.wrench[:, 3:] * 1000, "{:.2f}")])
MAX_ERROR_MM = 0.2


def place(tmp_path, wrench=W, skin=S):
    """Import two tables; check that all positions are the true ones, and return the findings."""
    names = [
        f"{name}{'.lvm' if table.before.startswith('LabVIEW') else '.csv'}" for name, table in (("w", wrench), ("s", skin))
    ]
    done = import_tables(wrench.write(tmp_path / names[0]), skin.write(tmp_path / names[1]))
    assert done.losses == {"wrench": {}, "skin": {}}
    assert (done.accepted, np.nanmax(done.errors_mm) < MAX_ERROR_MM) == (POKES, True)
    return done.findings


# ------------------------------------------------------------------ names


def test_channels_with_hexadecimal_numbers_are_read_by_them(tmp_path):
    place(tmp_path, skin=replace(S, names=("t_s", *(f"t{k:x}" for k in range(CHANNELS)))))
    order = [15, *range(15)]
    names = ("t_s", *(f"Taxel_{k:02X}" for k in order))
    place(tmp_path, skin=Table(names, [S.columns[0], *(S.columns[1 + k] for k in order)]))
    # One is missing: the letters are no numbers then.
    with pytest.raises(InputError, match="number"):
        place(tmp_path, skin=Table(("t_s", *(f"t{k:x}" for k in range(15))), S.columns[:16]))


@pytest.mark.parametrize(
    ("time", "force", "torque"),
    [
        ("Zeit", "F{}", "M{}"),
        ("Zeit [s]", "Kraft {} [N]", "Drehmoment {} [Nm]"),
        ("Zeit in s", "Kraft_{}", "Moment_{}"),
        ("Temps (s)", "Force {} (N)", "Couple {} (N.m)"),
        ("Zeitstempel", "F{}", "T{}"),
    ],
)
def test_german_and_french_names_are_read(tmp_path, time, force, torque):
    names = (time, *(form.format(axis) for form in (force, torque) for axis in "xyz"))
    place(tmp_path, replace(W, names=names), replace(S, names=(time, *TAXEL_NAMES)))


# ------------------------------------------------------------------ dates


def dated(table, form, begin):
    moments = [begin + timedelta(seconds=float(t)) for t in ROWS.times]
    texts = [each.strftime(form).replace("{ms}", f"{each.microsecond // 1000:03}") for each in moments]
    return replace(table, names=("timestamp", *table.names[1:]), columns=[texts, *table.columns[1:]])


@pytest.mark.parametrize("order", ["day/month", "month/day"])
@pytest.mark.parametrize("day", [(2024, 5, 1), (2024, 4, 30), (2024, 12, 31)])
def test_dates_with_slashes_over_midnight_follow_each_other(tmp_path, order, day):
    form = ("%d/%m/%Y" if order == "day/month" else "%m/%d/%Y") + " %H:%M:%S.{ms}"
    begin = datetime(*day, 23, 59, 40, tzinfo=UTC)
    findings = place(tmp_path, dated(W, form, begin), dated(S, form, begin))
    assert any(f"Dates with slashes were read as {order}/year." in finding for finding in findings)
    assert not any("gap" in finding for finding in findings)


@pytest.mark.parametrize("form", ["%H:%M:%S.{ms}", "%H:%M:%S,{ms}", "%I:%M:%S.{ms} %p"])
def test_times_of_day_are_read_over_midnight(tmp_path, form):
    begin = datetime(2024, 5, 1, 23, 59, 40, tzinfo=UTC)
    wrench, skin = (replace(dated(table, form, begin), separator=";") for table in (W, S))
    findings = place(tmp_path, replace(wrench, names=("Uhrzeit", *AXES)), replace(skin, names=("Time", *TAXEL_NAMES)))
    assert "wrench: the time column 'uhrzeit' holds times of day." in findings
    assert not any("gap" in finding or "before the one before" in finding for finding in findings)


def test_dates_that_do_not_follow_each_other_are_refused(tmp_path):
    table = dated(W, "%d/%m/%Y %H:%M:%S.{ms}", datetime(2024, 5, 1, 12, tzinfo=UTC))
    texts = [text.replace("01/05/2024", "03/07/2024") if k > N // 2 else text for k, text in enumerate(table.columns[0])]
    with pytest.raises(InputError, match=r"01/05/2024 and 03/07/2024 are no days that follow each other.*2024-05-01"):
        place(tmp_path, replace(table, columns=[texts, *table.columns[1:]]))


# ------------------------------------------------------------------ units


@pytest.mark.parametrize(
    "before",
    [
        "# Force in N, torque in Nmm\n",
        "# units: N, Nmm\n",
        "Units: N Nmm\n",
        "# F [N], M [N mm]\n",
        "% forces (N) and moments (N.mm)\n",
        "# moments in mNm\n",
        "# range 130 N, 10 Nm\n# force: N, torque: N\u00b7mm\n",
        "# force/torque in N/Nmm\n",
        "# Force unit: N; Moment unit: Nmm\n",
        "# forces in newtons and torques in newton-millimetres\n",
        "# t[s] F[N] M[Nmm]\n",
        "# sensitivity 1000 counts/Nm\n# torque Nmm\n",
    ],
)
def test_units_in_a_comment_are_those_of_the_moments(tmp_path, before):
    assert "wrench: the values are in the units of the lines before the names." in place(
        tmp_path, replace(IN_NMM, before=before)
    )
    if before.startswith("#"):
        findings = place(tmp_path, replace(IN_NMM, before=before, names=()))
        assert "wrench: the values are in the units of the lines before the rows." in findings


def test_a_range_in_another_unit_is_no_unit_of_the_values_and_is_said(tmp_path):
    findings = place(tmp_path, replace(W, before="# range 130 N, 10000 Nmm\n"))
    assert any("mention Nmm; the moments were read as N m. If not: write mx [Nmm]" in finding for finding in findings)
    assert not any("mention" in finding for finding in place(tmp_path, replace(W, before="# range 130 N, 10 Nm\n")))


def test_a_comment_between_names_and_rows_names_units_too(tmp_path):
    place(tmp_path, replace(IN_NMM, below_names="# N and Nmm\n"))


def test_units_in_names_are_stronger_than_comments_and_two_units_of_moments_are_refused(tmp_path):
    names = ("t_s", *(f"{axis} [{'N' if axis[0] == 'f' else 'Nm'}]" for axis in AXES))
    place(tmp_path, replace(W, names=names, before="# torque of the motor in Nmm\n"))
    place(tmp_path, replace(W, before=f"# N = {N} rows\n"))
    table = replace(IN_NMM, before="# torque in Nmm, limit in Nm\n")
    with pytest.raises(InputError, match=r"name nmm and nm, and the names of the columns no unit.*mx \[Nm\]"):
        place(tmp_path, table)
    # The advice followed.
    place(tmp_path, replace(table, names=(*W.names[:4], *(f"{axis} [Nmm]" for axis in AXES[3:]))))


# ------------------------------------------------------------------ LabVIEW


def labview(table, units=(), separator="\t", decimal=".", begin="12:00:00.1234567890", comment=True, changes=()):
    """A table as LabVIEW writes measurement files."""
    k, word = len(table.names) - 1, {"\t": "Tab", ",": "Comma"}[separator]

    def each(text):
        return separator.join([text] * k)

    facts = {
        "LabVIEW Measurement": "",
        "Writer_Version": "2",
        "Separator": word,
        "Decimal_Separator": decimal,
        "Multi_Headings": "No",
        "X_Columns": "One",
        "Time_Pref": "Relative",
        "Date": "2024/05/01",
        "Time": begin,
        "***End_of_Header***": "",
    }
    more = {
        "": "", "Channels": str(k), "Samples": each(str(N)), "Date": each("2024/05/01"), "Time": each(begin),
        "Y_Unit_Label": separator.join(units), "X_Dimension": each("Time"), "X0": each("0.0000000000000000E+0"),
        "Delta_X": each("0.040000"), "***End_of_Header***": "",
    }  # fmt: skip
    head = [f"{key}{separator}{value}" for part in (facts, more) for key, value in part.items()]
    text = "".join(f"{line}\n" for line in head)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    columns = [[field.replace(".", decimal) for field in column] for column in table.columns]
    names = ("X_Value", *table.names[1:], *(["Comment"] if comment else []))
    return replace(table, names=names, columns=columns, before=text, separator=separator)


@pytest.mark.parametrize(("separator", "decimal"), [("\t", "."), ("\t", ","), (",", ".")])
def test_a_labview_file_is_read(tmp_path, separator, decimal):
    place(tmp_path, labview(W, ["N"] * 3 + ["Nm"] * 3, separator, decimal), labview(S, [], separator, decimal, comment=False))
    place(
        tmp_path, labview(IN_NMM, ["N"] * 3 + ["Nmm"] * 3, separator, decimal), labview(S, ["V"] * CHANNELS, separator, decimal)
    )


def test_labview_files_that_began_at_other_moments_are_paired_by_them(tmp_path):
    late = replace(S, columns=[[f"{t - 3.25:.3f}" for t in ROWS.times], *S.columns[1:]])
    place(tmp_path, labview(W, begin="12:00:00.5"), labview(late, begin="12:00:03.75"))


def test_labview_files_in_another_form_are_refused_with_the_setting(tmp_path):
    for change, words in (
        (("X_Columns\tOne", "X_Columns\tMulti"), "choose 'One column only'"),
        (("X_Columns\tOne", "X_Columns\tNo"), "choose 'One column only'"),
        (("***End_of_Header***", "***End***"), "no \\*\\*\\*End_of_Header\\*\\*\\*"),
    ):
        with pytest.raises(InputError, match=words):
            place(tmp_path, labview(W, changes=(change,)))
    table = labview(W)
    twice = replace(
        table,
        columns=[
            [*column[:50], *(["***End_of_Header***"] if not k else [""]), *column[50:]]
            for k, column in enumerate(table.columns)
        ],
    )
    with pytest.raises(InputError, match="choose 'One header only'"):
        place(tmp_path, twice)
    with pytest.raises(InputError, match=r"unit of column 'fx \[volts\]' is not known"):
        place(tmp_path, labview(W, ["Volts"] * 6))


# ------------------------------------------------------------------ refusals


@pytest.mark.parametrize("form", ["%I:%M:%S %p", "%m/%d/%Y %I:%M:%S %p"])
def test_whole_seconds_of_the_makers_program_are_refused_with_the_way(tmp_path, form):
    names = ("Status (hex)", " RDT Sequence", " F/T Sequence", " Fx", " Fy", " Fz", " Tx", " Ty", " Tz", " Time")
    counts = [str(k) for k in range(N)]
    times = [(datetime(2024, 5, 1, 12, tzinfo=UTC) + timedelta(seconds=float(t))).strftime(form) for t in ROWS.times]
    table = Table(names, [["0"] * N, counts, counts, *W.columns[1:], times], before="Force Units: N\nTorque Units: Nm\n")
    with pytest.raises(InputError, match=r"writes whole seconds \(seen '.*12:00:00 PM'\).*netft://ADDRESS"):
        place(tmp_path, table)
    # The advice followed.
    place(tmp_path, replace(table, names=(*names[:-1], "t_s"), columns=[*table.columns[:-1], ROWS.seconds()]))


@pytest.mark.parametrize(
    ("names", "named"),
    [
        (("j0", "j1"), "j0"),
        (("position[0]", "position[1]"), "position[0]"),
        (("shoulder_pan_joint", "elbow_joint"), "shoulder_pan_joint"),
        ((*AXES, "q0", "q1"), "q0"),
        ((*AXES, *TAXEL_NAMES, "joint_1", "joint_2"), "joint_1"),
    ],
)
def test_joints_without_units_are_refused_for_that_and_the_advice_reads_them(tmp_path, names, named):
    importer = next(each for each in RECORDING_IMPORTERS if each.name == "csv")

    def opened(names):
        table = Table(("t_s", *names), [ROWS.seconds(), *([f"{k}.5"] * N for k in range(len(names)))])
        return importer.open_recording({Stream.JOINTS: table.write(tmp_path / "j.csv")})

    with pytest.raises(
        InputError, match=f"column '{re.escape(named)}' names no unit.*name it {re.escape(named)}_deg or"
    ) as error:
        opened(names)
    assert "no column besides" not in str(error.value)
    first = names.index(named)
    assert opened((*names[:first], *(f"{name}_deg" for name in names[first:])))


def test_a_table_without_joints_says_so(tmp_path):
    importer = next(each for each in RECORDING_IMPORTERS if each.name == "csv")
    with pytest.raises(InputError, match="no column is a joint; seen t_s, fx"):
        importer.open_recording({Stream.JOINTS: W.write(tmp_path / "w.csv")})
