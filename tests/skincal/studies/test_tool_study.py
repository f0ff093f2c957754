"""The study of a tool on a still part, on few pokes."""

import numpy as np

from skincal.simulation.example_parts import forearm
from skincal.studies.tool_simulator import NO_LANDMARK, TOOL_RIGS, simulate_tool_session
from skincal.studies.tool_study import BASE_ALONE, POSE_GIVEN, THIS_STUDY, ToolCase, contacts_of, scene_of
from tests.skincal.studies.studies_support import small


def by_case(result):
    return {ToolCase(row["rig"], row["known"], row["landmarks"], row["mesh"]): row["methods"] for row in result["tool"]}


def test_a_rig_without_errors_is_calibrated_within_its_prediction():
    result, said = small("tool")
    ideal = by_case(result)["ideal", POSE_GIVEN, 0, True]
    assert ideal["modules"]["mean_mm"][1] < 0.6
    assert ideal["modules"]["inside"][1] > 0.9
    assert any("ideal, part's pose given" in line for line in said)
    assert any("modules:" in line for line in THIS_STUDY.summary(result))


def test_without_a_mesh_the_base_or_the_part_gives_the_same_errors():
    result, _ = small("tool")
    rows = by_case(result)
    base, part = (rows["wrist", known, 0, False]["free"]["mean_mm"] for known in (BASE_ALONE, POSE_GIVEN))
    np.testing.assert_allclose(base, part, rtol=1e-3)


def test_contacts_carry_the_sensors_pose_into_the_part():
    part = forearm()
    poked = simulate_tool_session(part.scene, part.surface.vertices, part.surface.triangles, TOOL_RIGS["ideal"], 3, (2, 30))
    contacts = contacts_of(poked, scene_of(ToolCase("ideal", POSE_GIVEN, 2, has_mesh=True), poked))
    true = poked.contact[poked.landmark == NO_LANDMARK]
    for contact, place in zip(contacts, true, strict=True):
        turn, origin = contact.link_from_sensor[:3, :3], contact.link_from_sensor[:3, 3]
        force = turn @ contact.force
        np.testing.assert_allclose(turn @ contact.moment, np.cross(place - origin, force), atol=1e-12)
