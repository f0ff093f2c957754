import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.contacts.outcome import Contact
from skincal.geometry import axis_point, move_wrench, pitch
from skincal.taxels.contact_table import ContactTable, Evidence
from tests.skincal.estimate_support import gather


def contact(number: int, seed: int, channels=None, pose: str = "") -> Contact:
    rng = np.random.default_rng(seed)
    if channels is None:
        channels = np.sort(rng.choice(6, rng.integers(1, 4), replace=False))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn * np.sign(np.linalg.det(turn)), rng.normal(size=3)
    return Contact(
        number, 0.0, 1.0, rng.normal(size=3), rng.normal(size=3), np.array(channels), rng.uniform(1, 9, len(channels)),
        place, pose, 0.0, True,
    )  # fmt: skip


def same(here: Evidence, there: Evidence) -> bool:
    names = ("channels", "starts", "pokes", "columns", "weights", "trust")
    return all(np.array_equal(getattr(here, name), getattr(there, name)) for name in names)


def test_columns_are_the_wrench_in_the_link_frame():
    contacts = [contact(number, number, pose=f"pose {number % 2}") for number in range(1, 30)]
    by_number = {poke.poke: poke for poke in contacts}
    evidence = gather(contacts, range(6))
    assert np.array_equal(evidence.channels, np.arange(6))
    for taxel, channel in enumerate(evidence.channels):
        mine = evidence.part(taxel, taxel + 1)
        assert set(mine.pokes) == {poke.poke for poke in contacts if channel in poke.channels}
        for i, number in enumerate(mine.pokes):
            poke = by_number[int(number)]
            force, moment = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
            size = np.linalg.norm(force)
            np.testing.assert_allclose(mine.directions[i], force / size, atol=1e-15)
            np.testing.assert_allclose(mine.nearest[i], axis_point(force, moment), atol=1e-12)
            np.testing.assert_allclose(mine.columns[7, i], pitch(force, moment), atol=1e-12)
            np.testing.assert_allclose(mine.forces[i], size)
            assert np.array_equal(mine.sensors[i], poke.link_from_sensor[:3, 3])
            e1, e2 = mine.pairs[i]
            np.testing.assert_allclose(np.cross(e1, e2), mine.directions[i], atol=1e-14)
            k = poke.responses[list(poke.channels).index(channel)] / poke.responses.max()
            assert mine.weights[i] == k
            assert mine.poses[i] == evidence.poses[evidence.pokes == by_number[int(number)].poke][0]
        assert (np.diff(mine.weights) <= 0).all(), "heaviest first"
    assert len(set(evidence.poses)) == 2


def test_evidence_of_a_taxel_does_not_depend_on_which_others_are_asked_for():
    contacts = [contact(number, number) for number in range(1, 60)]
    everything = gather(contacts, range(6))
    for channel in range(6):
        place = int(np.flatnonzero(everything.channels == channel)[0])
        assert same(everything.part(place, place + 1), gather(contacts, [channel]))
    assert len(gather(contacts, [77]).channels) == 0
    assert len(gather([], [0]).channels) == 0


@given(
    steps=st.lists(st.tuples(st.integers(1, 40), st.integers(0, 1000), st.booleans()), max_size=250),
    order=st.randoms(use_true_random=False),
)
def test_what_is_in_a_table_counts_and_neither_order_nor_what_was_taken_out(steps, order):
    table, kept = ContactTable(), {}
    for number, seed, drops in steps:
        if drops:
            table.drop(number)
            kept.pop(number, None)
        else:
            kept[number] = contact(number, seed)
            table.add([kept[number]])
    fresh = list(kept.values())
    order.shuffle(fresh)
    assert same(table.evidence(range(6)), gather(fresh, range(6)))


def test_a_table_forgets_what_was_replaced():
    """Every poke is reported twice: rows must not pile up."""
    table = ContactTable()
    contacts = [contact(number, number) for number in range(1, 1001)]
    for each in contacts:
        table.add([each])
        table.add([each])
        table.evidence([0])
    assert table._columns.shape[1] <= 4096
    assert same(table.evidence(range(6)), gather(contacts, range(6)))


def test_a_taxel_that_lost_all_its_contacts_is_left_out_also_when_rows_are_forgotten():
    contacts = [contact(number, number, channels=[number % 3]) for number in range(300)]
    table = ContactTable(contacts)
    kept = [each for each in contacts[:30] if each.channels[0] != 1]
    for each in contacts:
        if each not in kept:
            table.drop(each.poke)
    for _ in range(2):
        assert same(table.evidence(range(6)), gather(kept, range(6)))
        assert table.evidence(range(6)).channels.tolist() == [0, 2]


def test_equal_contacts_are_all_kept():
    twins = [contact(number, 5, channels=[2]) for number in (1, 2, 3)]
    assert gather(twins, [2]).counts.tolist() == [3]


def test_a_bad_contact_is_refused_and_nothing_is_taken():
    table = ContactTable([contact(1, 1, channels=[0])])
    bad = contact(2, 2, channels=[0])
    bad.force[0] = np.nan
    with pytest.raises(ValueError, match="poke 2"):
        table.add([contact(3, 3, channels=[0]), bad])
    assert table.evidence([0]).pokes.tolist() == [1]


def test_the_evidence_of_some_taxels_is_that_of_the_table():
    table = ContactTable([contact(number, number) for number in range(40)])
    whole = table.evidence(range(6))
    assert whole.evidence(range(6)) is whole
    for some in ([0, 3, 5], [2], [], [4, 77]):
        found, expected = whole.evidence(some), table.evidence(some)
        assert same(found, expected)
        assert np.array_equal(found.taxels, expected.taxels)
        assert np.array_equal(found.pokes, expected.pokes)
