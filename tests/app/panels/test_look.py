"""How things look, measured in pixels: curves without holes, fields that are seen, words of the right size."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QSize
from PySide6.QtGui import QColor, QFontMetrics
from PySide6.QtWidgets import QApplication, QCheckBox, QLineEdit, QRadioButton, QStyle, QStyleOptionButton, QWidget

from app.dialogs.new_session import CURVE_LEAST_HEIGHTS, curve_height, scroll_points
from app.dialogs.verdict_dialog import DIALOG_WIDTH_PX, VerdictDialog
from app.panels.layouts import make_column
from app.panels.readings_panel import ReadingsPanel
from app.panels.taxel_map import TaxelMap
from app.theme import DARK, LIGHT, Choice
from app.window import Theme
from skincal.model.readings import Stream
from skincal.words.units import ChannelNames
from tests.app.dialogs.test_verdict_dialog import verdict
from tests.app.scene3d_support import layout, scene
from tests.app.window_support import NAMES, contrast, pixels, show_in


@pytest.mark.parametrize("noise", [0.2, 1.5, 8.0])
def test_a_calm_curve_has_no_holes_on_a_large_scale(qtbot, noise):
    show_in(LIGHT)
    panel = ReadingsPanel()
    qtbot.addWidget(panel)
    panel.resize(QSize(430, 300))
    panel.show()
    rng = np.random.default_rng(0)
    times = np.linspace(-10.0, 0.0, 1000)
    values = np.stack([np.full(1000, 2000.0), np.full(1000, 800.0), np.full(1000, -700.0)], axis=1)
    values += noise * rng.normal(size=values.shape)
    panel.moment.draw(times, values * 1e-3)
    qtbot.wait(30)
    picture = pixels(panel.moment.plot).astype(int)[..., :3]
    for axis in (1, 2):
        colour = QColor(LIGHT.axes[axis])
        hue = np.array([colour.red(), colour.green(), colour.blue()])
        # A mix of the curve and the white paper.
        share = (255 - picture) @ (255 - hue) / ((255 - hue) @ (255 - hue))
        off = np.abs(255 - share[..., None] * (255 - hue) - picture).max(axis=-1)
        drawn = ((share > 0.3) & (off < 12)).any(axis=0)
        first, last = np.flatnonzero(drawn)[[0, -1]]
        assert last - first > 80
        assert drawn[first : last + 1].all()


def test_the_time_axis_names_its_unit_and_ends_before_the_edge(qtbot):
    panel = ReadingsPanel()
    qtbot.addWidget(panel)
    panel.resize(430, 300)
    panel.show()
    for curves in (panel.force, panel.moment):
        axis = curves.plot.item.getAxis("bottom")
        (ticks,) = axis._tickLevels
        assert ticks[-1] == (0.0, "0 s")
        box = curves.plot.item.vb.sceneBoundingRect()
        width = QFontMetrics(axis.font()).horizontalAdvance("0 s")
        assert box.right() + width / 2 <= curves.plot.width()
        qtbot.wait(20)
        picture = pixels(curves.plot)[..., :3].astype(int)
        corner = picture[round(box.bottom()) + 4 :, round(box.right() + 2) :]
        assert np.ptp(corner.sum(axis=2)) > 200, "the s is seen"


@pytest.mark.parametrize("choice", [Choice.DARK, Choice.LIGHT])
@pytest.mark.parametrize("kind", [QCheckBox, QRadioButton, QLineEdit])
def test_fields_are_seen_in_both_themes(qtbot, choice, kind):
    theme = Theme(choice)
    colours = DARK if choice is Choice.DARK else LIGHT
    window = QWidget()
    qtbot.addWidget(window)
    field = kind()
    make_column(field, within=window)
    window.show()
    qtbot.wait(20)
    style, option = QApplication.style(), QStyleOptionButton()
    area = field.rect()
    if kind is not QLineEdit:
        option.initFrom(field)
        part = QStyle.SubElement.SE_CheckBoxIndicator if kind is QCheckBox else QStyle.SubElement.SE_RadioButtonIndicator
        area = style.subElementRect(part, option, field)
    picture = pixels(field)[area.top() : area.bottom() + 1, area.left() : area.right() + 1]
    row = picture[picture.shape[0] // 2]
    best = max(contrast(QColor(*map(int, rgba[:3])), QColor(colours.window)) for rgba in row)
    assert best >= 3.0, "WCAG 1.4.11"
    assert theme.choice is choice


def test_a_headline_takes_two_lines_at_most(qtbot):
    sizes = []
    for words in ("Finished: 24 taxels.", "Finished: 24 taxels. " + "The rest of the sentence says more of it. " * 2):
        dialog = VerdictDialog(verdict(), NAMES)
        qtbot.addWidget(dialog)
        dialog.sentence.setText(words)
        dialog.show_headline()
        dialog.show()
        qtbot.wait(20)
        assert dialog.width() >= DIALOG_WIDTH_PX - 1
        line = QFontMetrics(dialog.sentence.font()).lineSpacing()
        assert dialog.sentence.heightForWidth(dialog.sentence.width()) <= 2.1 * line
        sizes.append(dialog.sentence.font().pointSizeF())
        dialog.close()
    assert sizes[0] == 28.0
    assert 15.0 <= sizes[1] < 28.0


@pytest.mark.parametrize(
    ("values", "height"), [((5.0, 5.3), 5.0), ((0.0, 12.0), 20.0), ((0.0, 5.0), 5.0), ((1.0, 1001.0), 1000.0)]
)
def test_a_small_curve_of_a_sensor_at_rest_is_flat(values, height):
    least, unit = CURVE_LEAST_HEIGHTS[Stream.WRENCH]
    assert curve_height(values, least) == pytest.approx(height)
    points = scroll_points(values, height)
    assert np.ptp(points[:, 1]) == pytest.approx(np.ptp(values) / height)
    assert (points[:, 1] >= 0.0).all()
    assert (points[:, 1] <= 1.0).all()
    assert points[-1, 0] == 1.0
    assert unit == "N"


@pytest.mark.parametrize("modules", [1, 2])
def test_the_number_of_an_only_module_is_not_printed_over_its_taxels(qtbot, modules):
    plan = layout(modules)
    map_ = TaxelMap(scene(plan), plan.channels, ChannelNames(plan))
    qtbot.addWidget(map_)
    map_.resize(400, 300)
    map_.show()
    qtbot.wait(20)
    assert [text.isVisible() for text in map_._numbers] == [modules > 1] * modules
