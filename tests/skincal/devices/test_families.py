"""Contract of every device family: entry, addresses, vectors, garbage, noise, the manual."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.devices.family import AUTO_FORMAT
from skincal.devices.registry import CHECKSUMMED_FORMATS, DEVICE_FORMATS, FAMILIES, load_family, parse_device
from skincal.model.readings import Loss
from skincal.streams.decoders.auto_detect import LinkDecoder, make_decoder
from skincal.streams.transports import FILE_OF_TRANSPORT

ROUTES = [route for file in FAMILIES for route in load_family(file).routes]
VECTORS = [vector for file in FAMILIES for vector in load_family(file).vectors]
FIRST = {vector.format: vector for vector in reversed(VECTORS)}
"""The first vector of each format."""
REPEATED = {name: vector for name, vector in FIRST.items() if vector.repeat}


def decode(vector, data):
    """Readings of bytes, stream by stream, with the device's clock; and the decoder."""
    decoder = make_decoder(vector.format, vector.channels, vector.carries)
    rows = [
        (batch.stream, values.tolist(), None if np.isnan(stamp) else stamp)
        for batch in decoder.feed(data)
        for values, stamp in zip(batch.values, batch.device_s.tolist(), strict=True)
    ]
    return sorted(rows, key=lambda row: row[0].value), decoder


@pytest.mark.parametrize("file", FAMILIES)
def test_the_entry_says_what_the_file_has(file):
    entry, family = FAMILIES[file], load_family(file)
    assert {route.scheme for route in family.routes} == set(entry.schemes)
    assert tuple(family.decoders) == entry.formats
    checksummed = [name for name, decoder in family.decoders.items() if decoder.loss_of_garbage is Loss.BAD_CHECKSUM]
    assert tuple(checksummed) == entry.checksummed
    assert {vector.format for vector in family.vectors} == set(entry.formats)


@pytest.mark.parametrize("route", ROUTES, ids=lambda route: route.usage)
def test_the_example_of_a_route_is_an_address_of_it(route):
    address = route.usage.partition(" or ")[0]
    found = parse_device(address)
    assert (found.text, found.route) == (address, route)
    assert route.transport in FILE_OF_TRANSPORT
    assert route.format in (AUTO_FORMAT, *DEVICE_FORMATS)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector.format)
def test_a_vector_gives_its_readings(vector):
    rows, decoder = decode(vector, vector.data)
    assert [row[1] for row in rows] == [pytest.approx(list(values), rel=1e-12) for values in vector.values]
    assert decoder.counts.total() == 0
    assert decoder.device_message == ""


@pytest.mark.parametrize("route", [each for each in ROUTES if each.format in FIRST], ids=lambda route: route.usage)
def test_a_link_that_is_unreadable_without_its_first_bytes_is_opened_again_after_a_gap(route):
    vector = FIRST[route.format]
    rows, _ = decode(vector, vector.repeat * 5)
    assert rows or not vector.repeat or route.needs_every_byte


def stream_of(vector, repeats=5):
    return vector.data + vector.repeat * repeats


@pytest.mark.parametrize("name", FIRST)
def test_each_repetition_of_a_record_is_read(name):
    vector = FIRST[name]
    found, decoder = decode(vector, stream_of(vector))
    records = len(vector.values) // len(vector.carries) + (5 if vector.repeat else 0)
    assert len(found) == records * len(vector.carries)
    assert decoder.valid_records == records


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(set(FIRST) - {"robotiq-text"})), st.binary(max_size=400))
def test_noise_is_no_reading(name, noise):
    assert decode(FIRST[name], noise * 20)[1].valid_records == 0


@pytest.mark.parametrize("name", CHECKSUMMED_FORMATS)
def test_frames_after_garbage_are_found_again(name):
    data = stream_of(REPEATED[name])
    broken = bytearray(data)
    broken[len(data) // 2] ^= 0x40
    rows, decoder = decode(REPEATED[name], bytes(broken) + data * 200)
    assert len(rows) >= 1100
    assert decoder.counts[Loss.BAD_CHECKSUM] == 1


@pytest.mark.parametrize("name", CHECKSUMMED_FORMATS)
def test_a_format_with_a_checksum_is_detected(name):
    vector, data = REPEATED[name], stream_of(REPEATED[name])
    link = LinkDecoder(AUTO_FORMAT, vector.channels, vector.carries)
    found = [batch for at in range(0, len(data), 10) for batch in link.feed(data[at : at + 10], at * 1_000_000)]
    assert link.current.name == make_decoder(name, None, vector.carries).name
    assert sum(len(batch.seq) for _, batch in found) == 6


@pytest.mark.parametrize("file", FAMILIES)
def test_the_manual_names_every_way_to_a_device(file):
    page = (Path(__file__).resolve().parents[3] / "docs" / "devices.md").read_text(encoding="utf-8")
    table = page.partition("## Wiring")[0]
    assert all(f"`{scheme}:" in table for scheme in FAMILIES[file].schemes if scheme != "socket")
