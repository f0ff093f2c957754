"""Names of a pose's columns: those that cannot be one pose are refused, the usual ones of programs and robots are not."""

from __future__ import annotations

import pytest

from skincal.devices.pose_names import PoseMistake, PoseNames, axis_letters
from skincal.model.pose_form import PoseForm, RotationForm


@pytest.mark.parametrize(
    "names",
    [
        "a_x a_y a_z b_x b_y b_z",
        "lasi:x lasi:y lasi:z rasi:x rasi:y rasi:z",
        "marker1.x marker1.y marker1.z marker2.x marker2.y marker2.z",
        "hand_x_[mm] hand_y_[mm] hand_z_[mm] foot_x_[mm] foot_y_[mm] foot_z_[mm]",
        "x_a y_a z_a x_b y_b z_b",
        "x_(mm) y_(mm) z_(mm) x2_(mm) y2_(mm) z2_(mm)",
        "x_l y_l z_l x_m y_m z_m",
        "x1 y1 z1 x2 y2 z2",
        "x1 x2 y1 y2 z1 z2",
        "x_1 y_1 z_1 x_2 y_2 z_2",
        "p1_x p1_y p1_z p2_x p2_y p2_z",
        "x y z x.1 y.1 z.1",
        "x y z vx vy vz",
        "hipx hipy hipz kneex kneey kneez",
        "left_pos_x left_pos_y left_pos_z right_pos_x right_pos_y right_pos_z",
        "x1 y1 z1 x2 y2 z2 gap",
        "x1 y1 z1 x2 y2 z2 x3 y3 z3 x4 y4 z4",
        "a_x a_y a_z b_x b_y b_z c_x c_y c_z d_x d_y d_z",
        "r1_x r1_y r1_z r2_x r2_y r2_z r3_x r3_y r3_z r4_x r4_y r4_z",
    ],
)
def test_places_of_several_things_are_no_pose(names):
    assert PoseNames.read(names.split()).mistake is PoseMistake.SEVERAL_PLACES


@pytest.mark.parametrize(
    "names",
    [
        "hand_x hand_y hand_z arm_rx arm_ry arm_rz",
        "hand_x hand_y hand_z hand2_rx hand2_ry hand2_rz",
        "hand.pos.x hand.pos.y hand.pos.z head.roll head.pitch head.yaw",
        "a_x a_y a_z b_x b_y b_z b_w",
        "hand_x hand_y hand_z arm_qx arm_qy arm_qz arm_qw",
        "x1 y1 z1 rx2 ry2 rz2",
        "l_x l_y l_z r_x r_y r_z",
        "lx ly lz rx ry rz",
        "l_hand_x l_hand_y l_hand_z r_hand_x r_hand_y r_hand_z",
    ],
)
def test_the_place_of_one_thing_and_the_rotation_of_another_are_no_pose(names):
    assert PoseNames.read(names.split()).mistake is PoseMistake.SEVERAL_THINGS


@pytest.mark.parametrize(
    ("names", "mistake"),
    [
        ("x y z qx qy qz", PoseMistake.QUATERNION_WITHOUT_W),
        ("rot_x rot_y rot_z pos_x pos_y pos_z", PoseMistake.ROTATION_FIRST),
        ("qw qx qy qz x y z", PoseMistake.ROTATION_FIRST),
        ("q0 qx qy qz tx ty tz", PoseMistake.ROTATION_FIRST),
        ("q1 q2 q3 q4 x y z", PoseMistake.ROTATION_FIRST),
        ("x y z q1 q2 q3", PoseMistake.QUATERNION_WITHOUT_W),
        ("x y z w x y z", PoseMistake.QUATERNION_ON_EITHER_SIDE),
        ("x y z w x.1 y.1 z.1", PoseMistake.QUATERNION_ON_EITHER_SIDE),
        ("x_pos x_rot y_pos y_rot z_pos z_rot", PoseMistake.PLACE_NOT_FIRST),
        ("z y x rz ry rx", PoseMistake.PLACE_NOT_FIRST),
    ],
)
def test_a_part_that_is_missing_or_elsewhere_is_named(names, mistake):
    assert PoseNames.read(names.split()).mistake is mistake


@pytest.mark.parametrize(
    "names",
    [
        "x y z rx ry rz",
        "tcp_x tcp_y tcp_z tcp_rx tcp_ry tcp_rz",
        "tcp_x tcp_y tcp_z rx ry rz",
        "px py pz rx ry rz",
        "tx ty tz rx ry rz",
        "x_[mm] y_[mm] z_[mm] a_[deg] b_[deg] c_[deg]",
        "x y z a b c",
        "x y z o a t",
        "tcp_x tcp_y tcp_z alpha beta gamma",
        "x y z roll pitch yaw",
        "hand.pos.x hand.pos.y hand.pos.z hand.roll hand.pitch hand.yaw",
        "pose.position.x pose.position.y pose.position.z "
        "pose.orientation.x pose.orientation.y pose.orientation.z pose.orientation.w",
        "tcp_pose_x tcp_pose_y tcp_pose_z tcp_orientation_x tcp_orientation_y tcp_orientation_z",
        "x_pos y_pos z_pos x_rot y_rot z_rot",
        "posx posy posz rotx roty rotz",
        "handposx handposy handposz handrotx handroty handrotz",
        "ee.x ee.y ee.z ee.wx ee.wy ee.wz",
        "position.x position.y position.z eulerangles.x eulerangles.y eulerangles.z",
        "x y z eul_x eul_y eul_z",
        "tx ty tz q0 qx qy qz",
        "trans.x trans.y trans.z rot.q1 rot.q2 rot.q3 rot.q4",
        "q1 q2 q3 q4 q5 q6",
        "r_hand_x r_hand_y r_hand_z r_hand_rx r_hand_ry r_hand_rz",
        "x1 y1 z1 rx1 ry1 rz1",
        "e_x e_y e_z q_x q_y q_z q_w",
        "p_x p_y p_z o_x o_y o_z o_w",
        "x y z ax ay az theta",
        "x y z a b c d",
        "x0 x1 x2 x3 x4 x5",
        "p1 p2 p3 p4 p5 p6",
        "w1 w2 w3 w4 w5 w6 w7",
        "nx ny nz ox oy oz ax ay az px py pz",
        "nx ox ax px ny oy ay py nz oz az pz",
        "x y z xx xy xz yx yy yz zx zy zz",
        "x y z rxx rxy rxz ryx ryy ryz rzx rzy rzz",
        "x y z r1x r1y r1z r2x r2y r2z r3x r3y r3z",
        "x y z r11 r12 r13 r21 r22 r23 r31 r32 r33",
    ],
)
def test_the_usual_names_of_one_pose_are_taken(names):
    assert PoseNames.read(names.split()).mistake is None


def test_letters_are_found_at_the_end_in_front_and_before_a_number():
    assert axis_letters(["tcp_x", "y_pos", "z1", "quat_w_[m]", "xaxis_z", "speed"]) == ["x", "y", "z", "w", "z", ""]
    assert axis_letters(["x0", "x1", "x2"]) == ["", "", ""], "a vector that is called x"


@pytest.mark.parametrize(
    ("names", "order"),
    [("tx ty tz q0 qx qy qz", "wxyz"), ("x y z qx qy qz qw", "xyzw"), ("x y z q0 q1 q2 q3", "")],
)
def test_the_order_of_a_quaternion_is_read_from_its_letters(names, order):
    """NDI's q0 is w; of four numbers w is the first or the last one."""
    assert PoseNames.read(names.split()).quaternion_order == order


@pytest.mark.parametrize(
    ("names", "order", "right", "wrong"),
    [
        ("x y z roll pitch yaw", "xyz", RotationForm.RPY, RotationForm.ABC),
        ("x y z yaw pitch roll", "zyx", RotationForm.ABC, RotationForm.RPY),
        ("tx ty tz rz ry rx", "zyx", RotationForm.ABC, RotationForm.ROTATION_VECTOR),
        ("tcp_x tcp_y tcp_z tcp_rx tcp_ry tcp_rz", "xyz", RotationForm.ROTATION_VECTOR, RotationForm.ABC),
        ("x y z a b c", "", RotationForm.ABC, None),
    ],
)
def test_the_order_of_angles_is_compared(names, order, right, wrong):
    found = PoseNames.read(names.split())
    assert found.angle_order == order
    assert found.clash(PoseForm(right, degrees=False), 1.0) is None
    if wrong is not None:
        clash = (f"the angles in the order {' '.join(order)}", "rotation", wrong.value)
        assert found.clash(PoseForm(wrong, degrees=False), 1.0) == clash
