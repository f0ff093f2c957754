import csv
import json
import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.files.atomic import write_atomically
from skincal.files.export import CONTACT_UNITS, NOISE_UNITS, json_text, ply_text, write_calibration
from skincal.files.formats import ExportOptions
from skincal.files.frames import mjcf_text, sdf_text, urdf_text
from skincal.files.icub import icub_text, skin_part
from skincal.mesh.lay import place_layout
from skincal.mesh.load import load_surface
from skincal.methods import estimate_taxels
from skincal.model.errors import InputError
from skincal.model.scene import ContactSettings, NoiseSettings
from skincal.modules.pose import ModuleModel
from skincal.rig.correction import FRAME, Correction, UsedCorrection
from skincal.session.session import Session
from skincal.taxels.result import Estimate, Method, Rival, State, StateReason
from skincal.taxels.shared_errors import predicted_error
from skincal.words.taxel_words import predicted_words, state_sentence
from tests.approved import approved, approved_pattern
from tests.skincal.files.files_support import make_calibration, make_contacts, make_part
from tests.skincal.files.json_reader import read_json
from tests.skincal.taxels.test_solve_walls import plate_scene


def same(one: object, other: object) -> bool:
    """Equal bit for bit, NaN included; of a reason a file keeps the sentence."""
    if isinstance(one, StateReason):
        return state_sentence(one) == state_sentence(other)
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and one.tobytes() == other.tobytes()
    if isinstance(one, float) and math.isnan(one):
        return isinstance(other, float) and math.isnan(other)
    return one == other


def fields_of(value: object) -> list[object]:
    values = [getattr(value, name) for name in value.__slots__]
    return [item for each in values for item in (fields_of(each) if isinstance(each, Rival) else [each])]


def test_json_gives_contacts_and_estimates_back_bit_for_bit(part, tmp_path):
    calibration = make_calibration(part, unseen=(5,), blind=(2,))
    write_calibration(calibration, "json", tmp_path / "c.json", Method.FREE)
    file = read_json(tmp_path / "c.json")
    for contact, other in zip(calibration.contacts, file.contacts, strict=True):
        assert all(same(a, b) for a, b in zip(fields_of(contact), fields_of(other), strict=True))
    assert set(file.estimates) == set(Method)
    for method, estimates in calibration.estimates.items():
        for estimate, other in zip(estimates, file.estimates[method], strict=True):
            assert all(same(a, b) for a, b in zip(fields_of(estimate), fields_of(other), strict=True))
    assert file.frame == "r_forearm_dh_frame"
    assert file.scene_text == part.scene.text
    assert file.modules_text == (part.scene.path.parent / "modules.toml").read_text()
    assert file.mesh_sha256 == calibration.mesh_sha256
    assert file.mesh_findings
    assert (file.excluded, dict(file.dead)) == ((3,), {40: "always on"})
    assert file.noise == NoiseSettings(force=0.2)
    assert file.contact_settings == ContactSettings()


def test_what_is_read_back_solves_to_the_same_bits(part, tmp_path):
    """The file alone is enough to compute it again."""
    scene = part.scene
    assert scene.surface is not None
    surface, _ = load_surface(scene.surface)
    contacts = make_contacts(part, 80, seed=9)
    channels, dead = [0, 1, 2, 3, 5], {3: "always on"}
    used = [contact for contact in contacts if contact.poke not in (4, 11)]
    assert scene.skin.layout is not None
    boards = ModuleModel(scene.skin.layout, scene.skin.anchor, surface)
    solved = estimate_taxels(used, channels, list(Method), scene.noise, surface, dead, model=boards)
    estimates = {method: tuple(found.values()) for method, found in solved.items()}
    assert any(e.state is State.TOUCHED for e in estimates[Method.FREE])
    calibration = replace(
        make_calibration(part), channels=channels, estimates=estimates, contacts=contacts, excluded=(4, 11), dead=dead
    )
    write_calibration(calibration, "json", tmp_path / "c.json", Method.SURFACE)
    file = read_json(tmp_path / "c.json")
    solved = estimate_taxels(file.used_contacts, file.channels, list(Method), file.noise, surface, file.dead, model=boards)
    for method, again in solved.items():
        for estimate, other in zip(file.estimates[method], again.values(), strict=True):
            assert all(same(a, b) for a, b in zip(fields_of(estimate), fields_of(other), strict=True))


def test_json_has_no_nan_and_names_its_units(part):
    text = json_text(make_calibration(part))

    def refuse(word: str) -> None:
        raise AssertionError(word)

    document = json.loads(text, parse_constant=refuse)
    assert document["contacts"][4]["tare_change_N"] is None
    assert document["noise"] == {
        "force_N": 0.2, "moment_Nm": 0.01, "contact_m": 0.0015, "reach_m": 0.0025, "radius_m": 0.03, "skin_m": 0.0015,
        "pose_turn_rad": 0.0, "pose_shift_m": 0.0,
    }  # fmt: skip
    assert document["skincal_version"] == "0.1.0"
    gains = [each["gain"] for each in document["estimates"]["surface"]]
    assert gains[0]["raw_per_N"] > 0
    assert gains[-1] == {"pokes": 0, "raw_per_N": None, "sd_raw_per_N": None}


def test_gains_are_of_the_pokes_that_count_as_they_are_corrected(part):
    calibration = make_calibration(part)
    assert [contact.poke for contact in calibration.used_contacts] == [poke for poke in range(1, 61) if poke != 3]
    plain = replace(calibration, excluded=()).gains(Method.SURFACE)
    assert sum(gain.pokes for gain in plain) == sum(gain.pokes for gain in calibration.gains(Method.SURFACE)) + 1
    # A sensor that reports half the force: there is twice as much of it for the same answers.
    doubled = UsedCorrection(FRAME, Correction(2.0 * np.eye(6)), 0.01, 0.001, pokes=21)
    for gain, other in zip(
        calibration.gains(Method.SURFACE), replace(calibration, corrections=(doubled,)).gains(Method.SURFACE), strict=True
    ):
        assert other.mean == (None if gain.mean is None else pytest.approx(gain.mean / 2, rel=1e-12))


def test_every_setting_has_a_unit():
    assert list(CONTACT_UNITS) == list(ContactSettings.__slots__)
    assert list(NOISE_UNITS) == list(NoiseSettings.__slots__)


def test_csv_has_a_row_a_channel_and_method(part, tmp_path):
    calibration = make_calibration(part, unseen=(5,), blind=(13,))
    said = write_calibration(calibration, "csv", tmp_path / "c.csv", Method.FREE)
    text = (tmp_path / "c.csv").read_text()
    assert text.splitlines()[0] == (
        "channel,module,method,state,contacts,x_m,y_m,z_m,nx,ny,nz,sd_mm,gain_raw_per_N,gain_sd_raw_per_N,gain_pokes,normal_sd_deg"
    )
    gains = calibration.gains(Method.FREE)
    for gain, row in zip(gains, csv.DictReader(text.splitlines()), strict=False):
        told = [row[name] for name in ("gain_raw_per_N", "gain_sd_raw_per_N", "gain_pokes")]
        assert told == [
            "" if gain.mean is None else repr(gain.mean),
            "" if gain.spread is None else repr(gain.spread),
            str(gain.pokes),
        ]
    assert any(gain.mean is not None for gain in gains)
    assert any(gain.mean is None for gain in gains)
    rows = list(csv.DictReader(text.splitlines()))
    layout = part.scene.skin.layout
    assert layout is not None
    assert [(row["method"], int(row["channel"])) for row in rows] == [
        (method.value, channel) for method in Method for channel in layout.channels.tolist()
    ]
    for row in rows:
        channel = int(row["channel"])
        assert row["module"] == ("17" if channel < 12 else "21" if channel < 24 else "25")
        vectors = [row[name] for name in ("x_m", "y_m", "z_m", "nx", "ny", "nz", "sd_mm")]
        if channel in (5, 13):
            assert vectors == [""] * 7
            assert row["state"] == ("untouched" if channel == 5 else "undetermined")
        else:
            assert [float(word) for word in vectors] == [*part.places[channel], *part.normals[channel], 1.0]
            assert (row["state"], row["contacts"]) == ("touched", "7")
    counted = approved("export.no_position", count=2, all=34, states="1 undetermined, 1 untouched")
    assert said == (f"free: {counted}", f"surface: {counted}", f"modules: {counted}")


def test_ply_holds_the_known_taxels(part, tmp_path):
    import trimesh

    calibration = make_calibration(part, unseen=(5,))
    said = write_calibration(calibration, "ply", tmp_path / "c.ply", Method.SURFACE)
    assert said == ("surface: " + approved("export.no_position", count=1, all=34, states="1 untouched"),)
    cloud = trimesh.load(tmp_path / "c.ply")
    layout = part.scene.skin.layout
    assert layout is not None
    known = np.setdiff1d(layout.channels, [5])
    np.testing.assert_allclose(np.asarray(cloud.vertices), part.places[known], atol=1e-8)
    rows = np.loadtxt((tmp_path / "c.ply").read_text().partition("end_header\n")[2].splitlines())
    np.testing.assert_allclose(rows[:, 3:6], part.normals[known], atol=1e-7)
    np.testing.assert_array_equal(rows[:, 6], known)
    np.testing.assert_array_equal(rows[:, 7:], [[1, 1.0, 1.0, 0]] * len(known))


def test_ply_of_a_taxel_without_normal_and_sd(part, tmp_path):
    bare = Estimate(0, Method.FREE, State.TOUCHED, 2, position=np.array([0.1, 0.2, 0.3]))
    calibration = replace(make_calibration(part), estimates={Method.FREE: (bare,)})
    write_calibration(calibration, "ply", tmp_path / "c.ply", Method.FREE)
    assert (tmp_path / "c.ply").read_text().splitlines()[-1] == "0.1 0.2 0.3 0 0 0 0 0 -1 -1 0"


def test_icub_says_what_is_left_out_and_the_last_row(part, tmp_path):
    said = write_calibration(make_calibration(part, unseen=(5,), blind=(2,)), "icub", tmp_path / "p.txt", Method.FREE)
    assert said[0] == "free: " + approved("export.no_position", count=2, all=34, states="1 undetermined, 1 untouched")
    assert said[1].startswith(approved("export.last_row_dropped", channel=47))
    assert len(said) == 2
    assert write_calibration(make_calibration(part, unseen=(47,)), "icub", tmp_path / "q.txt", Method.FREE)[1:] == ()
    assert (tmp_path / "p.txt").read_text().startswith("name               r_forearm\n")


def test_a_part_that_the_robot_does_not_know_is_said(part, tmp_path):
    said = write_calibration(make_calibration(part), "icub", tmp_path / "p.txt", Method.FREE, ExportOptions(part="elbow"))
    assert any(approved("export.unknown_part", part="elbow") in sentence for sentence in said)


def test_hints_for_the_icub_come_with_its_parts_and_with_its_format_alone(part, tmp_path):
    of_icub = make_calibration(part)
    other = replace(of_icub, scene=replace(of_icub.scene, link="plate"))
    dropped = approved("export.last_row_dropped", channel=47)

    def said(calibration, **options):
        return " ".join(write_calibration(calibration, "icub", tmp_path / "p.txt", Method.FREE, ExportOptions(**options)))

    name = approved("export.unknown_part", part=skin_part(other))
    for hint in (name, dropped):
        assert hint in said(other)
        assert hint not in said(other, is_asked=False)
    assert dropped in said(of_icub, is_asked=False)
    assert approved("export.unknown_part", part="elbow") in said(other, part="elbow", is_asked=False)


def test_a_taxel_whose_digits_round_to_the_origin_is_said(part, tmp_path):
    calibration = make_calibration(part)
    items = tuple(replace(e, position=np.full(3, 4e-7)) if e.channel == 1 else e for e in calibration.estimates[Method.FREE])
    moved = replace(calibration, estimates={Method.FREE: items})
    said = write_calibration(moved, "icub", tmp_path / "p.txt", Method.FREE)
    assert any(sentence.startswith(approved("lint.at_origin", channels=1)) for sentence in said)


def test_a_mesh_that_changed_or_went_is_said_and_the_file_written(tmp_path):
    part = make_part(tmp_path / "part")
    calibration = make_calibration(part)
    mesh = part.scene.path.parent / "tube.obj"
    mesh.write_text(mesh.read_text() + "# touched\n")
    said = write_calibration(calibration, "icub", tmp_path / "p.txt", Method.FREE)
    assert approved("export.mesh_changed") in said[0]
    layout = part.scene.path.parent / "modules.toml"
    text = layout.read_text(encoding="utf-8")
    layout.unlink()
    write_calibration(calibration, "json", tmp_path / "c.json", Method.FREE)
    assert read_json(tmp_path / "c.json").modules_text == text, "the layout is written as it was used"
    mesh.unlink()
    said = write_calibration(calibration, "icub", tmp_path / "p.txt", Method.FREE)
    assert approved("export.shape_not_compared") in said[0]
    assert (tmp_path / "p.txt").exists()


def test_a_method_without_estimates_is_refused(part, tmp_path):
    calibration = make_calibration(part)
    free = replace(calibration, estimates={Method.FREE: calibration.estimates[Method.FREE]})
    with pytest.raises(InputError, match=approved_pattern("export.no_estimates", method="surface", others="free")):
        write_calibration(free, "csv", tmp_path / "c", Method.SURFACE)
    assert list(tmp_path.iterdir()) == []


def test_no_reader_ever_sees_a_half_file(tmp_path):
    path = tmp_path / "p.txt"
    texts = {b"a" * 200_000, b"b" * 300_000}
    write_atomically(path, b"a" * 200_000)
    seen: set[bytes] = set()
    stop = threading.Event()

    def look() -> None:
        while not stop.is_set():
            seen.add(path.read_bytes())

    thread = threading.Thread(target=look)
    thread.start()
    try:
        for _ in range(10):
            for text in texts:
                write_atomically(path, text)
    finally:
        stop.set()
        thread.join()
    assert seen <= texts


def test_a_missing_folder_and_a_folder_in_the_way_are_refused(tmp_path):
    with pytest.raises(InputError, match=approved_pattern("export.no_folder", path=tmp_path / "none")):
        write_atomically(tmp_path / "none" / "p.txt", b"")
    (tmp_path / "taken").mkdir()
    with pytest.raises(InputError, match=approved_pattern("export.is_folder")):
        write_atomically(tmp_path / "taken", b"")


def test_a_file_that_takes_the_place_of_an_older_one_says_where_that_is(part, tmp_path):
    calibration = make_calibration(part)
    path = tmp_path / "p.csv"
    assert not any("is kept as" in said for said in write_calibration(calibration, "csv", path, Method.FREE))
    for number in ("", "-2"):
        said = write_calibration(calibration, "csv", path, Method.FREE)
        assert said[-1] == approved("export.older", name="p.csv", kept=f"p.csv.bak{number}")


def test_what_was_checked_and_what_could_not_be_stands_in_the_files(part):
    words = "Not finished: 3 of 84 taxels are finished. Landmarks agree"
    made = make_calibration(part)
    calibration = replace(made, verdicts={Method.SURFACE: words}, unmodelled_rig_error_m={Method.SURFACE: 0.0071})
    written = json.loads(json_text(calibration))
    assert written["verdicts"] == {"surface": words}
    assert written["predicted_errors"]["surface"]["unchecked_rig_m"] == 0.0071
    found = made.predicted_error(Method.SURFACE)
    mean, worst = f"{found.mean * 1e3:.1f}", f"{found.worst * 1e3:.1f}"
    error = approved("rig.predicted_without_arm", mean_mm=mean, worst_mm=worst, unchecked_mm="7.1")
    for said in (words, f"predicted error: {error}"):
        assert f"comment {said}" in ply_text(calibration, Method.SURFACE).splitlines()
        assert f"# {said}" in icub_text(calibration, Method.SURFACE).splitlines()
        for text in (urdf_text, sdf_text, mjcf_text):
            assert f"<!-- {said} -->" in text(calibration, Method.SURFACE)
    for unasked in (ply_text, icub_text, urdf_text):
        assert "predicted error" not in unasked(calibration, Method.FREE)
        assert words not in unasked(calibration, Method.FREE)


def test_files_tell_what_of_the_error_the_whole_skin_has_where_that_is_predicted(part):
    made = make_calibration(part)
    moved = tuple(
        each if each.rms is None else replace(each, moved=0.0012 * np.eye(3)) for each in made.estimates_by(Method.SURFACE)
    )
    calibration = replace(made, estimates={Method.SURFACE: moved}, verdicts={Method.SURFACE: "enough"})
    found = predicted_error(moved, math.inf)
    assert found.whole > 0
    assert f"# predicted error: {predicted_words(found)}" in icub_text(calibration, Method.SURFACE).splitlines()
    own = json.loads(json_text(calibration))["predicted_errors"]["surface"]
    assert own == {
        "mean_m": found.mean, "worst_m": found.worst, "whole_skin_m": found.whole, "among_taxels_m": found.among,
        "taxels_not_known_yet": 0,
        "unchecked_rig_m": None,
    }  # fmt: skip


def test_every_file_has_the_normals_of_the_smooth_part(tmp_path):
    scene, surface = plate_scene()
    laid, rng = place_layout(scene.skin.layout, scene.skin.anchor, surface), np.random.default_rng(4)
    session = Session(scene, surface)
    for poke, channel in enumerate(rng.choice(256, 60, replace=False).tolist(), start=1):
        place, push = laid.places[channel], -laid.normals[channel] + 0.2 * rng.standard_normal(3)
        force = 8.0 * push / np.linalg.norm(push)
        answer = np.array([channel]), np.array([50.0])
        session.add(Contact(poke, 0.0, 1.0, force, np.cross(place, force), *answer, np.eye(4), "", 0.0, True))
    calibration = session.calibration()
    estimates = [e for e in calibration.estimates_by(Method.SURFACE) if e.position is not None]
    right = np.array([e.position * [1, 0, 1] / np.linalg.norm(e.position * [1, 0, 1]) for e in estimates])
    found, facets = np.array([e.normal for e in estimates]), surface.normals[[e.triangle for e in estimates]]
    off, before = (np.degrees(np.linalg.norm(normals - right, axis=1)) for normals in (found, facets))
    assert before.max() > 1.3
    assert off.max() < 0.2
    assert all(0 < e.normal_sd < np.radians(5) for e in estimates)
    write_calibration(calibration, "csv", tmp_path / "c.csv", Method.SURFACE)
    every = list(csv.DictReader((tmp_path / "c.csv").read_text().splitlines()))
    rows = [row for row in every if row["method"] == "surface" and row["nx"]]
    np.testing.assert_array_equal([[float(row[name]) for name in ("nx", "ny", "nz")] for row in rows], found)
    assert [float(row["normal_sd_deg"]) for row in rows] == pytest.approx([np.degrees(e.normal_sd) for e in estimates])
    assert {row["normal_sd_deg"] for row in every if row["method"] == "free"} == {""}
    write_calibration(calibration, "icub", tmp_path / "i.ini", Method.SURFACE)
    lines = [line.split() for line in (tmp_path / "i.ini").read_text().splitlines() if len(line.split()) == 6]
    written = {e.channel: e.normal for e in estimates}
    table = np.array([[float(word) for word in line] for line in lines if line[0].lstrip("-")[0].isdigit()])
    np.testing.assert_allclose(table[sorted(written), 3:], [written[channel] for channel in sorted(written)], atol=1e-6)
