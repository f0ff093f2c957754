"""The tables that Python and the compiled solver share: one description, and nothing depends on an order."""

import subprocess
import sys

import numpy as np
import pytest

from skincal.model.scene import NoiseSettings
from skincal.modules import pose_fit
from skincal.modules.off_surface import spread_over_modules
from skincal.modules.pose_fit import ModuleRows, Touches
from skincal.solver import tables
from skincal.solver.machine import Machine, shared
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.noise import noise_values, offset_square, row_precision
from skincal.taxels.shared_errors import variance_factors
from tests.skincal.estimate_support import trust_by_definition
from tests.skincal.taxels.test_solve_rival import press
from tools import solver

MADE_FROM_THE_FIELDS = ("offsets", "dtype", "packed", "packing")


def permuted(monkeypatch, name):
    """Exchange the first two fields of a table that have one type, as an edit of the list would."""
    table = tables.SHARED_TABLES[name]
    names = list(table.fields)
    i = next(i for i in range(len(names) - 1) if table.fields[names[i]].stored == table.fields[names[i + 1]].stored)
    names[i], names[i + 1] = names[i + 1], names[i]
    monkeypatch.setattr(table, "fields", {field: table.fields[field] for field in names})
    for cached in MADE_FROM_THE_FIELDS:
        monkeypatch.delitem(table.__dict__, cached, raising=False)
    tables.layout_number.cache_clear()


@pytest.fixture
def _fresh_layout():
    yield
    for table in tables.SHARED_TABLES.values():
        for cached in MADE_FROM_THE_FIELDS:
            table.__dict__.pop(cached, None)
    tables.layout_number.cache_clear()


def test_the_header_in_the_tree_is_the_generated_one():
    assert solver.HEADER.read_text(encoding="utf-8") == solver.header(), "run `python -m tools.solver`"


@pytest.mark.usefixtures("_fresh_layout")
@pytest.mark.parametrize("name", tables.SHARED_TABLES)
def test_fields_in_another_order_are_refused(monkeypatch, name):
    shipped = solver.header()
    permuted(monkeypatch, name)
    assert solver.header() != shipped
    with pytest.raises(RuntimeError, match="built from other tables"):
        Machine()


@pytest.mark.usefixtures("_fresh_layout")
def test_a_common_number_that_changed_is_refused(monkeypatch):
    monkeypatch.setitem(tables.SHARED_NUMBERS, "FULL_TRUST_SDS", 2.9)
    tables.layout_number.cache_clear()
    with pytest.raises(RuntimeError, match="built from other tables"):
        Machine()


def test_the_compiler_refuses_a_field_at_another_place(tmp_path):
    """The header's offsets are the ones that the compiler gives the fields."""
    text = solver.header().replace("OFFSET(Noise, moment, 8)", "OFFSET(Noise, moment, 16)")
    assert text != solver.header()
    (tmp_path / "tables.h").write_text(text, encoding="utf-8")
    (tmp_path / "base.h").write_text((solver.HEADER.with_name("base.h")).read_text(encoding="utf-8"), encoding="utf-8")
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-freestanding", "-fsyntax-only", "-x", "c", "tables.h"]
    refused = subprocess.run(command, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert refused.returncode != 0
    assert "Noise.moment" in refused.stderr


def test_values_are_passed_by_name():
    squares = np.linspace(0.0, 20.0, 50)
    by_name = {"pokes": 50, "squares": squares, "trust": (50,)}
    backward = dict(reversed(by_name.items()))
    np.testing.assert_array_equal(shared().run("trusts", **by_name)["trust"], shared().run("trusts", **backward)["trust"])


@pytest.mark.parametrize("wrong", [{}, {"trusts": (3,)}, {"trust": (3,), "trusts": (3,)}])
def test_a_field_that_is_missing_or_unknown_is_refused(wrong):
    with pytest.raises(TypeError, match=r"Trusts of the solver: fields missing or unknown: trust"):
        shared().run("trusts", pokes=3, squares=np.zeros(3), **wrong)


def test_fields_lie_as_on_wasm32():
    """A number is aligned to its own size, whatever Python's machine does; a table's size is a multiple of its alignment."""
    assert tables.SHARED_TABLES["Surface"].offsets["stamp"] == 184
    assert tables.SHARED_TABLES["Surface"].offsets["origin"] == 192
    assert tables.SHARED_TABLES["Surface"].dtype.itemsize % 8 == 0
    for table in tables.SHARED_TABLES.values():
        for name, field in table.fields.items():
            assert table.offsets[name] % field.alignment == 0
            assert table.dtype[name] == field.stored


def test_results_are_the_arrays_that_the_solver_may_write():
    assert list(shared().run("trusts", pokes=2, squares=np.zeros(2), trust=(2,))) == ["trust"]


def test_trust_is_its_smooth_step_to_the_last_bit():
    squares = np.concatenate([np.random.default_rng(1).uniform(0.0, 20.0, 2000), [0.0, 2.8**2, 3.8**2, np.inf]])
    np.testing.assert_array_equal(pose_fit.trust_from_squares(squares), trust_by_definition(squares))


NOISE_PROBE = """
#include "contacts.h"
static double in[32], out[5];
__attribute__((visibility("default"))) double *given(void) { return in; }
__attribute__((visibility("default"))) double *found(void) { return out; }
__attribute__((visibility("default"))) void noise_of(void)
{
    double one, two, three;
    Contacts c = {.count = 1, .force = in, .weight = in + 1, .weakness = &one, .square = &two, .scale = &three};
    for (int k = 0; k < 3; k++) {
        c.first[k] = in + 2 + k;
        c.second[k] = in + 5 + k;
        c.sensor[k] = in + 8 + k;
    }
    const Noise *noise = (const Noise *)(in + 16);
    set_offsets(&c, noise);
    RowNoise n = row_noise(&c, 0, vec(in[11], in[12], in[13]), noise);
    out[0] = n.even - n.less[0] * n.less[0];
    out[1] = -n.less[0] * n.less[1];
    out[2] = n.even - n.less[1] * n.less[1];
    out[3] = two;
}
"""


def test_the_noise_of_a_poke_is_the_solvers(tmp_path):
    """`skincal/taxels/noise.py` has the covariance of `contacts.h` for many places at once."""
    import wasmtime

    (tmp_path / "probe.c").write_text(NOISE_PROBE, encoding="utf-8")
    flags = [flag for flag in solver.COMPILER_FLAGS if flag != "-Werror"]
    command = [sys.executable, "-m", "ziglang", "cc", *flags, f"-I{solver.C_SOURCE.parent}", "-o", "probe.wasm", "probe.c"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    engine = wasmtime.Engine()
    store = wasmtime.Store(engine)
    exports = wasmtime.Instance(store, wasmtime.Module(engine, (tmp_path / "probe.wasm").read_bytes()), []).exports(store)
    rng, noise = np.random.default_rng(3), NoiseSettings()
    values = np.array(list(noise_values(noise).values()))
    for _ in range(200):
        pair, _ = np.linalg.qr(rng.normal(size=(3, 2)))
        force, weight, sensor, place = rng.uniform(1, 20), rng.uniform(0.05, 1.0), rng.normal(size=3), rng.normal(size=3)
        given = np.concatenate([[force, weight], pair.T.ravel(), sensor, place, np.zeros(2), values])
        exports["memory"].write(store, given.tobytes(), exports["given"](store))
        exports["noise_of"](store)
        start = exports["found"](store)
        d11, d12, d22, offset = np.frombuffer(bytes(exports["memory"].read(store, start, start + 32)))
        offsets = offset_square(np.array([weight]), noise)
        assert offsets[0] == pytest.approx(offset, rel=1e-14)
        precision = row_precision(pair.T[None], (place - sensor)[None], np.array([force]), offsets, noise)[0]
        np.testing.assert_allclose(precision @ [[d11, d12], [d12, d22]], np.eye(2), atol=1e-11)


def test_the_variance_factors_of_modules_are_those_of_shared_errors():
    """`skincal/taxels/shared_errors.py` has the formula of `spread.h` for sheets and corrections."""
    rng, sizes = np.random.default_rng(4), np.array([2, 3, 9, 30])
    count, starts = int(sizes.sum()), np.cumsum(sizes) - sizes
    contacts = [press(poke, np.zeros(3), [0.1 * np.sin(poke), 0.1 * np.cos(poke), -1.0]) for poke in range(1, count + 1)]
    whiten = np.tril(rng.uniform(500.0, 2000.0, (count, 2, 2)))
    slopes, misses, normals = rng.normal(size=(count, 2, 3)), 2.0 * rng.normal(size=(count, 2)), rng.normal(size=(count, 3))
    rows, trust = ModuleRows(slopes, misses, whiten, normals, np.zeros((count, 3, 3))), rng.uniform(0.0, 1.0, count)
    none, of = np.empty(0, dtype=np.int64), np.repeat(np.arange(len(sizes)), sizes)
    evidence = ContactTable(contacts).evidence([0])
    touches = Touches(np.arange(len(sizes)), of, np.arange(count), evidence, np.empty(0), none, np.empty(0), none, none)
    found = spread_over_modules(touches, rows, trust, NoiseSettings(), None)
    expected = variance_factors(np.sum(misses**2, axis=1), trust, starts, 3)
    assert expected.max() > 1.5
    np.testing.assert_allclose(found.factors, expected, rtol=1e-13)
