"""Forms of lines that boards print: the bytes of each, how they are cut, and the positions of a skin that sends them."""

from __future__ import annotations

import json
import math
from collections import Counter
from functools import cache, reduce

import numpy as np
import pytest

from skincal.model.readings import Chunk, LinkAnswer, LinkEvent, LinkState, Loss, Stream
from skincal.model.scene import load_scene
from skincal.session.pipeline import Pipeline
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.decoders.delimited import HEX_AFTER_DECIMALS, MAY_BE_HEX, TextDecoder
from skincal.streams.decoders.line_forms import LINE_FORMS, last_clean_line, nearest_form, read_line
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import LinkIntake
from skincal.streams.links import LinkSpec
from skincal.words.link_words import link_verdict_words
from tests.approved import approved
from tests.skincal.streams.cut_bytes import assert_cuts_never_matter
from tests.skincal.wrench_frame_support import PADS_M, RATE_HZ, write_scene

SKIN, WRENCH = (Stream.SKIN,), (Stream.WRENCH,)
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
WIDTH = 16
ROWS = 4
POKE_S = 1.4
MAX_ERROR_M = 0.8e-3


def comma(values):
    return ",".join(map(str, values))


def rows_of(values):
    return "".join(comma(values[at : at + ROWS]) + "\n" for at in range(0, len(values), ROWS))


def checked(body):
    return f"${body}*{reduce(lambda found, byte: found ^ byte, body.encode(), 0):02X}\n"


FORMS = {
    "plain": lambda _, v: f"{comma(v)}\n",
    "labels from 0": lambda _, v: ",".join(f"T{n}:{each}" for n, each in enumerate(v)) + "\n",
    "labels in hexadecimal": lambda _, v: ",".join(f"T{n:X}:{each}" for n, each in enumerate(v)) + "\n",
    "labels from 1 and tabs": lambda _, v: "\t".join(f"S{n}={each}" for n, each in enumerate(v, 1)) + "\r\n",
    "labels in any order": lambda k, v: (
        " ".join(f"taxel[{n}]: {v[n]}" for n in np.random.default_rng(k).permutation(len(v))) + "\n"
    ),
    "labels with a clock": lambda k, v: f"millis:{20 * k}," + ",".join(f"T{n}:{each}" for n, each in enumerate(v)) + "\n",
    "two lines of labels": lambda _, v: "".join(
        ",".join(f"T{n}:{v[n]}" for n in part) + "\n" for part in (range(8), range(8, WIDTH))
    ),
    "a channel a line": lambda _, v: "".join(f"{n}:{each}\n" for n, each in enumerate(v)),
    "a channel a line from 1": lambda _, v: "".join(f"S{n} = {each}\n" for n, each in enumerate(v, 1)),
    "brackets": lambda _, v: f"[{comma(v)}]\n",
    "round brackets": lambda _, v: f"({' '.join(map(str, v))})\n",
    "JSON list of rows": lambda _, v: json.dumps(np.reshape(v, (-1, ROWS)).tolist()) + "\n",
    "JSON object": lambda k, v: json.dumps({"ms": 20 * k, "skin": v, "temperature": 25.5}) + "\n",
    "JSON object of channels": lambda _, v: json.dumps({f"t{n}": each for n, each in enumerate(v)}) + "\n",
    "title": lambda _, v: f"#SKIN={comma(v)}\n",
    "title and colon": lambda _, v: f"Skin: [{comma(v)}]\n",
    "checksum": lambda _, v: checked(f"SKIN,{comma(v)}"),
    "log": lambda k, v: f"I ({20 * k}) skin: {comma(v)}\n",
    "monitor": lambda k, v: f"12:{k // 3000 % 60:02d}:{k // 50 % 60:02d}.{k % 50 * 20:03d} -> {comma(v)}\r\n",
    "monitor and labels": lambda _, v: "12:33:01.123 -> " + ",".join(f"T{n}:{each}" for n, each in enumerate(v)) + "\n",
    "leading comma": lambda _, v: f",{comma(v)}\n",
    "carriage return": lambda _, v: f"{comma(v)}\r",
    "0x": lambda _, v: ",".join(f"0x{each:04X}" for each in v) + "\n",
    "hexadecimal": lambda _, v: " ".join(f"{each:04X}" for each in v) + "\n",
    "rows, dashes": lambda _, v: f"----------\n{rows_of(v)}",
    "rows, title": lambda k, v: f"Frame {k}\n{rows_of(v)}",
    "rows, number": lambda k, v: f"{k}\n{rows_of(v)}",
    "row and column": lambda _, v: " ".join(f"r{n // ROWS}c{n % ROWS}={each}" for n, each in enumerate(v)) + "\n",
    "row and column from 1, one a line": lambda _, v: "".join(
        f"Row {n // ROWS + 1} Col {n % ROWS + 1}: {each}\n" for n, each in enumerate(v)
    ),
    "row and column, column by column": lambda _, v: (
        ", ".join(f"s[{n % ROWS}][{n // ROWS}]={v[n % ROWS * ROWS + n // ROWS]}" for n in range(len(v))) + "\n"
    ),
    "labels with a unit": lambda _, v: ", ".join(f"T{n}: {each}.5 mV" for n, each in enumerate(v)) + "\n",
    "labels with a unit and no space": lambda _, v: "\t".join(f"S{n}={each}mV" for n, each in enumerate(v)) + "\n",
    "units": lambda _, v: " ".join(f"{each} mV" for each in v) + "\n",
    "units and no space": lambda _, v: ",".join(f"{each}.25kPa" for each in v) + "\n",
    "decimal comma": lambda _, v: ";".join(f"T{n}:{each},{(7 * each + n) % 9:02d}" for n, each in enumerate(v)) + "\n",
    "decimal comma and tabs": lambda _, v: "\t".join(f"{each},{(7 * each + n) % 9:02d}" for n, each in enumerate(v)) + "\n",
    "number and value with semicolons": lambda _, v: ";".join(f"{n},{each}" for n, each in enumerate(v)) + "\n",
    "number and value with spaces": lambda _, v: " ".join(f"{n},{each}.5" for n, each in enumerate(v, 1)) + "\n",
    "decimal comma and a unit": lambda _, v: " ".join(f"T{n}: {each},5 V" for n, each in enumerate(v)) + "\n",
    "labels without a colon": lambda _, v: " ".join(f"T{n} {each}" for n, each in enumerate(v)) + "\n",
    "labels and bars": lambda _, v: " | ".join(f"T{n}: {each}" for n, each in enumerate(v)) + "\n",
    "bars": lambda _, v: " | ".join(map(str, v)) + " |\n",
    "semicolon at the end": lambda _, v: f"{comma(v)};\n",
    "quotes": lambda _, v: ",".join(f'"{each}"' for each in v) + "\n",
    "word in front": lambda _, v: f"SKIN,{comma(v)}\n",
    "words in front": lambda _, v: "Sensor values " + " ".join(map(str, v)) + "\n",
    "debug": lambda _, v: f"DEBUG: {comma(v)}\n",
    "tag in brackets": lambda _, v: f"[skin] {comma(v)}\n",
    "a mark": lambda _, v: f"${comma(v)}\n",
    "a mark and a semicolon": lambda _, v: "$" + " ".join(map(str, v)) + ";\n",
    "constant checksum": lambda _, v: f"$SKIN,{comma(v)}*00\n",
    "title with a counter": lambda k, v: f"Reading {k}: {comma(v)}\n",
    "Teleplot": lambda k, v: "".join(f">T{n}:{20 * k}:{each}\n" for n, each in enumerate(v)),
    "coloured log": lambda k, v: f"\x1b[0;32mI ({20 * k}) skin: {comma(v)}\x1b[0m\n",
    "log of the Arduino ESP32": lambda k, v: f"[{20 * k:6d}][I][main.cpp:42] loop(): {comma(v)}\r\n",
    "log of Zephyr": lambda k, v: f"[00:00:{k // 50 % 60:02d}.{k % 50 * 20:03d},000] <inf> skin: {comma(v)}\n",
    "log of Python": lambda k, v: f"2026-05-01 12:00:{k // 50 % 60:02d},{k % 50 * 20:03d} - skin - INFO - {comma(v)}\n",
    "time of day": lambda k, v: f"12:{k // 3000 % 60:02d}:{k // 50 % 60:02d}.{k % 50 * 20:03d} {comma(v)}\n",
    "date and time in brackets": lambda k, v: f"[2026-05-01 12:{k // 3000 % 60:02d}:{k // 50 % 60:02d}] {comma(v)}\n",
    "numpy": lambda _, v: str(np.reshape(v, (-1, ROWS))) + "\n",
    "numpy, a long row": lambda _, v: np.array2string(np.array(v), max_line_width=30) + "\n",
    "indented JSON": lambda _, v: json.dumps({"skin": v}, indent=2) + "\n",
    "number and value a line": lambda _, v: "".join(f"{n},{each}\n" for n, each in enumerate(v)),
    "number and value a line, with blank lines": lambda _, v: "".join(f"{n} {each}\n" for n, each in enumerate(v, 1)) + "\n",
    "numbers and values in pairs": lambda _, v: ",".join(f"{n},{each}" for n, each in enumerate(v)) + "\n",
    "rows with a number": lambda _, v: "".join(
        f"{n} " + " ".join(map(str, v[ROWS * n : ROWS * n + ROWS])) + "\n" for n in range(len(v) // ROWS)
    ),
    "rows with a title and names of columns": lambda _, v: (
        "C0 C1 C2 C3\n"
        + "".join(f"R{n}: " + " ".join(map(str, v[ROWS * n : ROWS * n + ROWS])) + "\n" for n in range(len(v) // ROWS))
    ),
    "rows with a title": lambda _, v: "".join(
        f"Row {n + 1}: {comma(v[ROWS * n : ROWS * n + ROWS])}\n" for n in range(len(v) // ROWS)
    ),
    "title, rows and a blank line": lambda k, v: f"Frame {k}\n{rows_of(v)}\n",
    "two lines, a comma at the end of the first": lambda _, v: f"{comma(v[:10])},\n{comma(v[10:])}\n",
    "two lines, a comma at the begin of the second": lambda _, v: f"{comma(v[:9])}\n,{comma(v[9:])}\n",
    "number, millis and micros first": lambda k, v: f"{k},{5000 + 20 * k},{5000000 + 20003 * k},{comma(v)}\n",
    "millis last": lambda k, v: f"{comma(v)},{5000 + 20 * k}\n",
    "millis first": lambda k, v: f"{5000 + 20 * k},{comma(v)}\n",
    "counter of 8 bits first": lambda k, v: f"{k % 256},{comma(v)}\n",
    "clock with a header": lambda k, v: (
        ("" if k else "millis," + comma(f"t{n}" for n in range(WIDTH)) + "\n") + f"{20 * k},{comma(v)}\n"
    ),
}
"""Form of one frame by its number and values."""
FIRST_LOST_MAX = {
    "hexadecimal": 4,
    "millis first": 32,
    "counter of 8 bits first": 32,
    "number, millis and micros first": 32,
    "millis last": 32,
    "title with a counter": 32,
    "constant checksum": 12,
}
"""Frames that are lost until a form is believed; 3 for the others."""
LAST_LOST = ("rows, dashes", "rows, title", "rows, number")
"""Forms whose last frame has no end yet."""
# 170 to 255 have a letter in hexadecimal.
FRAMES = [[170 + (37 * k + 7 * n) % 86 for n in range(WIDTH)] for k in range(40)]


def values(batches):
    return [row for batch in batches for row in batch.values.tolist()]


def assert_same(found, expected, name):
    """Frames are the sent ones but for decimals, whole and in order, but for the first ones (and one without an end)."""
    last = len(expected) - (name in LAST_LOST)
    first = last - len(found)
    assert 0 <= first <= FIRST_LOST_MAX.get(name, 3)
    assert [list(map(int, row)) for row in found] == expected[first:last]


@pytest.mark.parametrize("name", FORMS)
def test_frames_of_a_form_are_read_however_its_bytes_are_cut(name):
    raw = "".join(FORMS[name](k, frame) for k, frame in enumerate(FRAMES)).encode()
    raw += b"\r" * (name == "carriage return")
    assert_same(values(assert_cuts_never_matter(lambda: TextDecoder(WIDTH, SKIN), raw)), FRAMES, name)
    size = len(FORMS[name](1, FRAMES[1]))
    for begin in range(1, size):
        late = values(TextDecoder(WIDTH, SKIN).feed(raw[begin : begin + 8 * size]))
        assert all(list(map(int, row)) in FRAMES for row in late), "opened in the middle of a frame"


@pytest.mark.parametrize("form", LINE_FORMS, ids=lambda form: form.name)
def test_the_example_of_each_form_is_read_by_its_row_alone(form):
    lines = form.example.decode().splitlines()
    assert read_line(lines[0]) == form.read(lines[0]) is not None
    assert nearest_form(lines[0]) == lines[0]
    # The number of rows follows from that of the channels.
    for channels in (4,) if form.name == "numbered title" else (4, None):
        decoder = TextDecoder(channels, SKIN)
        found = values(decoder.feed(b"\n" + form.example * 2))
        expected = [0x1A, 6, 7 + 4 * (form.name.endswith("without 0x")), 8] if "hexa" in form.name else [5, 6, 7, 8]
        assert expected in found[:2]
        assert len(found) >= 2
        assert not decoder.counts


# ------------------------------------------------------------------ positions


@cache
def readings():
    """Wrenches (n, 6) and whole raw values (n, 16) of four pokes, each tilted another way, at each of 16 pads."""
    rng = np.random.default_rng(5)
    tilts = np.array([[0.45, 0], [0, 0.45], [-0.45, 0], [0, -0.45]])
    pokes = [(pad, tilt) for tilt in tilts for pad in PADS_M]
    t = np.arange(round(RATE_HZ * (2 + POKE_S * len(pokes)))) / RATE_HZ
    wrench, skin = rng.normal(0, [0.02] * 3 + [0.001] * 3, (len(t), 6)), 200 + rng.normal(0, 1, (len(t), WIDTH))
    for number, (pad, tilt) in enumerate(pokes):
        place, push = np.r_[pad + rng.normal(0, 4e-4, 2), 0.045], np.r_[tilt, -1.0]
        force = 8.0 * push / np.linalg.norm(push)
        begin = 2 + POKE_S * number
        ramp = np.clip(np.minimum((t - begin) / 0.1, (begin + 0.8 - t) / 0.1), 0, 1)[:, None]
        wrench += ramp * np.r_[force, np.cross(place, force)]
        skin += ramp * 400 * np.exp(-np.linalg.norm(PADS_M - place[:2], axis=1) / 1.2e-3)
    return wrench, np.round(skin).astype(int).tolist()


def place_taxels(scene, wrench_lines, skin_lines):
    """Positions by the free method of a recording whose links send these lines, m, by channel."""
    links = tuple(
        LinkSpec(name, "socket://127.0.0.1:1", (stream,), "auto")
        for name, stream in (("wrench", Stream.WRENCH), ("skin", Stream.SKIN))
    )
    pipeline = Pipeline(scene, links, None)
    for link in links:
        pipeline.feed(LinkEvent(link.name, 1, LinkState.OPEN))
    for k, (wrench, skin) in enumerate(zip(wrench_lines, skin_lines, strict=True)):
        now_ns = 10**9 + k * 10**9 // RATE_HZ
        pipeline.feed(Chunk("wrench", now_ns, wrench.encode()))
        pipeline.feed(Chunk("skin", now_ns + 2_000_000, skin.encode()))
    found = {method.value: of for method, of in pipeline.snapshot().estimates.items()}["free"]
    return {each.channel: each.position for each in found}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return load_scene(write_scene(tmp_path_factory.mktemp("bench")))


def errors(found):
    return {
        channel: float(np.linalg.norm(place[:2] - PADS_M[channel])) for channel, place in found.items() if place is not None
    }


def wrench_line(row):
    return ",".join(f"{value:.6f}" for value in row) + "\n"


@pytest.mark.parametrize("name", FORMS)
def test_the_frames_of_a_poked_skin_are_read_in_each_form(name):
    frames = readings()[1][::12]
    decoder = LinkDecoder("auto", WIDTH, SKIN)
    sent = ((FORMS[name](k, frame).encode(), k * 10**9 // RATE_HZ) for k, frame in enumerate(frames))
    found = values(batch for raw, host_ns in sent for _, batch in decoder.feed(raw, host_ns))
    assert_same(found, frames, name)


def labelled_wrench_line(row):
    units = ("N", "N", "kN", "Nm", "N m", "Nmm")
    sizes = (1, 1, 1e-3, 1, 1, 1e3)
    parts = (f"{axis}: {value * size:.9f} {unit}" for axis, value, size, unit in zip(AXES, row, sizes, units, strict=True))
    return ", ".join(parts) + "\n"


@pytest.mark.parametrize(
    ("name", "write_wrench"),
    [("labels in any order", wrench_line), ("decimal comma", labelled_wrench_line), ("rows, title", wrench_line)],
)
def test_a_skin_whose_frames_are_read_is_placed(scene, name, write_wrench):
    wrench, skin = readings()
    placed = place_taxels(scene, map(write_wrench, wrench), (FORMS[name](k, row) for k, row in enumerate(skin)))
    found = errors(placed)
    assert len(found) == WIDTH
    assert max(found.values()) < MAX_ERROR_M


# ------------------------------------------------------------------ what must not be read


def decoded(raw, channels=4, carries=SKIN):
    decoder = TextDecoder(channels, carries)
    return values(decoder.feed(b"\n" + raw.encode())), decoder


def test_a_missing_channel_is_not_a_number_and_never_its_neighbour():
    line = "T0:{},T1:2,T3:4\n"
    found, decoder = decoded("".join(line.format(k) for k in range(4)))
    assert [row[0] for row in found] == [1, 2, 3]
    assert all(math.isnan(row[2]) and row[3] == 4 for row in found)
    assert decoder.counts == Counter({Loss.NOT_A_NUMBER: 3})
    found, _ = decoded("".join(f"0:{k}\n1:2\n" + "2:3\n" * (k != 2) + "3:4\n" for k in range(5)))
    assert [row[0] for row in found] == [1, 2, 3, 4]
    assert [math.isnan(row[2]) for row in found] == [False, True, False, False]


@pytest.mark.parametrize(
    "line",
    [
        "T1:2,T2:3,T3:4",  # of T0 and T4 either may be missing
        "T0:1,T1:2,T1:3,T2:4",
        "T0:1,T1:2,S2:3,S3:4",
        "T0:1 mV,T1:2 mV,T2:3 mV,T3:4 V",
        "T0:1,T1:2,T2:3,T3:4,T4:5",
        '{"raw":[1,2,3,4],"filtered":[1,2,3,4]}',
        '{"skin":[1,2,3,true]}',
        "[1,2,3,4",
        "[[1,2],[3]]",
        ",1,2,3",
        "1F,0x02,03,04",
        "dead beef cafe face",
        "T0:1,5;T1:2,5;T2:3,5;T3:4,5",  # decimals, or two numbers a label
        "0,51\t0,52\t0,53\t0,54",
        "T0: 1 V, T1: 2 V, T2: 3 V, T3: 900 mV",
        "T0:1A T1:2A T2:3A T3:4A",  # hexadecimal
        "frame 7 1 2 3",  # a number of the frame and three values, or four values
        "time: 7,1,2,3",
        "(0,1):1 (0,2):2 (1,1):3 (1,2):4",  # rows and columns, or x and y
        "r0c0=1 r0c1=2 r1c0=3 r1c0=4",
        "Temperature: 25.5",
    ],
)
def test_a_line_that_may_mean_something_else_is_not_read(line):
    assert decoded(f"{line}\n" * 6)[0] == []


def test_numbers_of_channels_among_the_values_are_no_values_and_the_advice_leads_to_the_channels():
    lines = "".join(",".join(f"{n},{200 + k + n}" for n in range(4)) + "\n" for k in range(6))
    found, decoder = decoded(lines, 8)
    assert found == []
    assert decoder.device_message.endswith("set [skin] channels to 4")
    # The advice followed.
    assert decoded(lines, 4)[0][-1] == [205, 206, 207, 208]
    found, decoder = decoded("".join("".join(f"{n},{n + k}\n" for n in range(8)) + "\n" for k in range(6)), 16)
    assert found == []
    assert decoder.counts[Loss.UNREADABLE] == 6


def test_a_board_with_more_channels_or_rows_than_the_scene_gives_no_part_of_its_frames():
    for line in ("T{n}:{v}\n", "Row {n}: {v} {v} {v} {v}\n", "{n},{v}\n", "{v} {v} {v} {v}\n"):
        raw = "".join("".join(line.format(n=n, v=10 * k + n) for n in range(32)) + "\n" for k in range(9))
        found, decoder = decoded(raw, WIDTH)
        assert found == []
        assert decoder.counts[Loss.BAD_WIDTH] or decoder.device_message


def test_channels_that_no_label_names_are_said():
    found, decoder = decoded("T0:1,T1:2,T2:3,T3:4\n" * 30, 6)
    assert all(row[:4] == [1, 2, 3, 4] and math.isnan(row[4]) and math.isnan(row[5]) for row in found)
    assert decoder.device_message == "No line has a label of channel 4-5 (from 0): these have no readings"
    # Now and then a missing one is not said.
    assert not decoded(("T0:1,T1:2,T2:3,T3:4\n" * 5 + "T0:1,T1:2,T2:3\n") * 9)[1].device_message


@pytest.mark.parametrize("line", ["T{n}:{v}\n", "Row {n}: {v} {v} {v} {v}\n"])
def test_one_channel_or_row_more_than_the_scene_ends_the_readings(line):
    count = 4 if "Row" in line else 16
    raw = "".join("".join(line.format(n=n, v=10 * k + n) for n in range(count)) for k in range(40))
    found, decoder = decoded(raw, count * (4 if "Row" in line else 1) - (4 if "Row" in line else 1))
    assert len(found) <= 4
    assert "count further" in decoder.device_message


def test_a_scene_with_two_channels_hears_that_the_first_value_is_the_number_of_a_channel():
    lines = "".join(f"{n},{200 + n + k}\n" for k in range(9) for n in range(4))
    words = "set [skin] channels to 4 if it is the number of a channel or a row, to 1 if it is a counter"
    assert decoded(lines, 2)[1].device_message.endswith(words)
    # The advice followed.
    assert decoded(lines, 4)[0][-1] == [208, 209, 210, 211]
    rng = np.random.default_rng(7)
    assert not decoded("".join(f"{comma(rng.integers(0, 3, 2))}\n" for _ in range(300)), 2)[1].device_message


def test_a_comma_at_the_begin_of_every_line_joins_no_two_frames():
    assert decoded(",1,2,3,4\n" * 20, 8)[0] == []


def test_clocks_before_wrench_and_skin_of_one_link_are_left_out():
    rng = np.random.default_rng(6)
    lines = [
        f"{20 * k},{comma(rng.integers(-9, 9, 6))}\n{20 * k + 1},{comma(rng.integers(190, 210, WIDTH))}\n" for k in range(60)
    ]
    wrench, skin = TextDecoder(WIDTH, (Stream.WRENCH, Stream.SKIN)).feed(("\n" + "".join(lines)).encode())
    assert wrench.values.tolist() == [list(map(float, line.split("\n")[0].split(",")[1:])) for line in lines[30:]]
    assert skin.values.tolist() == [list(map(float, line.split("\n")[1].split(",")[1:])) for line in lines[30:]]


def test_two_sensors_with_one_title_are_not_mixed_and_a_constant_number_is_part_of_the_title():
    assert decoded("Sensor 1: 1,2,3,4\nSensor 2: 5,6,7,8\n" * 40)[0] == []
    assert decoded("Sensor 2: 1,2,3,4\n" * 4)[0] == [[1, 2, 3, 4]] * 3
    found, decoder = decoded("Sensor 1: 1,2,3,4\n" * 3 + "Sensor 2: 5,6,7,8\n" * 3)
    assert found == [[1, 2, 3, 4]] * 2
    assert decoder.counts == Counter({Loss.UNREADABLE: 3})


def test_labels_with_a_decimal_comma_are_read_once_a_line_shows_that_these_are_decimals():
    whole = "T0:1,50;T1:2,25;T2:3,75;T3:4,50\n"
    assert decoded(whole * 9)[0] == []
    found, _ = decoded(whole * 3 + "T0:1,05;T1:2,25;T2:3,75;T3:4,50\n" + whole)
    assert found == [[1.05, 2.25, 3.75, 4.5], [1.5, 2.25, 3.75, 4.5]]


def test_decimals_whose_digits_before_the_comma_count_are_decimals_if_they_are_few():
    assert decoded("0,51;1,52;2,53;3,54\n" * 3)[0] == [[0.51, 1.52, 2.53, 3.54]] * 3
    assert decoded("0,51 1,52 2,53 3,54\n" * 3)[0] == []


def test_a_device_clock_among_labels_has_its_unit():
    (batch,) = TextDecoder(2, SKIN).feed(b"\n" + b"t: 1200 ms, T0: 1, T1: 2\n" * 2)
    assert batch.device_s.tolist() == [1.2]


def test_six_values_in_one_unit_are_no_wrench_and_units_of_force_and_moment_are():
    assert decoded("1 N, 2 N, 3 N, 4 N, 5 N, 6 N\n" * 4, carries=WRENCH)[0] == []
    found, _ = decoded("1 N, 2 N, 3 kN, 4 Nm, 5 Nmm, 6 N m\n" * 3, carries=WRENCH)
    np.testing.assert_allclose(found, [[1, 2, 3000, 4, 5e-3, 6]] * 2)


def test_a_line_cut_inside_a_number_is_lost_and_counted():
    cut = "1,2,3,4,5,\n6,7,8\n"
    found, decoder = decoded(cut * 3 + "1,2,3,4,5\n5,6,7,8\n" + cut, 8)
    assert found == [[1, 2, 3, 4, 5, 6, 7, 8]] * 3
    assert decoder.counts[Loss.BAD_WIDTH] >= 1
    # Without a separator at the cut nothing says which line begins a frame.
    assert decoded("1,2,3,4,5\n6,7,8\n" * 9, 8)[0] == []
    # A separator at the end of all lines says nothing.
    assert decoded("1,2,3,4,\n5,6,7,8,\n" * 9, 8)[0] == []


def test_an_open_bracket_in_a_banner_swallows_no_frames():
    found, _ = decoded("[boot\n" + "1,2,3,40\n" * 3)
    assert found == [[1, 2, 3, 40]] * 3


def test_numbers_behind_a_word_are_no_header():
    assert decoded("Frame 1\n2\n3\n", 1)[0] == [[2], [3]]
    decoder = TextDecoder(3, SKIN)
    assert values(decoder.feed(b"time,0,1,2\n7,1,2,3\n")) == [[1, 2, 3]]


def test_forces_in_an_unknown_unit_or_without_moments_are_not_read():
    for line in ("Fx: 1 mV, Fy: 2, Fz: 3, Mx: 4, My: 5, Mz: 6", "Fx: 1, Fy: 2, Fz: 3", "Fx:1,Fx:2,Fy:2,Fz:3,Mx:4,My:5,Mz:6"):
        assert decoded(f"{line}\n" * 4, carries=WRENCH)[0] == []


def test_offsets_printed_once_are_no_reading_and_a_second_title_is_left_out():
    found, decoder = decoded("Offsets: 9,9,9,9\n" + "Skin: 1,2,3,4\n" * 3 + "Raw: 8,8,8,8\n" + "Skin: 1,2,3,4\n")
    assert found == [[1, 2, 3, 4]] * 3
    assert decoder.counts == Counter({Loss.UNREADABLE: 1})
    assert decoded("RAW: 1,2,3,4\nCAL: 5,6,7,8\n" * 5)[0] == []


def test_plain_lines_stay_what_they_were_whatever_is_printed_between_them():
    raw = "1,2,3,40\n[9,9,9,9]\n[9,9,9,9]\nT0:9,T1:9,T2:9,T3:9\n" * 3 + "1,2,3,50\n"
    found, decoder = decoded(raw)
    assert found == [[1, 2, 3, 40]] * 3 + [[1, 2, 3, 50]]
    assert decoder.counts[Loss.BAD_WIDTH] == 0


def test_one_line_may_hold_wrench_and_skin():
    line = '{"ms": %d, "fx":1,"fy":2,"fz":3,"mx":4,"my":5,"mz":6,"skin":[7,8,9,10]}\n'
    wrench, skin = TextDecoder(4, (Stream.WRENCH, Stream.SKIN)).feed(("\n" + line % 20 + line % 40 + line % 60).encode())
    assert wrench.values.tolist() == [[1, 2, 3, 4, 5, 6]] * 2
    assert skin.values.tolist() == [[7, 8, 9, 10]] * 2
    np.testing.assert_allclose(skin.device_s, [0.04, 0.06])


def test_a_wrong_checksum_is_counted_and_the_right_one_is_said():
    found, decoder = decoded(checked("SKIN,1,2,3,4") * 3 + "$SKIN,1,2,3,4*00\n")
    assert found == [[1, 2, 3, 4]] * 2
    assert decoder.counts == Counter({Loss.BAD_CHECKSUM: 1})
    assert decoder.device_message == "Checksum *00 of a line is wrong; expected *1B"
    # The advice followed.
    assert decoded("$SKIN,1,2,3,4*1B\n" * 2)[0] == [[1, 2, 3, 4]]


def test_a_frame_that_lost_a_row_is_counted_and_no_frame_is_made_of_two():
    for between in ("----\n", "Frame {k}\n", "{k}\n"):
        frames = [[100 * k + n for n in range(WIDTH)] for k in range(6)]
        parts = [between.format(k=k) + rows_of(frame) for k, frame in enumerate(frames)]
        parts[3] = "".join(part for n, part in enumerate(parts[3].splitlines(keepends=True)) if n != 2)
        found, decoder = decoded("".join(parts) + between.format(k=6), WIDTH)
        assert found == [frames[k] for k in (1, 2, 4, 5)] or found == [frames[k] for k in (0, 1, 2, 4, 5)]
        assert decoder.counts[Loss.BAD_WIDTH] >= 1


# ------------------------------------------------------------------ hexadecimal


def test_hexadecimal_that_was_read_as_decimals_stops_the_readings_and_says_so():
    found, decoder = decoded("10 20 30 40\n" * 50 + "1F 20 3A 40\n" * 3 + "10 20 30 40\n" * 5)
    assert found == [[10, 20, 30, 40]] * 50
    assert decoder.device_message == HEX_AFTER_DECIMALS
    assert decoder.counts[Loss.UNREADABLE] == 8
    # The advice followed.
    assert decoded("0x1F 0x20 0x3A 0x40\n" * 2)[0] == [[31, 32, 58, 64]]


def test_letters_of_a_damaged_line_do_not_stop_decimals():
    found, decoder = decoded(("10 20 30 40\n" * 40 + "1F 20 30 40\n") * 4)
    assert len(found) == 160
    assert decoder.device_message != HEX_AFTER_DECIMALS


def test_damage_with_other_letters_is_no_hexadecimal():
    found, decoder = decoded(("10 20 30 40\n" * 3 + "1F 20 30 40\n" + "10 2k 30 40\n") * 6)
    assert len(found) == 18
    assert decoder.device_message != HEX_AFTER_DECIMALS


def test_exponents_may_be_hexadecimal_but_points_and_signs_are_decimals():
    assert decoded("1e2 201 202 203\n" * 6)[1].device_message == HEX_AFTER_DECIMALS
    found, decoder = decoded("1.0e2,-2.0e+1,3,4\n" * 6)
    assert found == [[100, -20, 3, 4]] * 6
    assert decoder.device_message == ""


def test_lines_at_rest_are_the_same_in_both_bases_and_hexadecimal_is_read_after_them():
    found, _ = decoded("0000 0001 0000 0002\n" * 3 + "00C8 00C9 00CA 00CB\n" * 2 + "0010 0011 0012 0013\n")
    assert found == [[0, 1, 0, 2]] * 3 + [[200, 201, 202, 203], [16, 17, 18, 19]]


def test_numbers_with_leading_zeros_are_read_with_a_word():
    found, decoder = decoded("0010,0011,0012,0013\n" * 3)
    assert found == [[10, 11, 12, 13]] * 3
    assert decoder.device_message == MAY_BE_HEX


# ------------------------------------------------------------------ a clock first


def clock_lines(count, channels=4, step=20):
    rng = np.random.default_rng(3)
    return "".join(f"{1000 + step * k}," + comma(rng.integers(190, 210, channels)) + "\n" for k in range(count))


def test_a_first_value_that_only_rises_is_left_out_and_said():
    found, decoder = decoded(clock_lines(100))
    assert len(found) == 70
    assert all(190 <= value < 210 for row in found for value in row)
    assert "without the first of 5 values a line, which only rises" in decoder.units[Stream.SKIN]
    assert decoder.device_message == ""


@pytest.mark.parametrize("name", ["millis", "micros", "ms", "us", "timestamp", "Time [ms]", "millis()", "sample"])
def test_a_header_names_a_clock_or_number_as_the_importer_knows_it(name):
    decoder = TextDecoder(2, SKIN)
    (batch,) = decoder.feed(f"{name},a,b\n2000,7,8\n2020,7,9\n".encode())
    assert batch.values.tolist() == [[7, 8], [7, 9]]
    unit = {"micros": 1e-6, "us": 1e-6, "timestamp": math.nan, "sample": math.nan}.get(name, 1e-3)
    np.testing.assert_allclose(batch.device_s, np.array([2000, 2020]) * unit)


def test_a_scene_with_a_channel_too_many_hears_that_the_first_is_a_clock():
    """The number of channels was set to the number of values: the advice leads back to the right one."""
    found, decoder = decoded(clock_lines(100), 5)
    assert len(found) == 100
    assert decoder.device_message.endswith("if it is a clock or a number, set [skin] channels to 4")
    assert len(decoded(clock_lines(100), 4)[0]) == 70


def test_values_that_rise_for_a_while_are_no_clock():
    rng = np.random.default_rng(4)
    # A press on the first of five channels, where the scene has four.
    ramp = [200 + min(k % 80, 25) * 10 + int(rng.integers(0, 9)) for k in range(400)]
    found, decoder = decoded("".join(f"{first}," + comma(rng.integers(190, 210, 4)) + "\n" for first in ramp))
    assert found == []
    assert decoder.counts[Loss.BAD_WIDTH] == 400
    # Two rising columns: none is known to be the one too many.
    assert decoded("".join(f"{k},{20 * k},1,{k % 3},5\n" for k in range(100)))[0] == []


# ------------------------------------------------------------------ the sentence


def verdict_of(raw, channels=WIDTH, carries=SKIN):
    link = LinkIntake(ExpectedReadings(channels), LinkSpec("skin", "/dev/ttyUSB0", carries, "auto"))
    link.feed(LinkEvent("skin", 1, LinkState.OPEN))
    for k in range(100):
        link.feed(Chunk("skin", 10**9 + k * 20_000_000, raw))
    return link.health(3 * 10**9).verdict


@pytest.mark.parametrize(
    ("line", "nearest"),
    [
        ("r0c0=12 r0c1=13 r1c0=14", "r0c0=1 r0c1=2 r1c0=3 r1c1=4"),
        ("x0y0=12 x0y1=13 x1y0=14", "T0:1,T1:2,T2:3,T3:4"),
        ("$SKIN;1;2;3;4*ZZ", "$SKIN,1,2,3,4*1B"),
        ("T0: 1,5 T1: 2,5", "T0:1,00;T1:2,00;T2:3,00;T3:4,00"),
        ("0,51 0,52 0,53", "1,00 2,00 3,00 4,00"),
        ('{"skin": "1 2 3 4"}', '{"skin":[1,2,3,4]}'),
        ("waiting for the sensor", "1,2,3,4"),
        ("[1, 2, 3, 4", "[1, 2, 3, 4]"),
    ],
)
def test_clean_text_is_shown_with_the_nearest_form_and_is_no_wrong_baud_rate(line, nearest):
    verdict = verdict_of(f"{line}\r\n".encode())
    assert (verdict.answer, verdict.line, verdict.nearest) == (LinkAnswer.NO_READING, line, nearest)
    words = link_verdict_words(verdict)
    assert words == approved("links.no_reading_line", line=line, nearest=nearest)
    assert "baud" not in words
    # The advice followed: the named form is read.
    assert verdict_of(f"{nearest}\n".encode(), 4).answer is LinkAnswer.GOOD


def test_a_shown_line_is_cut_and_bytes_of_a_wrong_baud_rate_are_not_shown():
    assert last_clean_line(b"x" * 200 + b"\n") == "x" * 57 + "..."
    assert last_clean_line(b"T0;1\tT1;2\r\nhalf") == "T0;1 T1;2"
    rng = np.random.default_rng(1)
    for raw in (
        b"text\x07line\n",
        b"\x1b[31mred\n",
        rng.integers(0, 256, 300, np.uint8).tobytes() + b"\n",
        b"",
        b"\n\n",
        b"no end",
    ):
        assert last_clean_line(raw) == ""
    assert "baud" in link_verdict_words(verdict_of(rng.integers(128, 256, 60, np.uint8).tobytes()))
