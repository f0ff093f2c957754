"""Settings of an ATI sensor that change its readings: tool transform, units, ranges, status bits, samples that stand still."""

import struct

import numpy as np
import pytest

from skincal.devices.decoding import pack
from skincal.devices.link import LinkError
from skincal.devices.netft_page import read_page
from skincal.devices.registry import parse_device
from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.auto_detect import make_decoder

GAMMA_PAGE = """<?xml version="1.0"?><netft>
<runstat>0x00000000</runstat><runrate>7000</runrate><cfgnam>empty</cfgnam><cfgcalsel>0</cfgcalsel><cfgcalsn>FT27462</cfgcalsn>
<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu>
<cfgtfx>0;0;132.710;0;0;0</cfgtfx><scfgtdu>mm</scfgtdu><scfgtau>degrees</scfgtau>
<cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt><cfgmr>330;330;990;30;30;30</cfgmr>
<setuserfilter>0</setuserfilter><comrdtrate>100</comrdtrate></netft>"""
"""Fields of a public live page: a Gamma SI-330-30, firmware 2.2.59."""
OWN = (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)
"""N, N m: a wrench in the sensor's own frame."""
REPORTED = [
    ("0;0;132.71;0;0;0", "mm", "degrees", (1.5, -2.25, 30.0, -0.173597, -0.699065, 0.0625)),
    ("0;0;20;45;0;0", "mm", "degrees", (1.5, 19.622213, 22.804193, 0.080000, -0.330572, 0.418961)),
    ("10;-20;35;30;-40;75", "mm", "degrees", (17.413594, -14.561517, 19.800037, -0.027600, -0.635627, -0.282201)),
    ("1;2;-3;0.3;0.2;-1.1", "in", "radians", (-7.961248, -0.835597, 29.038473, -0.924516, -0.896315, -0.169491)),
]
"""Transform, units, and `OWN` as a box with it reports: printed by `TTM` of ATI's C library (ATIDAQ 1.0.2, `ftconfig.c`)."""


def page(**fields):
    """The page of the Gamma, some of its fields with another text; `None` leaves one out."""
    text = GAMMA_PAGE
    for name, value in fields.items():
        begin, end = text.index(f"<{name}>"), text.index(f"</{name}>") + len(name) + 3
        text = text[:begin] + ("" if value is None else f"<{name}>{value}</{name}>") + text[end:]
    return text.encode()


def record(number, wrench=OWN, status=0, sample=None):
    counts = [round(value * 1e6) for value in wrench]
    return pack(2, struct.pack("!III6i", number, number * 70 if sample is None else sample, status, *counts))


def decode(page_bytes, *records):
    decoder = make_decoder("rdt", None, (Stream.WRENCH,))
    batches = decoder.feed(pack(1, page_bytes) + b"".join(records))
    return np.vstack([batch.values for batch in batches]) if batches else np.empty((0, 6)), decoder, batches


@pytest.mark.parametrize(("transform", "length", "angle", "reported"), REPORTED)
def test_a_tool_transform_of_the_box_is_undone_and_said(transform, length, angle, reported):
    made = page(cfgtfx=transform, scfgtdu=length, scfgtau=angle)
    (values,), decoder, _ = decode(made, record(1, reported))
    assert values == pytest.approx(OWN, abs=2e-6)
    assert "tool transform" in decoder.device_message
    assert "transform=keep" in decoder.device_message
    assert "sensor's own frame" in decoder.units[Stream.WRENCH]


def test_a_force_axis_read_through_a_transform_passes_the_contact():
    """A push at c: f . m = 0 and m = c x f about the sensor's own origin, by another route than the matrix."""
    force, contact, moved = np.array([2.0, 1.0, -8.0]), np.array([0.02, -0.01, 0.15]), np.array([0.0, 0.0, 0.13271])
    reported = (*force, *np.cross(contact - moved, force))
    (values,), _, _ = decode(page(), record(1, reported))
    assert values[3:] == pytest.approx(np.cross(contact, force), abs=1e-6)


@pytest.mark.parametrize("transform", ["0;0;0;0;0;0", "0.000;0.0;0;0;-0;0"])
def test_a_page_without_a_transform_changes_no_bit(transform):
    (values,), decoder, _ = decode(page(cfgtfx=transform), record(1))
    assert values.tolist() == [round(value * 1e6) / 1e6 for value in OWN]
    assert decoder.device_message == ""


def test_a_page_that_names_no_transform_is_said_to_name_none():
    (values,), decoder, _ = decode(page(cfgtfx=None), record(1))
    assert values.tolist() == list(OWN)
    assert decoder.units[Stream.WRENCH] == (
        "Fx Fy Fz in N, Mx My Mz in N m, its tool transform is not known and must be 0, FT27462, set to 100 Hz"
    )


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"scfgtdu": "furlong"}, "has the unit 'furlong', expected one of in, ft, mm"),
        ({"scfgtdu": None}, "has the unit ''"),
        ({"scfgtau": "gon"}, "has the unit 'gon', expected one of deg"),
        ({"cfgtfx": "0;0;132"}, "gives the tool transform '0;0;132'; expected six numbers"),
        ({"cfgtfx": "0;0;x;0;0;0"}, "expected six numbers"),
    ],
)
def test_a_transform_that_cannot_be_undone_gives_no_readings(fields, words):
    made = page(**fields)
    with pytest.raises(ValueError, match="tool transform"):
        read_page(made)
    values, decoder, _ = decode(made, record(1))
    assert len(values) == 0
    assert words in decoder.device_message


class Answers:
    """The network: every page that is asked for is this one."""

    def __init__(self, answer):
        self.answer = answer

    def get_page(self, *_where):
        return self.answer


def prepared(address, answer):
    device = parse_device(address)
    return device.route.prepare(device, Answers(answer)).first_bytes


def test_a_transform_that_the_scene_means_is_kept_and_said_also_in_a_replay():
    decoder = make_decoder("rdt", None, (Stream.WRENCH,))
    first = prepared("netft://h?transform=keep", page() + b" " * 70_000)
    (batch,) = decoder.feed(first + record(1))
    assert batch.values.tolist() == [list(OWN)]
    assert "must be that of this frame" in decoder.device_message
    undone = make_decoder("rdt", None, (Stream.WRENCH,)).feed(prepared("netft://h", page()) + record(1))
    assert undone[0].values[0, 3:].tolist() != list(OWN[3:])


def test_a_page_with_an_unreadable_transform_and_a_wrong_option_are_refused_with_the_address():
    with pytest.raises(LinkError, match=r"netft://h: its tool transform .* set all six numbers to 0"):
        prepared("netft://h", page(scfgtdu="furlong"))
    with pytest.raises(LinkError, match=r"transform is no; expected undo or keep"):
        prepared("netft://h?transform=no", page())


@pytest.mark.parametrize(
    ("unit", "newtons"),
    [("lbf", 4.4482216152605), ("klbf", 4448.2216152605), ("kN", 1e3), ("kgf", 9.80665), ("gf", 9.80665e-3), ("g", 9.80665e-3)],
)
def test_each_force_unit_of_the_manual_is_read(unit, newtons):
    assert 1e6 / read_page(page(scfgfu=unit)).per_newton == pytest.approx(newtons)


@pytest.mark.parametrize(
    ("unit", "newton_metres"),
    [
        *(("lbf-in", 0.112984829), ("in-lb", 0.112984829), ("lbf-ft", 1.35581795), ("ft-lb", 1.35581795)),
        *(("Nmm", 1e-3), ("N-m", 1.0), ("kNm", 1e3), ("kgf-cm", 0.0980665)),
    ],
)
def test_each_torque_unit_of_the_manual_is_read(unit, newton_metres):
    assert 1e6 / read_page(page(scfgtu=unit)).per_newton_metre == pytest.approx(newton_metres)


def test_a_reading_beyond_the_ranges_of_the_page_is_saturated():
    made = page(cfgtfx="0;0;0;0;0;0", cfgmr="40;40;120;500;500;500", scfgtu="Nmm", cfgcpt="1000")
    values, decoder, batches = decode(made, record(1), record(2, (41, 0, 0, 0, 0, 0)), record(3, (0, 0, 0, 0, 0, -0.6)))
    assert len(values) == 3
    assert [flag for batch in batches for flag in batch.saturated.tolist()] == [False, True, True]
    assert "beyond the range on the sensor's page" in decoder.device_message
    decoder.feed(record(4))
    assert decoder.device_message == ""
    turned = read_page(page(cfgmr="1;1;1;1;1;1"))
    assert turned.limits == (), "the page does not name the frame of its ranges"


@pytest.mark.parametrize(("address", "words"), [("cpf=1000000&cpt=1000", "1000 times too large"), ("cpf=10000&cpt=100000", "")])
def test_counts_for_newton_millimetres_are_asked_about(address, words):
    """The override of the package pynetft is in N mm."""
    decoder = make_decoder("rdt", None, (Stream.WRENCH,))
    decoder.feed(prepared(f"netft://h?{address}", b""))
    assert words in decoder.device_message
    assert bool(words) == bool(decoder.device_message)


@pytest.mark.parametrize(
    ("product", "status", "invalid", "words"),
    [
        ("Net F/T", 0x00000008, True, "reference voltage"),
        ("Net F/T", 0x80000008, True, "reference voltage"),
        ("Net F/T", 0x80000004, True, "temperature"),
        ("Net F/T", 0x80800000, True, "does not fit its calibration"),
        ("Net F/T", 0x40000000, True, "processor or memory"),
        ("Net F/T", 0x80010000, False, "monitored condition"),
        ("Net F/T", 0x00010000, False, "monitored condition"),
        ("Net F/T", 0x80000000, True, "an error"),
        ("Ethernet Axia80", 0x00000008, False, ""),
        ("FTN-AXIA80", 0x00000008, False, ""),
        ("Ethernet Axia80", 0x80000020, True, "hardware"),
    ],
)
def test_a_status_bit_means_what_the_manual_of_the_model_says(product, status, invalid, words):
    made = page(cfgtfx="0;0;0;0;0;0").replace(b"<netft>", f"<netft><prodname>{product}</prodname>".encode())
    _, decoder, (batch,) = decode(made, record(1, status=status))
    assert batch.invalid.tolist() == [invalid]
    assert words in decoder.device_message
    assert bool(decoder.device_message) == bool(words)


def test_a_sensor_that_stands_still_behind_its_box_is_counted_and_said():
    made = page(cfgtfx="0;0;0;0;0;0")
    moving = [record(number, sample=number * 7) for number in range(3)]
    standing = [record(3 + number, sample=14) for number in range(30)]
    values, decoder, _ = decode(made, *moving, *standing)
    assert len(values) == 3
    assert decoder.counts == {Loss.REPEATED: 30}
    assert "has stopped" in decoder.device_message
    (again,) = decoder.feed(record(33, sample=21))
    assert (len(again.seq), decoder.device_message, decoder.counts) == (1, "", {Loss.REPEATED: 30})


def test_a_sensor_that_numbers_no_samples_loses_nothing():
    values, decoder, _ = decode(page(cfgtfx="0;0;0;0;0;0"), *[record(number, sample=0) for number in range(50)])
    assert (len(values), decoder.counts.total()) == (50, 0)
