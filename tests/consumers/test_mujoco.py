"""MuJoCo reads the sites on the public iCub, and a pressed site answers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.files.formats import ExportOptions, Inertia
from tests.consumers.robots import LINK, Skin, assert_taxels_are_right, icub_urdf, read_kinematics

mujoco = pytest.importorskip("mujoco", reason="mujoco has no wheel for this system")
# With an empty prefix the names stay as they are in the file; MuJoCo 4 warns of it, and saves the model all the same.
pytestmark = pytest.mark.filterwarnings("ignore:Attaching a spec with an empty prefix")

BODY = "r_forearm"
"""The body with the forearm's geoms: MuJoCo fuses links on fixed joints of a URDF into it."""
BALL_RADIUS_M = 0.004
PRESS_N = 5.0
PRESS_S = 0.4


@pytest.fixture(autouse=True)
def work_in_a_folder_of_its_own(tmp_path, monkeypatch):
    """MuJoCo writes its warnings into a file of the working folder."""
    monkeypatch.chdir(tmp_path)


def pose_in_body(icub) -> np.ndarray:
    mine = read_kinematics(icub)
    still = dict.fromkeys(mine.moving, 0.0)
    return np.linalg.inv(mine.pose(BODY, still)) @ mine.pose(LINK, still)


def icub_with_skin(skin: Skin, icub, tmp_path, prefix: str | None = None):
    """Attach the export to the iCub as the comment in the file says."""
    spec, pose = mujoco.MjSpec.from_file(str(icub)), pose_in_body(icub)
    attach(spec, skin.write("mjcf", tmp_path / f"{prefix}.xml", ExportOptions(prefix=prefix)), pose, prefix)
    return spec, pose


def attach(spec, path, pose, prefix: str | None = None):
    name = f"{LINK}_skin" if prefix is None else f"{prefix}skin"
    assert f'body.attach_frame(MjSpec.from_file("THIS FILE").frame("{name}"), "", "")' in path.read_text()
    frame = spec.body(BODY).attach_frame(mujoco.MjSpec.from_file(str(path)).frame(name), "", "")
    frame.pos = pose[:3, 3]
    frame.quat = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)


def poses(data, names, of: str = "site") -> dict[str, np.ndarray]:
    found = {}
    for name in names:
        place = getattr(data, of)(name)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = place.xmat.reshape(3, 3), place.xpos
        found[name] = matrix
    return found


def at_angles(model, angles):
    data = mujoco.MjData(model)
    for joint, angle in angles.items():
        data.joint(joint).qpos = angle
    mujoco.mj_forward(model, data)
    return data


def test_every_site_is_on_the_icub(skin: Skin, icub, tmp_path):
    before, mine = mujoco.MjSpec.from_file(str(icub)).compile(), read_kinematics(icub)
    model = icub_with_skin(skin, icub, tmp_path)[0].compile()
    assert (model.nv, model.nbody) == (before.nv, before.nbody)
    assert model.body_mass.sum() == before.body_mass.sum()
    for seed in range(4):
        angles = mine.random_angles(seed)
        data = at_angles(model, angles)
        assert_taxels_are_right(poses(data, skin.names()), skin, mine.pose(LINK, angles))
    assert [model.sensor(i).name for i in range(model.nsensor)] == skin.names()


def test_two_skins_of_one_robot_are_attached(skin: Skin, icub, tmp_path):
    spec, pose = icub_with_skin(skin, icub, tmp_path)
    attach(spec, skin.write("mjcf", tmp_path / "second.xml", ExportOptions(prefix="second_")), pose, "second_")
    model = spec.compile()
    assert model.nsite == model.nsensor == 2 * len(skin.channels)
    # The model is saved and read back with every name.
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert {again.site(i).name for i in range(again.nsite)} == {*skin.names(), *skin.names("second_")}


def test_xml_attaches_the_skin_as_its_comment_says(skin: Skin, tmp_path):
    path = skin.write("mjcf", tmp_path / "skin.xml")
    asset = f'<model name="{LINK}_skin" file="THIS FILE"/>'
    attach_ = f'<attach model="{LINK}_skin" frame="{LINK}_skin" prefix=""/>'
    assert asset in path.read_text()
    assert attach_ in path.read_text()
    robot = tmp_path / "robot.xml"
    robot.write_text(
        f"<mujoco><asset>{asset.replace('THIS FILE', 'skin.xml')}</asset><worldbody><body name='arm' pos='1 2 3'>"
        f"<geom size='0.1'/><frame pos='0 0 1'>{attach_}</frame></body></worldbody></mujoco>"
    )
    model = mujoco.MjModel.from_xml_path(str(robot))
    pose = np.eye(4)
    pose[:3, 3] = [1, 2, 4]
    assert_taxels_are_right(poses(at_angles(model, {}), skin.names()), skin, pose)
    assert {model.body(number).name for number in model.site_bodyid} == {"arm"}


def press(skin: Skin, spec, pose) -> np.ndarray:
    """Press a ball onto each taxel; return the (balls, sensors) forces after `PRESS_S`, newton."""
    mesh = skin.part.scene.surface
    assert mesh is not None
    body = spec.body(BODY)
    quat = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    spec.add_mesh(name="shape", file=str(mesh.path), scale=[1e-3] * 3)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="shape", pos=pose[:3, 3], quat=quat, mass=0)
    ball = spec.worldbody.add_body(name="ball")
    ball.add_joint(name="push", type=mujoco.mjtJoint.mjJNT_SLIDE, damping=1.0)
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_RADIUS_M] * 3, mass=0.05)
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    push = model.joint("push")
    # The arm is held, as by its motors.
    model.dof_damping[: push.dofadr[0]] = 1e6
    forces = []
    for name in skin.names():
        site = at_angles(model, {}).site(name)
        normal = site.xmat.reshape(3, 3)[:, 2]
        model.body("ball").pos, push.axis = site.xpos + BALL_RADIUS_M * normal, -normal
        data = at_angles(model, {})
        data.qfrc_applied[push.dofadr[0]] = PRESS_N
        mujoco.mj_step(model, data, int(PRESS_S / model.opt.timestep))
        forces.append(data.sensordata.copy())
    return np.array(forces)


@pytest.mark.parametrize("is_fused", [True, False], ids=["as URDF", "as MJCF"])
def test_a_pressed_site_answers_with_the_force_and_no_other(skin: Skin, icub, tmp_path, is_fused):
    spec, pose = icub_with_skin(skin, icub, tmp_path)
    spec.compiler.fusestatic = is_fused
    forces = press(skin, spec, pose)
    own = np.diag(forces)
    np.testing.assert_allclose(own, PRESS_N, rtol=0.02)
    assert np.abs(forces - np.diag(own)).max() == 0.0


def test_sites_of_an_attached_body_stay_silent(skin: Skin, icub, tmp_path):
    """The reason for the frame: if this changes, the comment in the file can be shorter."""
    spec, pose = mujoco.MjSpec.from_file(str(icub)), pose_in_body(icub)
    # The default of MJCF.
    spec.compiler.fusestatic = False
    spec.body(LINK).name = "renamed"
    child = mujoco.MjSpec.from_file(str(skin.write("mjcf", tmp_path / "skin.xml")))
    holder = spec.body(BODY).add_frame(pos=pose[:3, 3], quat=Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True))
    holder.attach_body(child.body(LINK), "", "")
    assert press(skin, spec, pose).max() == 0.0


@pytest.mark.parametrize("inertia", list(Inertia))
def test_urdf_alone_keeps_every_name(skin: Skin, tmp_path, inertia):
    path = skin.write("urdf", tmp_path / "out.urdf", ExportOptions(inertia=inertia))
    model = mujoco.MjModel.from_xml_path(str(path))
    found = poses(at_angles(model, {}), skin.names(), "body")
    assert_taxels_are_right(found, skin, np.eye(4))


def test_the_icub_as_shipped_loads_with_the_remedy_of_the_manual():
    path = icub_urdf()
    with pytest.raises(ValueError, match="package:"):
        mujoco.MjModel.from_xml_path(str(path))
    spec = mujoco.MjSpec.from_file(str(path))
    spec.strippath = True
    mesh = next(path.parents[2].rglob("*.stl"))
    spec.meshdir = str(mesh.parent)
    assert spec.compile().nv == 32
