"""A layout from the points of a user's own paxini-sdk. Its data here is made up: a dome by a formula."""

import json
import zipfile

import numpy as np
import pytest

from skincal.files.layout_sources import parse_layout
from skincal.files.paxini_points import flatten_points, layout_text, read_modules
from skincal.model.errors import InputError
from tests.skincal.files.paxini_support import dome, package_files, write_package


@pytest.fixture
def package(tmp_path):
    return write_package(tmp_path)


def test_a_dome_is_flattened_with_the_distances_of_its_neighbours():
    points, arcs = dome()
    flat = flatten_points(points * 1e-3) * 1e3
    apart, unrolled = (np.linalg.norm(each[:, None] - each, axis=2) for each in (flat, points))
    near = (unrolled > 0) & (unrolled < 4.5)
    assert np.abs(apart[near] / unrolled[near] - 1.0).max() < 0.13
    # Seen from outside: no mirror, and x and y of the module.
    assert np.abs(flat - arcs).max() < 1.0
    # A plane stays as it is.
    plane = np.column_stack([arcs, np.zeros(25)]) * 1e-3
    assert np.abs(flatten_points(plane) - (plane - plane.mean(axis=0))[:, :2]).max() < 1e-12


def test_modules_are_found_by_code_model_and_number_of_taxels(package, tmp_path):
    by_code, by_model, by_count = (read_modules([name], package)[0] for name in ("made-up", "DOME-25", "25"))
    assert np.array_equal(by_code.points, by_count.points)
    assert np.array_equal(by_code.points, by_model.points)
    assert by_code.points == pytest.approx(dome()[0] * 1e-3)
    wheel = tmp_path / "paxini_sdk-0.1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, content in package_files().items():
            archive.writestr(f"paxini_sdk/data/{name}", json.dumps(content))
    assert np.array_equal(read_modules(["25"], wheel)[0].points, by_code.points)
    for folder in (package / "paxini_sdk", package / "paxini_sdk" / "data"):
        assert len(read_modules(["4", "25"], folder)) == 2


def test_channels_of_several_modules_follow_in_the_order_of_the_stream(package, tmp_path):
    layout = parse_layout(layout_text(read_modules(["4", "25"], package)), tmp_path / "m.toml")
    assert layout.width == 29
    assert [len(module.channels) for module in layout.modules] == [4, 25]
    assert layout.modules[1].channels.tolist() == list(range(4, 29))
    assert layout.places[4:, 0].min() > layout.places[:4, 0].max() + 5e-3


def move_point(path, row, to):
    document = json.loads(path.read_text())
    points = document["points"]
    points[row] |= to if isinstance(to, dict) else {**points[to], "index": points[row]["index"]}
    path.write_text(json.dumps(document))


def rename_module(registry, before, after):
    registry.write_text(registry.read_text().replace(before, after))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: (data / "registry.json").write_text("[]"), "another form"),
        (lambda data: (data / "registry.json").write_text('{"sensors": [{}]}'), "another form"),
        (lambda data: rename_module(data / "registry.json", "MADE-UP", "MADE/UP"), "another form"),
        (lambda data: (data / "dome.json").write_text('{"points": [{"x_mm": 1}]}'), "points in mm"),
        (lambda data: (data / "dome.json").write_text('{"points": []}'), "0 points; expected 25"),
        (lambda data: (data / "dome.json").unlink(), "dome.json"),
        (lambda data: move_point(data / "dome.json", 7, 6), "points that are equal"),
        (lambda data: move_point(data / "dome.json", 7, {"x_mm": 1e6}), "over 200 mm away"),
        (lambda data: move_point(data / "dome.json", 7, {"x_mm": float("nan")}), "no number"),
        (lambda data: (data / "dome.json").write_text("no JSON"), "no JSON"),
    ],
)
def test_another_form_of_the_package_is_named(package, change, sentence):
    change(package / "paxini_sdk" / "data")
    with pytest.raises(InputError, match=sentence):
        read_modules(["25"], package)


def test_a_damaged_wheel_is_named(tmp_path):
    wheel = tmp_path / "paxini_sdk-0.1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in package_files().items():
            archive.writestr(f"paxini_sdk/data/{name}", json.dumps(content))
    whole, begin = wheel.read_bytes(), 30 + len("paxini_sdk/data/registry.json")
    for damaged in (
        whole[:begin] + b"\xff" * 20 + whole[begin + 20 :],  # packed bytes
        whole.replace(b"PK\x01\x02\x14\x03\x14\x00\x00\x00", b"PK\x01\x02\x14\x03\x14\x00\x01\x00"),  # encrypted
        whole.replace(b"\x00\x00\x08\x00", b"\x00\x00\x63\x00"),  # another method
    ):
        assert damaged != whole
        wheel.write_bytes(damaged)
        with pytest.raises(InputError, match=r"has no paxini_sdk/data/registry.json; expected the wheel"):
            read_modules(["25"], wheel)


def test_a_missing_package_and_an_unknown_module_are_named(package, tmp_path):
    with pytest.raises(InputError, match="not installed"):
        read_modules(["25"])
    with pytest.raises(InputError, match="has no paxini_sdk"):
        read_modules(["25"], tmp_path)
    with pytest.raises(InputError, match=r"no module '7'.*MADE-UP \(25 taxels\)"):
        read_modules(["7"], package)
