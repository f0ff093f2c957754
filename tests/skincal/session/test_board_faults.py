"""Faults of boards that people solder, from a table to positions: each is named, and its advice leads to the truth."""

from __future__ import annotations

import re
from dataclasses import replace as with_fields

import numpy as np
import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact
from skincal.session.replay import load, replay
from skincal.taxels.contact_table import ContactTable
from tests.skincal.soldered_board import Board, errors, import_board, poke

BOARD = Board(rows=5, columns=5, pokes_each=1)
EXPECTED_ERROR_M = 0.0008
"""Mean error of this board's taxels without a fault is 0.4 mm."""


@pytest.fixture(scope="module")
def frames():
    return poke(BOARD)


@pytest.mark.parametrize("layout", [False, True])
def test_a_healthy_board_is_not_remarked_on(frames, tmp_path, capsys, layout):
    snapshot = import_board(tmp_path, frames, frames.plain, layout=layout)
    assert len(snapshot.contacts) == 25
    assert errors(snapshot, BOARD)[:, 0].mean() < EXPECTED_ERROR_M
    assert "skin: its" not in (said := capsys.readouterr().out)
    assert "pressed taxels" not in said
    assert "too many" not in said
    assert not snapshot.dead


def drifting(frames, kind):
    """Values of a board that warms up: all channels alike in some ways, each at its own rate, and half of them."""
    own = np.random.default_rng(3).uniform(0.7, 1.3, BOARD.channels)
    seconds = frames.times[:, None]
    drift = {
        "up": 15.0 * seconds * own,
        "fast": 25.0 * seconds * own,
        "down": -15.0 * seconds * own,
        "half": 20.0 * seconds * (np.arange(BOARD.channels) % 2),
        "settling": 900.0 * (1.0 - np.exp(-seconds / 25.0)) * own,
    }[kind]
    return np.round(frames.rest + frames.answers + frames.noise + drift)


@pytest.mark.parametrize(
    ("kind", "layout"), [("up", True), ("fast", False), ("down", False), ("half", True), ("settling", False)]
)
def test_rest_values_that_drift_are_a_line_between_two_rests(frames, tmp_path, capsys, kind, layout):
    snapshot = import_board(tmp_path, frames, drifting(frames, kind), layout=layout)
    assert len(snapshot.contacts) == 25
    assert not snapshot.dead
    assert errors(snapshot, BOARD)[:, 0].mean() < EXPECTED_ERROR_M
    said = capsys.readouterr().out
    assert f"skin: its values at rest {'fall' if kind == 'down' else 'rise'} by" in said
    assert "so they count" in said
    assert main(["solve", str(tmp_path / "s")]) == 0
    assert "skin: its values at rest" in capsys.readouterr().out
    again = replay(tmp_path / "s")
    for one, other in zip(snapshot.contacts, again.snapshot().contacts, strict=True):
        assert np.array_equal(one.channels, other.channels)
        assert np.array_equal(one.responses, other.responses)
    assert again.skin_condition.drifting == load(tmp_path / "s").skin_condition.drifting >= 20


def test_foam_that_recovers_slowly_is_not_taken_for_drift(tmp_path, capsys):
    """Foam that keeps a tenth of its answer after the press changes pressed taxels only."""
    board = Board(rows=5, columns=5, pokes_each=1)
    plain = poke(board)
    foam = plain.answers.copy()
    for row in range(1, len(foam)):
        foam[row] = np.maximum(foam[row], np.minimum(0.97 * foam[row - 1], 0.1 * foam[:row].max(axis=0)))
    lasting = plain.rest + foam + plain.noise
    snapshot = import_board(tmp_path, plain, np.round(lasting))
    assert len(snapshot.contacts) == 25
    assert errors(snapshot, board)[:, 0].mean() < EXPECTED_ERROR_M
    assert "its values at rest" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        ("extremes", "exactly 0 and 1 as its smallest and largest value"),
        ("bytes", "exactly 0 and 255 as its smallest and largest value"),
        ("largest", "exactly 1 as its largest value"),
        ("spread", "the same mean and spread"),
    ],
)
def test_frames_that_a_program_normalised_one_by_one_are_named(frames, tmp_path, capsys, scale, words):
    values = frames.plain - frames.rest
    low, high = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    values = {
        "extremes": (values - low) / (high - low),
        "bytes": np.round(255.0 * (values - low) / (high - low)),
        "largest": values / high,
        "spread": 100.0 * (values - values.mean(axis=1, keepdims=True)) / values.std(axis=1, keepdims=True),
    }[scale]
    import_board(tmp_path, frames, values, more="[contacts]\nresponse_min = 0.05\n")
    said = capsys.readouterr().out
    assert f"skin: every frame has {words}" in said
    assert "Record raw values." in said
    assert main(["solve", str(tmp_path / "s")]) == 0
    assert words in capsys.readouterr().out


def test_a_skin_that_is_held_in_the_rows_of_a_faster_sensor_is_not_taken_for_normalised_frames(frames, tmp_path, capsys):
    """A table with a row for each wrench repeats the last frame of the skin."""
    rows, step = 25, np.diff(frames.times).min()
    held = with_fields(
        frames,
        times=(frames.times[:, None] + step * np.arange(rows) / rows).ravel(),
        wrench=frames.wrench.repeat(rows, axis=0) + np.random.default_rng(2).normal(0.0, 1e-3, (rows * len(frames.times), 6)),
    )
    snapshot = import_board(tmp_path, held, frames.plain.repeat(rows, axis=0))
    assert len(snapshot.contacts) == 25
    assert "skin: every frame has" not in capsys.readouterr().out


def test_noise_as_large_as_the_answers_is_named(tmp_path, capsys):
    noisy = poke(Board(rows=5, columns=5, pokes_each=1, noise=150.0))
    import_board(tmp_path, noisy, noisy.plain)
    assert "skin: its noise at rest is as large as its answers" in capsys.readouterr().out


def test_most_pokes_beside_a_good_skin_are_no_noise_of_it(tmp_path, capsys):
    """A wrong sign of the force or a mirrored layout leads the hand beside the skin; each taxel answers clearly if pressed."""
    board = Board(rows=5, columns=5, pokes_each=1)
    frames = poke(board, targets=range(16))
    beside = np.arange(len(frames.times)) >= 3 * len(frames.times) // 16
    answers = np.where(beside[:, None], 0.0, frames.answers)
    snapshot = import_board(tmp_path, frames, np.round(frames.rest + answers + frames.noise))
    assert len(snapshot.contacts) == 3
    assert len(snapshot.pokes) == 16
    assert "skin: its" not in capsys.readouterr().out


def test_clear_answers_below_the_threshold_lead_to_a_threshold_that_counts_them(frames, tmp_path, capsys):
    scaled = frames.plain / 1000.0
    assert not import_board(tmp_path / "a", frames, scaled).contacts
    advice = re.search(r"Write (response_min = [0-9.]+) in \[contacts\]", capsys.readouterr().out)
    assert advice is not None
    snapshot = import_board(tmp_path / "b", frames, scaled, more=f"[contacts]\n{advice[1]}\n")
    assert len(snapshot.contacts) == 25
    assert errors(snapshot, BOARD)[:, 0].mean() < EXPECTED_ERROR_M


@pytest.mark.parametrize(("share", "layout"), [(0.25, True), (0.6, False)])
def test_a_matrix_without_diodes_is_recognised_and_its_threshold_separates_the_ghosts(tmp_path, capsys, share, layout):
    board = Board(rows=5, columns=6, pokes_each=1)
    frames = poke(board)
    values = np.round(frames.rest + np.maximum(frames.answers, share * frames.ghosts) + frames.noise)
    first = import_board(tmp_path / "a", frames, values, layout=layout)
    assert not first.contacts
    said = capsys.readouterr().out
    assert "row and the column of the strongest one (5 x 6; they answer" in said
    assert "smaller tip" not in said
    advice = re.search(r"write (response_share = [0-9.]+) in \[contacts\].*then ([0-9]+) of these pokes count", said)
    assert advice is not None
    snapshot = import_board(tmp_path / "b", frames, values, layout=layout, more=f"[contacts]\n{advice[1]}\n")
    assert len(snapshot.contacts) == int(advice[2]) == 30
    assert errors(snapshot, board)[:, 0].mean() < EXPECTED_ERROR_M


def test_ghosts_as_strong_as_the_pressed_taxel_are_no_matter_of_a_threshold(tmp_path, capsys):
    frames = poke(Board(rows=5, columns=6, pokes_each=1))
    import_board(tmp_path, frames, np.round(frames.rest + np.maximum(frames.answers, 0.95 * frames.ghosts) + frames.noise))
    said = capsys.readouterr().out
    assert "a matrix without diodes" in said
    assert "so no threshold helps" in said


@pytest.mark.parametrize(("pitch", "each"), [(0.005, 6), (0.004, 6)])
def test_a_spread_press_on_a_small_board_is_told_its_limit_and_the_middle_is_right_with_it(tmp_path, capsys, pitch, each):
    """The pokes that pass a low limit are those at the edge: inner taxels come out 3 to 5 mm beside their places."""
    board = Board(rows=4, columns=4, pitch=pitch, pokes_each=each)
    frames = poke(board)
    before = import_board(tmp_path / "a", frames, frames.plain)
    said = capsys.readouterr().out
    assert "taxels in its middle come out beside their places" in said
    inner = [each for each in before.estimates[list(before.estimates)[-1]] if each.channel in (5, 6, 9, 10) and each.rms]
    off = [float(np.linalg.norm(each.position - board.places[each.channel])) for each in inner]
    assert max(off) > 0.002
    assert max(off) < 2.0 * max(each.rms for each in inner)
    advice = re.search(r"write (taxels_max = [0-9]+) in \[contacts\]", said)
    assert advice is not None
    snapshot = import_board(tmp_path / "b", frames, frames.plain, more=f"[contacts]\n{advice[1]}\n")
    assert sum(isinstance(each.outcome, Contact) for each in snapshot.pokes) >= 0.97 * len(snapshot.pokes)
    assert not snapshot.dead
    assert errors(snapshot, board)[:, 0].max() < 0.001


def test_a_press_that_spreads_along_a_strip_is_no_matrix_without_diodes(tmp_path, capsys):
    """All taxels of a strip are in one row, so answers along it tell nothing of a second line."""
    frames = poke(Board(rows=1, columns=10, reach=0.05, pokes_each=2))
    import_board(tmp_path, frames, frames.plain, layout=True)
    said = capsys.readouterr().out
    assert "too many taxels answer" in said
    assert "diode" not in said
    assert "write taxels_max = 10" in said


@pytest.mark.parametrize("layout", [False, True])
def test_a_dead_row_is_named_in_a_log_of_half_a_minute(tmp_path, capsys, layout):
    board = Board(rows=5, columns=5, pokes_each=1)
    frames = poke(board)
    values = frames.plain
    values[:, 10:15] = np.round(frames.rest[10:15])
    snapshot = import_board(tmp_path, frames, values, layout=layout)
    assert frames.times[-1] < 45.0
    assert list(snapshot.dead) == [10, 11, 12, 13, 14]
    word = "stuck: exactly" if layout else "stuck, or no taxel: exactly"
    assert all(why.startswith(word) for why in snapshot.dead.values())
    off, expected = errors(snapshot, board).T
    assert off.mean() < expected.mean()
    assert (off < 2.0 * expected).all()
    capsys.readouterr()
    assert main(["solve", str(tmp_path / "s")]) == 0
    assert f"channel 10 is not used: {word}" in capsys.readouterr().out
    assert dict(replay(tmp_path / "s").snapshot().dead) == dict(snapshot.dead)


def test_a_quiet_channel_of_a_coarse_board_that_nothing_presses_is_not_called_stuck(tmp_path):
    board = Board(rows=5, columns=5, pokes_each=2, noise=0.25)
    frames = poke(board, targets=[*range(5, 25)] * 2)
    values = frames.plain
    values[:, 0] = np.round(frames.rest[0])
    snapshot = import_board(tmp_path, frames, values)
    assert len(snapshot.contacts) >= 20
    assert not snapshot.dead


@pytest.mark.parametrize(
    ("rows", "pitch", "reach", "top", "seed"),
    [(5, 0.008, 0.0055, 160.0, 1), (5, 0.008, 0.0055, 160.0, 2), (6, 0.006, 0.004, 170.0, 3)],
)
def test_the_expected_error_covers_answers_that_end_at_the_range_together(tmp_path, capsys, rows, pitch, reach, top, seed):
    """Pressed taxels would answer with up to 600 counts, and the board's converter ends at a tenth of that above rest."""
    board = Board(rows=rows, columns=rows, pitch=pitch, reach=reach, pokes_each=3)
    frames = poke(board, seed)
    values = np.minimum(frames.plain, top)
    snapshot = import_board(tmp_path, frames, values, more="[contacts]\ntaxels_max = 16\n")
    together = [each for each in snapshot.contacts if each.clipped is not None and len(each.clipped) > 1]
    assert len(together) > 0.9 * len(snapshot.contacts) > 50
    said = capsys.readouterr().out
    assert f"pressed taxels reach {top:g}, the end of its range" in said
    assert "pokes that were held still" in said, "the header counts all pokes"
    off, expected = errors(snapshot, board).T
    true, predicted = np.sqrt(np.mean(off**2)), np.sqrt(np.mean(expected**2))
    assert true < 0.7 * pitch
    assert true <= predicted < 1.5 * true
    assert (off < 2.0 * expected).mean() >= 0.9


def test_answers_at_the_end_of_the_range_have_equal_weights_if_they_are_several():
    first = Contact(
        poke=1, start_s=0.0, end_s=1.0, force=np.array([0.0, 0.0, -5.0]), moment=np.array([0.01, 0.02, 0.0]),
        channels=np.array([2, 3, 7]), responses=np.array([150.0, 120.0, 60.0]), link_from_sensor=np.eye(4), pose="",
        tare_change=0.0, final=True,
    )  # fmt: skip
    weights = {
        name: dict(
            zip(
                evidence.channels.tolist(), zip(evidence.weights.tolist(), evidence.unranked.tolist(), strict=True), strict=True
            )
        )
        for name, clipped in {"none": None, "one": [2], "two": [2, 3]}.items()
        for evidence in [
            ContactTable([with_fields(first, clipped=None if clipped is None else np.array(clipped))]).evidence([2, 3, 7])
        ]
    }
    assert weights["none"] == weights["one"] == {2: (1.0, False), 3: (0.8, False), 7: (0.4, False)}
    assert weights["two"] == {2: (1.0, True), 3: (1.0, True), 7: (0.4, False)}
