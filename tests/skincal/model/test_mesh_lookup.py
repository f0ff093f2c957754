"""Names of meshes in a URDF: found inside the robot's package by every usual form of the name, and never outside it."""

import pytest

from skincal.model.errors import InputError
from skincal.model.mesh_lookup import find_mesh
from skincal.model.urdf import read_urdf

URDF = '<robot name="r"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'


def find(urdf, name, **packages):
    urdf.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(URDF.format(name))
    robot = read_urdf(urdf)
    return find_mesh(robot, robot.meshes["a"], packages)


@pytest.fixture
def package(tmp_path):
    """A package whose folder has another name, next to a mesh of somebody else."""
    folder = tmp_path / "MyArm_ROS2"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes/my part.stl").write_text("solid")
    (folder / "package.xml").write_text('<package format="3"><name> my_arm </name></package>')
    (tmp_path / "secret.stl").write_text("solid")
    return folder


@pytest.mark.parametrize(
    "name",
    [
        "package://my_arm/meshes/my part.stl",
        "package:///my_arm/meshes/my part.stl",
        "model://my_arm/robots/../meshes/my part.stl",
        "package://MyArm_ROS2/meshes/my part.stl",
        "../../meshes/my part.stl",
        "..\\..\\meshes\\my part.stl",
        "../../robots/ur/../../meshes/my part.stl",
        "file://{package}/meshes/my part.stl",
        "file://localhost{package}/meshes/my%20part.stl",
        "file:{package}/robots/../meshes/my part.stl",
        "{package}/meshes/my part.stl",
        "file:../../meshes/my part.stl",
        " ../../meshes/my part.stl\n",
    ],
)
def test_a_mesh_of_the_robots_package_is_found(package, name):
    found = find(package / "robots/ur/robot.urdf", name.format(package=package.as_posix()))
    assert found.resolve() == (package / "meshes/my part.stl").resolve()


@pytest.mark.parametrize(
    "name",
    [
        "../../../secret.stl",
        "../../meshes/../../secret.stl",
        "package://my_arm/../secret.stl",
        "package://../secret.stl",
        "file://{outside}/secret.stl",
        "file://somewhere/secret.stl",
        "file://secret.stl",
        "{outside}/secret.stl",
        "{outside}/MyArm_ROS2/../secret.stl",
        "//somewhere/share/secret.stl",
        "\\\\somewhere\\share\\secret.stl",
        "https://somewhere/secret.stl",
        "Z:\\robots\\secret.stl",
        "file:///Z:/robots/secret.stl",
    ],
)
def test_a_mesh_outside_the_package_is_refused(package, name):
    with pytest.raises(InputError, match=r"outside the robot's|expected package://|names the computer"):
        find(package / "robots/ur/robot.urdf", name.format(outside=package.parent.as_posix()))


@pytest.mark.parametrize("folder", ["urdf", "base_urdf", "urdf/ur5", "python"])
def test_the_folder_above_urdf_and_a_python_package_are_the_robots(tmp_path, folder):
    (tmp_path / "lib/arm/meshes").mkdir(parents=True)
    (tmp_path / "lib/arm/meshes/part.stl").write_text("solid")
    (tmp_path / "lib/part.stl").write_text("solid")
    if folder == "python":
        (tmp_path / "lib/arm/__init__.py").write_text("")
    urdf = tmp_path / "lib/arm" / folder / "robot.urdf"
    up = "../" * (folder.count("/") + 1)
    assert find(urdf, f"{up}meshes/part.stl").resolve() == (tmp_path / "lib/arm/meshes/part.stl").resolve()
    with pytest.raises(InputError, match="outside the robot's package"):
        find(urdf, f"{up}../part.stl")
    if folder == "python":
        (tmp_path / "lib/arm/__init__.py").unlink()
        with pytest.raises(InputError, match="outside the robot's package"):
            find(urdf, f"{up}meshes/part.stl")


def test_a_link_to_the_urdf_has_the_folders_of_both(package):
    """`colcon build --symlink-install` links the files of a package."""
    source = package / "urdf/robot.urdf"
    find(source, "../meshes/my part.stl")
    shared = package.parent / "install/share/my_arm/urdf"
    shared.mkdir(parents=True)
    (shared / "robot.urdf").symlink_to(source)
    robot = read_urdf(shared / "robot.urdf")
    assert find_mesh(robot, robot.meshes["a"], {}).resolve() == (package / "meshes/my part.stl").resolve()


def test_the_advice_on_a_missing_package_or_file_is_right(tmp_path, package):
    urdf = tmp_path / "alone/robot.urdf"
    with pytest.raises(InputError, match=r"--package my_arm=FOLDER, or \[robot\.packages\]"):
        find(urdf, "package://my_arm/meshes/my part.stl")
    assert find(urdf, "package://my_arm/meshes/my part.stl", my_arm=package).is_file()
    with pytest.raises(InputError, match=r"it is not in .*MyArm_ROS2: copy it there") as refused:
        find(package / "urdf/robot.urdf", "package://my_arm/gone.stl")
    assert "--package" not in str(refused.value), "its folder is known"
    (package / "gone.stl").write_text("solid")
    assert find(package / "urdf/robot.urdf", "package://my_arm/gone.stl").is_file()


@pytest.mark.parametrize("text", ["", "<package>", "<package/>", "<!DOCTYPE p><package><name>my_arm</name></package>"])
def test_a_package_file_that_names_nothing_is_no_package_of_that_name(package, text):
    (package / "package.xml").write_text(text)
    with pytest.raises(InputError, match="is not found"):
        find(package / "urdf/robot.urdf", "package://my_arm/meshes/my part.stl")


@pytest.mark.parametrize("name", ["$(find my_arm)/meshes/my part.stl", "package://$(arg name)/part.stl", "${folder}/part.stl"])
def test_an_expression_of_xacro_is_named(package, name):
    with pytest.raises(
        InputError, match=r"an expression of xacro in it; make the URDF again \(xacro FILE\.xacro > robot\.urdf\)"
    ):
        find(package / "urdf/robot.urdf", name)


def test_the_advice_on_capital_letters_is_right(package):
    if (package / "meshes/MY PART.stl").exists():
        pytest.skip("this disk does not distinguish capital letters")
    for name in ("../meshes/My Part.STL", "package://my_arm/meshes/My Part.STL"):
        with pytest.raises(InputError, match=r"is not found; my part\.stl is there: correct the capital letters in the URDF"):
            find(package / "urdf/robot.urdf", name)
        assert find(package / "urdf/robot.urdf", name.replace("My Part.STL", "my part.stl")).is_file()
