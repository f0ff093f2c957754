"""Every file says which of its taxels were touched, and which are inferred."""

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from skincal.files.export import calibration_file
from skincal.files.formats import ExportFormat
from skincal.taxels.result import Method, State, placed_state
from tests.approved import approved
from tests.skincal.files.files_support import make_calibration, with_turns

INFERRED = (3, 4, 5, 9)


@pytest.fixture
def calibration(part):
    whole = make_calibration(part, unseen=(13,))
    some = tuple(
        replace(each, state=State.INFERRED, contacts=0) if each.channel in INFERRED else each
        for each in whole.estimates[Method.MODULES]
    )
    return replace(whole, estimates={Method.MODULES: some})


def states_in(content: bytes, format_: ExportFormat) -> dict[int, str]:
    """Read state by channel as a user of the format would: from its field, or from its comment."""
    if format_ is ExportFormat.NPZ:
        found = np.load(io.BytesIO(content), allow_pickle=False)
        return dict(zip(found["channel"].tolist(), found["state"].tolist(), strict=True))
    text = content.decode()
    if format_ is ExportFormat.JSON:
        return {each["channel"]: each["state"] for each in json.loads(text)["estimates"]["modules"]}
    if format_ is ExportFormat.CSV:
        return {int(row["channel"]): row["state"] for row in csv.DictReader(text.splitlines())}
    if format_ is ExportFormat.PLY:
        header, _, rows = text.partition("end_header\n")
        names = re.findall(r"^property \w+ (\w+)$", header, re.MULTILINE)
        vertices = [dict(zip(names, row.split(), strict=True)) for row in rows.splitlines()]
        return {int(each["channel"]): "inferred" if each["inferred"] == "1" else "touched" for each in vertices}
    return {
        channel: state
        for state, listed in re.findall(r"^\W*(\w+) \([^)]*\): channels ([\d, -]+\d)", text, re.MULTILINE)
        for first, last in ((each.split("-")[0], each.split("-")[-1]) for each in listed.split(", "))
        for channel in range(int(first), int(last) + 1)
    }


@pytest.mark.parametrize("format_", ExportFormat)
def test_a_file_tells_touched_taxels_from_inferred_ones(calibration, format_):
    if format_.needs_three_axes:
        calibration, _ = with_turns(calibration, {})
    content, said = calibration_file(calibration, format_, Method.MODULES)
    found = states_in(content, format_)
    assert found.pop(13, "untouched") == "untouched"
    assert sorted(channel for channel, state in found.items() if state == "inferred") == list(INFERRED)
    assert {state for channel, state in found.items() if channel not in INFERRED} == {"touched"}
    assert len(found) == len(calibration.channels) - 1
    assert approved("export.inferred", taxels="4 taxels of 34 are", channels="3-5, 9") in "\n".join(said)


def test_a_taxel_with_a_position_is_touched_by_its_own_contacts_alone():
    assert [placed_state(contacts, {}) for contacts in (0, 1, 12)] == [State.INFERRED, State.TOUCHED, State.TOUCHED]
    assert [placed_state(contacts, {7: 0.4}) for contacts in (1, 2)] == [State.INFERRED, State.TOUCHED]
