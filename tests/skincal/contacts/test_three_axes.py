"""Taxels of three axes: their values become vectors, the scene's rule makes one number of them, and a journal keeps both."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.contacts.answers_of_skin import answers_of
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.journal.documents import DetectorResult, read_document, result_to_json
from skincal.model.errors import InputError
from skincal.model.scene import load_scene
from skincal.model.skin_axes import ResponseRule, SkinAxes, ValueOrder
from skincal.words.layout_words import frame_findings
from skincal.words.poke_words import answered_inversely
from tests.skincal.contacts.three_axis_support import VectorScript
from tests.skincal.poke_script import outcome_key, small_scene

PRESSED, SIDE = 3, 7
READINGS = {PRESSED: (12.0, -5.0, -80.0), SIDE: (2.0, 30.0, -4.0)}
"""Force on the taxel, z out of the skin: one taxel is pushed, its neighbour is only sheared."""


def axes_with(order=ValueOrder.BY_TAXEL, rule=ResponseRule.PUSH, signs=(1, 1, -1), places=(0, 1, 2)):
    return SkinAxes(order, signs, places, rule, "raw")


def press_once(axes, readings=READINGS, limits=None, resting=100.0):
    scene = small_scene(limits=limits)
    scene = replace(scene, skin=replace(scene.skin, axes=axes))
    script = VectorScript(scene, resting=resting).quiet()
    script.press(np.array([0.5, 0.0, -8.0]), np.array([0.0, 0.0, 0.1]), readings).quiet()
    return script.run()[-1]


def test_values_of_both_orders_are_sorted_into_the_axes_of_each_taxel():
    by_taxel, by_axis = axes_with(), axes_with(ValueOrder.BY_AXIS)
    frame = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    # The values of z rise under a push, which is a force against z.
    assert by_taxel.sort_values(frame).tolist() == [[1, 2, -3], [4, 5, -6]]
    assert by_axis.sort_values(frame).tolist() == [[1, 3, -5], [2, 4, -6]]


@pytest.mark.parametrize("order", ValueOrder)
@pytest.mark.parametrize(("signs", "places"), [((1, 1, -1), (0, 1, 2)), ((-1, 1, 1), (1, 2, 0)), ((1, -1, -1), (2, 1, 0))])
def test_frames_and_axes_are_inverse_to_each_other(order, signs, places):
    axes = axes_with(order, signs=signs, places=places)
    frames = np.random.default_rng(2).normal(size=(5, 12))
    assert np.array_equal(axes.as_frames(axes.sort_values(frames)), frames)


@pytest.mark.parametrize("order", ValueOrder)
def test_a_contact_keeps_the_reading_of_each_taxel_that_answers(order):
    contact = press_once(axes_with(order))
    assert isinstance(contact, Contact)
    # The sheared neighbour pushes less than the threshold of 10.
    assert contact.channels.tolist() == [PRESSED]
    assert contact.responses == pytest.approx([80.0])
    assert contact.vectors == pytest.approx(np.array([READINGS[PRESSED]]))


def test_the_length_of_the_reading_counts_where_the_scene_says_so():
    contact = press_once(axes_with(rule=ResponseRule.LENGTH))
    assert contact.channels.tolist() == [PRESSED, SIDE]
    assert contact.responses == pytest.approx([np.sqrt(144 + 25 + 6400), np.sqrt(4 + 900 + 16)])
    assert contact.vectors == pytest.approx(np.array([READINGS[PRESSED], READINGS[SIDE]]))


def test_a_pull_is_no_answer_of_a_push_and_is_one_of_a_length():
    pulled = {PRESSED: (0.0, 0.0, 80.0)}
    # As for one axis: a taxel that only falls was pressed during its tare.
    assert press_once(axes_with(), pulled).reason is Reason.NO_TARE
    assert press_once(axes_with(rule=ResponseRule.LENGTH), pulled).vectors == pytest.approx(np.array([pulled[PRESSED]]))


def test_a_reading_with_a_value_at_the_end_of_the_range_is_no_vector():
    contact = press_once(axes_with(), limits=(0.0, 112.0), resting=20.0)
    assert contact.vectors == pytest.approx(np.array([READINGS[PRESSED]]))
    # x is at the upper end: 100 + 12.
    assert np.isnan(press_once(axes_with(), limits=(0.0, 112.0), resting=100.0).vectors).all()


def test_a_taxel_without_one_of_its_values_gives_no_number():
    answers = answers_of(replace(small_scene().skin, axes=axes_with()))
    frame = np.full(72, 5.0)
    frame[3 * SIDE + 1] = np.nan
    assert np.flatnonzero(np.isnan(answers.watched(frame))).tolist() == [SIDE]


def test_the_journal_keeps_the_readings_bit_for_bit_and_refuses_others():
    contact = press_once(axes_with(rule=ResponseRule.LENGTH))
    stored = result_to_json(DetectorResult([contact], None))
    read = read_document(json.dumps(stored).encode(), Path("a.jsonl"))
    assert outcome_key(read.outcomes[0]) == outcome_key(contact)
    (document,) = stored["outcomes"]
    for wrong in ([[1.0, 2.0]], [[1.0, 2.0, 3.0]], [[1e300, 0.0, 0.0], [0.0, 0.0, 0.0]]):
        changed = {**stored, "outcomes": [{**document, "vectors": wrong}]}
        with pytest.raises(InputError, match="does not fit"):
            read_document(json.dumps(changed).encode(), Path("a.jsonl"))


SKIN = "channels = 4\naxes = 3\n"


def scene_of(folder: Path, skin: str, contacts: str = ""):
    path = folder / "scene.toml"
    path.write_text(f'name = "hand"\nlink = "tip"\n[skin]\n{skin}\n{contacts}')
    return load_scene(path)


def test_a_scene_names_order_axes_response_and_unit(tmp_path):
    text = f'{SKIN}order = "xxyyzz"\nvalues = ["y", "-x", "z"]\nresponse = "length"\nunit = "N"\npolarity = "down"'
    skin = scene_of(tmp_path, text).skin
    assert skin.axes == SkinAxes(ValueOrder.BY_AXIS, (-1, 1, 1), (1, 0, 2), ResponseRule.LENGTH, "N")
    assert (skin.channels, skin.frame_width) == (4, 12)
    assert scene_of(tmp_path, SKIN).skin.axes == axes_with()
    assert scene_of(tmp_path, "channels = 4").skin.frame_width == 4


def test_a_skin_in_newtons_has_a_threshold_in_newtons_unless_the_scene_gives_one(tmp_path):
    assert scene_of(tmp_path, SKIN).contacts.response_min == 10.0
    assert scene_of(tmp_path, f'{SKIN}unit = "N"').contacts.response_min == 0.15
    assert scene_of(tmp_path, f'{SKIN}unit = "N"', "[contacts]\nresponse_min = 2\n").contacts.response_min == 2.0


@pytest.mark.parametrize(
    ("skin", "words"),
    [
        ("channels = 4\naxes = 2", "axes is 2; expected 1, or 3"),
        ('channels = 4\norder = "xxyyzz"', "order is for taxels of three axes; add axes = 3"),
        (f'{SKIN}order = "zyx"', "order is 'zyx'; expected one of xyzxyz, xxyyzz"),
        (f'{SKIN}values = ["x", "y"]', "expected x, y and z in the order of the device"),
        (f'{SKIN}values = ["x", "y", "-z"]', 'values names "-z"; write "z", and polarity = "down"'),
        (f'{SKIN}values = ["x", "--y", "z"]', "expected x, y and z in the order of the device"),
        (f'{SKIN}response = "sum"', "response is 'sum'; expected one of push, length"),
        (f'{SKIN}unit = "g"', "unit is 'g'; expected one of raw, N"),
    ],
)  # fmt: skip
def test_a_wrong_entry_of_the_axes_is_refused(tmp_path, skin, words):
    with pytest.raises(InputError, match=r"scene\.toml") as refused:
        scene_of(tmp_path, skin)
    assert words in str(refused.value)


def test_a_skin_of_one_axis_loads_nothing_of_the_three():
    code = (
        "import sys; from skincal.model.scene import load_scene, resource; from skincal.session.pipeline import Pipeline; "
        "Pipeline(load_scene(resource('scenes/icub-forearm/scene.toml')), (), None); "
        "print([name for name in sys.modules if name.startswith('skincal.') and ('axes' in name or 'vector_' in name)])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert found == "[]"


def test_the_findings_say_how_many_values_a_frame_has_and_whether_channels_counts_them(tmp_path):
    assert frame_findings(scene_of(tmp_path, "channels = 4").skin) == []
    skin = scene_of(tmp_path, f'{SKIN}unit = "N"').skin
    assert frame_findings(skin) == ["a skin frame has 12 values: x, y and z of 4 taxels, in N"]
    layout = small_scene().skin.layout
    assert layout is not None
    taxels = len(layout.channels)
    counted = replace(skin, layout=layout, channels=3 * taxels)
    assert f"write channels = {taxels}" in frame_findings(counted)[1]
    assert len(frame_findings(replace(counted, channels=3 * taxels + 1))) == 1


@pytest.mark.parametrize("hold_s", [0.5, 1.5])
def test_against_the_polarity_no_release_is_taken_for_a_poke(hold_s):
    """Each press looks like rest after a tare under load, and its release like a press: a poke with the opposite force."""
    scene = replace(small_scene(), skin=replace(small_scene().skin, axes=axes_with()))
    script = VectorScript(scene).quiet(2.5)
    for value in (80.0, 60.0, 70.0):
        script.press(np.array([0.5, 0.0, -8.0]), np.zeros(3), {PRESSED: (3.0, 2.0, value)}, hold_s=hold_s).quiet()
    outcomes = script.run()
    assert [outcome.reason for outcome in outcomes] == [Reason.NO_TARE] * 3
    assert all(answered_inversely(outcome) for outcome in outcomes)


def test_a_tare_under_load_costs_one_poke_and_no_more():
    scene = replace(small_scene(), skin=replace(small_scene().skin, axes=axes_with()))
    script, load = VectorScript(scene), np.array([0.3, 0.0, -6.0, 0.0, 0.0, 0.0])
    for _ in range(50):
        script.step(load, {PRESSED: np.array([3.0, 2.0, -60.0])})
    script.quiet()
    for _ in range(2):
        script.press(np.array([0.5, 0.0, -8.0]), np.zeros(3), READINGS).quiet()
    outcomes = {outcome.poke: outcome for outcome in script.run()}
    assert [type(outcome) for outcome in outcomes.values()] == [Rejection, Contact, Contact]
