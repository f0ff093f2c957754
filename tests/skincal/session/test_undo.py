"""Rows of a history share a list, and none changes another."""

from hypothesis import given
from hypothesis import strategies as st

from skincal.session.undo import Entries


@given(st.lists(st.tuples(st.sampled_from(["add", "cut"]), st.integers(0, 30)), max_size=40))
def test_rows_of_entries_are_as_tuples_and_keep_what_they_had(steps):
    """Each step begins at any earlier row: it adds an entry to it, or takes some of its first ones."""
    rows: list[Entries] = [Entries()]
    tuples: list[tuple[int, ...]] = [()]
    for number, (step, at) in enumerate(steps):
        row, known = rows[at % len(rows)], tuples[at % len(rows)]
        if step == "add":
            rows.append(row.with_entry(number))
            tuples.append((*known, number))
        else:
            rows.append(row[: len(known) // 2])
            tuples.append(known[: len(known) // 2])
    for row, known in zip(rows, tuples, strict=True):
        assert tuple(row) == known
        assert (len(row), list(reversed(row))) == (len(known), list(reversed(known)))
        assert [row == other for other in rows] == [known == other for other in tuples]


def test_adding_to_a_long_row_copies_nothing():
    row = Entries(range(1000))
    assert row.with_entry(1000)._items is row._items
    assert row.with_entry(1001)._items is not row._items, "the first one has the list"
