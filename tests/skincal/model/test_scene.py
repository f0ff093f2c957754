"""Scene files: read whole, and every fault named with what was seen and what was expected."""

from pathlib import Path

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.model.scene import load_scene, with_layout
from skincal.model.skin import MODULE_KINDS, Layout, Module
from tests.approved import approved, approved_pattern

GOOD = """
name = "bench"
link = "plate"
[skin]
channels = 24
polarity = "down"
modules = "m.toml"
[arm]
joints = [3, 4]
dh = [[0.015, 0.0, 90.0, 0.0], [0.0, -0.1373, 90.0, -90.0]]
base_from_sensor = [[-1,0,0,0],[0,0,1,-0.08428],[0,1,0,0],[0,0,0,1]]
[arm.poses]
"1" = [94.0, 0.0]
[surface]
mesh = "part.obj"
unit = "mm"
[contacts]
force_min = 3
[noise]
force = 0.2
"""
MODULES = '[[modules]]\nid = 5\nkind = "triangle_12"\nfirst_channel = 12\nplace_mm = [1, 2]\nangle_deg = 30\n'


def write(folder: Path, scene: str = GOOD, modules: str = MODULES) -> Path:
    (folder / "m.toml").write_text(modules, encoding="utf-8")
    path = folder / "scene.toml"
    path.write_text(scene, encoding="utf-8")
    return path


def test_a_scene_is_read_whole(tmp_path):
    scene = load_scene(write(tmp_path))
    assert scene.skin.polarity == -1
    assert scene.skin.layout is not None
    assert scene.skin.layout.channels.tolist() == list(range(12, 24))
    assert scene.surface is not None
    assert scene.surface.scale == 1e-3
    assert scene.surface.path == tmp_path / "part.obj"
    assert scene.arm is not None
    assert np.allclose(scene.arm.poses["1"], np.radians([94, 0]))
    assert scene.contacts.force_min == 3.0
    assert scene.contacts.force_max == 15.0
    assert scene.noise.force == 0.2


OTHER = MODULES.replace("id = 5", "id = 7").replace("= 12\n", "= 0\n")
DISTANCES = """
[[distances]]
modules = [5, 7]
mm = 52.5
sd_mm = 0.3
[[distances]]
taxels = [3, 15]
mm = 50
sd_mm = 1
"""


def test_a_distance_that_is_written_twice_is_refused(tmp_path):
    """Twice it would count as two measurements."""
    twice = GOOD + DISTANCES + DISTANCES
    with pytest.raises(InputError, match="written twice"):
        load_scene(write(tmp_path, twice, MODULES + OTHER))


def test_known_distances_are_read(tmp_path):
    by_module, by_taxel = load_scene(write(tmp_path, GOOD + DISTANCES, MODULES + OTHER)).distances
    assert (by_module.ends, by_module.of_taxels) == ((5, 7), False)
    assert (by_taxel.ends, by_taxel.of_taxels) == ((3, 15), True)
    assert (by_module.length, by_module.sd) == pytest.approx((0.0525, 0.0003))


def test_a_distance_needs_a_layout_that_has_its_ends(tmp_path):
    scene = load_scene(write(tmp_path, GOOD + DISTANCES, MODULES + OTHER))
    other = tmp_path / "one.toml"
    other.write_text(MODULES, encoding="utf-8")
    with pytest.raises(InputError, match=approved_pattern("scene.no_such_modules", ends="[5, 7]")):
        with_layout(scene, other)
    with pytest.raises(InputError, match=approved_pattern("scene.distance_without_layout")):
        load_scene(write(tmp_path, GOOD.replace('modules = "m.toml"', "") + DISTANCES))


def test_what_a_scene_does_not_have_is_none(tmp_path):
    scene = load_scene(write(tmp_path, 'name = "a"\nlink = "b"\n[skin]\nchannels = 4\n'))
    assert scene.surface is None
    assert scene.arm is None
    assert scene.skin.layout is None
    assert np.array_equal(scene.sensor_pose, np.eye(4))


def test_a_scene_that_is_no_utf_8_is_named_with_its_line(tmp_path):
    path = write(tmp_path, GOOD)
    path.write_bytes(b"# a comment\n# gr\xfcn\n" + path.read_bytes())
    with pytest.raises(InputError, match=approved_pattern("scene.no_utf8", file=path, line=2)):
        load_scene(path)


KIND = """
[kinds.bar]
pads_mm = [[0, 0], [nan, nan], [4, 0]]
outline_mm = [[-2, -2], [6, -2], [6, 2], [-2, 2]]
centre_pad = 2
"""


def test_an_own_kind_of_module_has_gaps_where_there_is_no_taxel(tmp_path):
    layout = load_scene(write(tmp_path, GOOD, MODULES.replace("triangle_12", "bar") + KIND)).skin.layout
    assert layout is not None
    assert layout.channels.tolist() == [12, 14]
    assert layout.modules[0].centre_channel == 14


ANCHOR = "[skin.anchor]\nat_mm = [0, 0]\npoint_mm = [1, 2, 3]\nx = [2, 0, 0]\nnormal = [0, 0, 1]\n"


def test_an_anchors_directions_are_unit_vectors(tmp_path):
    anchor = load_scene(write(tmp_path, GOOD.replace("[arm]", ANCHOR + "[arm]"))).skin.anchor
    assert anchor is not None
    assert anchor.x.tolist() == [1, 0, 0]
    np.testing.assert_allclose(anchor.point, [1e-3, 2e-3, 3e-3])


def test_the_spacing_is_that_of_the_whole_layout_and_not_of_its_first_module(tmp_path):
    wide = KIND.replace("[4, 0]", "[40, 0]")
    bars = MODULES.replace("triangle_12", "bar").replace("first_channel = 12", "first_channel = 0")
    first = load_scene(write(tmp_path, GOOD, bars + MODULES.replace("id = 5", "id = 6").replace("[1, 2]", "[90, 2]") + wide))
    assert first.skin.layout is not None
    assert first.skin.layout.spacing == pytest.approx(5.0e-3, abs=1e-5)


@pytest.mark.parametrize("modules", [1, 2, 7, 150])
def test_the_spacing_is_the_median_of_the_least_distances_wherever_modules_lie(modules):
    rng, kind = np.random.default_rng(modules), MODULE_KINDS["triangle_12"]
    places = np.round(rng.uniform(-0.3, 0.3, (modules, 2)), 3)
    layout = Layout(
        tuple(Module(at, kind, 12 * at, place, 0.5 * at, False) for at, place in enumerate(places)), 12 * modules
    )  # fmt: skip
    away = np.linalg.norm(layout.places[:, None] - layout.places, axis=-1) + np.diag(np.full(12 * modules, np.inf))
    assert layout.spacing == np.median(away.min(axis=1))


def test_a_channel_has_one_place(tmp_path):
    with pytest.raises(InputError, match=approved_pattern("scene.channel_twice", channel=12, first=5, second=6)):
        load_scene(write(tmp_path, GOOD, MODULES + MODULES.replace("id = 5", "id = 6")))


@pytest.mark.parametrize(
    ("part", "old", "new", "words"),
    [
        (DISTANCES, "[5, 7]", "[5, 8]", ["[[distances]] number 1", approved("scene.no_such_modules", ends="[5, 8]")]),
        (DISTANCES, "[5, 7]", "[5, 5]", [approved("scene.no_such_modules", ends="[5, 5]")]),
        (DISTANCES, "[5, 7]", "[5.5, 7]", ["modules is [5.5, 7.0]", "whole numbers"]),
        (DISTANCES, "[3, 15]", "[13, 15]", ["number 2", approved("scene.no_such_taxels", ends="[13, 15]")]),
        (DISTANCES, "[3, 15]", "[3, 24]", [approved("scene.no_such_taxels", ends="[3, 24]")]),
        (DISTANCES, "modules = [5, 7]", "", ["either modules, two ids, or taxels, two channels"]),
        (DISTANCES, "modules = [5, 7]", "modules = [5, 7]\ntaxels = [3, 15]", ["either modules"]),
        (DISTANCES, "mm = 52.5", "mm = 0", [approved("scene.distance_far", length="0", sd="0.3")]),
        (DISTANCES, "mm = 52.5", "mm = 52500", [approved("scene.distance_far", length="52500", sd="0.3")]),
        (DISTANCES, "sd_mm = 0.3", "sd_mm = 0", [approved("scene.distance_far", length="52.5", sd="0")]),
        (DISTANCES, "sd_mm = 0.3", "", ["sd_mm is missing"]),
        (DISTANCES, "sd_mm = 0.3", "sd_mm = 0.3\nalong = 1", ["unknown name 'along'"]),
        (GOOD, 'name = "bench"', "", ["name is missing", "text"]),
        (GOOD, "channels = 24", "", ["channels is missing", "whole number"]),
        (GOOD, "channels = 24", 'channels = "24"', ["channels is '24'", "whole number"]),
        (GOOD, "channels = 24", "channels = 20", ["takes channels 12 to 23", approved("scene.channels_in_frame", channels=20)]),
        (GOOD, 'polarity = "down"', 'polarity = "left"', ["'left'", "up, down"]),
        (GOOD, 'unit = "mm"', 'unit = "furlong"', ["'furlong'", approved("scene.units")]),
        (GOOD, 'unit = "mm"', "", ["unit is missing"]),
        (GOOD, 'polarity = "down"', 'polarty = "down"', ["unknown name 'polarty'"]),
        (GOOD, "force_min = 3", "sign = -1\nforce_min = 3", ["unknown name 'sign'", "belongs to [wrench]"]),
        (GOOD, "force_min = 3", "force_minimum = 3", ["unknown name 'force_minimum'"]),
        (GOOD, "force_min = 3", "force_min = -3", ["force_min is -3", "above 0"]),
        (GOOD, "force = 0.2", "force = nan", ["force is nan"]),
        (GOOD, "[-1,0,0,0]", "[1,0,0,0]", [approved("scene.no_rigid_pose"), "right-handed"]),
        (GOOD, "[94.0, 0.0]", "[94.0]", ["2 finite numbers", "[94.0]"]),
        (GOOD, 'modules = "m.toml"', 'modules = "n.toml"', ["n.toml", "no such file"]),
        (GOOD, "[skin]", "[skin", [approved("scene.no_toml"), "line"]),
        (GOOD, "channels = 24", "channels = 24\nrange = [255, 0]", ["range is [255.0, 0.0]", approved("scene.range_falls")]),
        (GOOD, "joints = [3, 4]", "joints = [3.5, 4]", ["joints is [3.5, 4.0]", "columns"]),
        (GOOD, "joints = [3, 4]", "joints = [-3, 4]", ["joints is [-3.0, 4.0]", "columns"]),
        (GOOD, "joints = [3, 4]", "joints = []", ["joints is []", "columns"]),
        (GOOD, "joints = [3, 4]", "joints = [3, 4]\ntolerance_deg = -1", ["tolerance_deg is -1", "above 0"]),
        (GOOD, "-0.1373", "-137.3", [approved("scene.dh_long", length=137.3), "divide millimetres by 1000"]),
        (GOOD, "-0.08428", "-84.28", [approved("scene.base_long", length=84.28), "divide millimetres by 1000"]),
        (GOOD, "force_min = 3", "force_min = 20", [approved("scene.forces_fall", least=20, most=15), "expected to rise"]),
        (
            GOOD,
            "force_min = 3",
            "release_force = 2",
            [approved("scene.touch_below_release", release=2, touch=1), "expected to rise"],
        ),
        (GOOD, "joints = [3, 4]", "joints = [1e308, 4]", [approved("scene.joints_far")]),
        (GOOD, "[94.0, 0.0]", "[0.0, -1e308]", [approved("scene.angles_far", key="1", angle="1e+308")]),
        (GOOD, "[94.0, 0.0]", "[3601.0, 0.0]", [approved("scene.angles_far", key="1", angle="3601")]),
        (GOOD, "90.0, -90.0]", "90.0, -1e308]", [approved("scene.angles_far", key="dh", angle="1e+308")]),
        (GOOD, "force_min = 3", "still_s = 1e308", [approved("scene.setting_far", key="still_s", value="1e+308", most="60")]),
        (
            GOOD,
            "force_min = 3",
            "taxels_max = 1" + "0" * 400,
            [approved("scene.whole_number_long", key="taxels_max", digits=401)],
        ),
        (
            GOOD,
            "force = 0.2",
            "force = 1e-320",
            [approved("scene.setting_far", key="force", value="9.99989e-321", most="1e+06")],
        ),
        (GOOD, "force = 0.2", "force = 1" + "0" * 400, [approved("scene.number_long", key="force", digits=401)]),
        (
            GOOD,
            "[noise]",
            "[skin.anchor]\nat_mm=[0,0]\npoint_mm=[0,0,1e308]\nx=[1,0,0]\nnormal=[0,0,1]\n[noise]",
            ["point_mm has"],
        ),
        (
            GOOD,
            "[noise]",
            "[skin.anchor]\nat_mm=[0,0]\npoint_mm=[0,0,1]\nx=[1e308,1e308,0]\nnormal=[0,0,1]\n[noise]",
            ["near 1"],
        ),
        (GOOD, "[noise]", "[sensor]\npose=[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n[noise]", ["exclude each other"]),
        (MODULES, 'kind = "triangle_12"', 'kind = "hexagon"', ["kind is 'hexagon'", approved("scene.known_kinds")]),
        (MODULES, 'kind = "triangle_12"', 'kind = ["triangle_12"]', ["kind is ['triangle_12']", "text"]),
        (MODULES, "id = 5\n", "", ["number 1", "id is missing", "whole number"]),
        (MODULES, "id = 5", 'id = "five"', ["id is 'five'", "whole number"]),
        (MODULES, "first_channel = 12", "first_channel = 1.5", ["(id 5)", "first_channel is 1.5", "whole number"]),
        (MODULES, "first_channel = 12", 'first_channel = "12"', ["first_channel is '12'", "whole number"]),
        (MODULES, "angle_deg", "angle_rad", ["unknown name 'angle_rad'"]),
        (MODULES, "angle_deg = 30", 'angle_deg = "right"', ["angle_deg is 'right'", "a number"]),
        (MODULES, "angle_deg = 30", "angle_deg = nan", ["angle_deg is nan", "finite"]),
        (MODULES, "angle_deg = 30", 'mirror = "no"', ["mirror is 'no'", "true or false"]),
        (MODULES, "place_mm = [1, 2]", "place_mm = [1]", ["place_mm is [1]", "2 finite numbers"]),
        (MODULES, "place_mm = [1, 2]", "place_mm = [1, nan]", ["place_mm is [1, nan]", "2 finite numbers"]),
        (
            MODULES,
            "place_mm = [1, 2]",
            "place_mm = [1e308, 2]",
            [approved("scene.millimetres_far", key="place_mm", longest="1e+308")],
        ),
        (MODULES, MODULES, "modules = 3\n", ["modules is 3", "a list"]),
        (MODULES, MODULES, "modules = [3]\n", ["modules holds 3", "[[modules]]"]),
        (MODULES, MODULES, "", [approved("scene.no_module")]),
        (MODULES, MODULES, MODULES + "[colour]\n", ["unknown name 'colour'"]),
        (MODULES, MODULES, MODULES + MODULES.replace("= 12", "= 0"), [approved("scene.module_twice", module=5)]),
        (KIND, "centre_pad = 2", "centre_pad = 1", ["centre_pad is 1", "[0, 2]"]),
        (KIND, "centre_pad = 2", 'centre_pad = "2"', ["centre_pad is '2'", "whole number"]),
        (KIND, "[4, 0]]", "[4, 0, 1]]", ["pads_mm", "n x 2"]),
        (KIND, "[nan, nan]", "[inf, 0]", ["pads_mm", "n x 2"]),
        (KIND, "centre_pad = 2", "centre_pad = 2\ncolor = 3", ["unknown name 'color'"]),
        (KIND, KIND, "[kinds]\nbar = 3\n", ["bar is 3", "a table"]),
        (ANCHOR, "normal = [0, 0, 1]", "normal = [0, 0, 0]", ["normal is [0.0, 0.0, 0.0]", "not zero"]),
        (ANCHOR, "normal = [0, 0, 1]", "normal = [1, 0, 1]", ["perpendicular"]),
        (ANCHOR, "normal = [0, 0, 1]", "", ["normal is missing"]),
        (ANCHOR, "at_mm = [0, 0]", "at_mm = [nan, 0]", ["at_mm is [nan, 0]", "2 finite numbers"]),
        (ANCHOR, "at_mm = [0, 0]", "at_mm = [0, 0]\ncolor = 3", ["unknown name 'color'"]),
    ],
)
def test_a_fault_is_named(tmp_path, part, old, new, words):
    assert old in part
    changed = part.replace(old, new, 1)
    layout = {MODULES: changed, KIND: MODULES + changed, DISTANCES: MODULES + OTHER}.get(part, MODULES)
    scene = {GOOD: changed, DISTANCES: GOOD + changed, ANCHOR: GOOD.replace("[arm]", changed + "[arm]")}.get(part, GOOD)
    with pytest.raises(InputError) as caught:
        load_scene(write(tmp_path, scene, layout))
    for word in [*words, *(["[anchor]"] if part == ANCHOR else [str(tmp_path / "m.toml")] if part in (MODULES, KIND) else [])]:
        assert word in str(caught.value)
