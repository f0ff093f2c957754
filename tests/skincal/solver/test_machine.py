"""The compiled solver: built from its source, its replacements of the C library, its memory and threads."""

import math
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest
import wasmtime

from skincal import methods
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.solver import machine as solver_machine
from skincal.solver.machine import SOLVER_PROGRAM, Machine
from skincal.solver.tables import SHARED_TABLES
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import PER_TAXEL, Method
from tests.skincal.mesh.mesh_support import KINDS, random_metrics, same, soup, together, tube
from tests.skincal.sim_support import make_rig
from tools import solver

PROBE = """
#include "base.h"
static double numbers[4096];
static int places[4096];
__attribute__((visibility("default"))) double *at(void) { return numbers; }
__attribute__((visibility("default"))) int *sorted(int count)
{
    static unsigned char memory[65536];
    top = memory;
    sort_by(numbers, count, places);
    return places;
}
__attribute__((visibility("default"))) double log_of(double x) { return ln(x); }
__attribute__((visibility("default"))) double exp_of(double x) { return power_of_e(x); }
__attribute__((visibility("default"))) double part_of(double x) { int e; return fraction(x, &e); }
__attribute__((visibility("default"))) int exponent_of(double x) { int e; fraction(x, &e); return e; }
__attribute__((visibility("default"))) double two_to(int e) { return power_of_two(e); }
__attribute__((visibility("default"))) double sum_of(int count)
{
    Sum s = {0, 0};
    for (int i = 0; i < count; i++) add(&s, numbers[i]);
    return total_of(s);
}
"""


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    """The functions of `base.h` themselves, compiled with the solver's own flags."""
    folder = tmp_path_factory.mktemp("probe")
    (folder / "probe.c").write_text(PROBE, encoding="utf-8")
    # The probe leaves functions unused.
    flags = [flag for flag in solver.COMPILER_FLAGS if flag != "-Werror"]
    command = [sys.executable, "-m", "ziglang", "cc", *flags, f"-I{solver.C_SOURCE.parent}", "-o", "probe.wasm", "probe.c"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    engine = wasmtime.Engine()
    store = wasmtime.Store(engine)
    exports = wasmtime.Instance(store, wasmtime.Module(engine, (folder / "probe.wasm").read_bytes()), []).exports(store)

    class Probe:
        def __getattr__(self, name):
            return lambda *arguments: exports[name](store, *arguments)

        def fill(self, values):
            exports["memory"].write(store, np.asarray(values, dtype=float).tobytes(), self.at())

        def order(self, count):
            place = self.sorted(count)
            return np.frombuffer(bytes(exports["memory"].read(store, place, place + 4 * count)), dtype=np.int32)

    return Probe()


def test_the_program_equals_its_compiled_source():
    assert solver.build() == SOLVER_PROGRAM.read_bytes(), "run `python -m tools.solver`"


def answers():
    """Bytes of the solver's results: all kinds of metrics on an odd mesh, and all methods on a bad rig."""
    rng = np.random.default_rng(7)
    surface = together(tube(), soup(rng))
    for kind in KINDS:
        found = nearest_in_metric(surface, *random_metrics(rng, surface, 50, kind))
        yield from (found.points.tobytes(), found.triangles.tobytes(), found.values.tobytes())
    rig = make_rig(RigErrors.paper(), 1)
    whole = make_surface(rig.surface.vertices, rig.surface.triangles)
    layout = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, whole)
    contacts = [contact for pose in rig.arm_poses for contact in simulate_contacts(rig, unguided(rig, 1, rng), rng, pose)]
    for method in estimate_taxels(contacts, rig.channels.tolist(), list(Method), rig.scene.noise, whole, model=layout).values():
        yield from estimate_bytes(method)


def estimate_bytes(estimates):
    for estimate in estimates.values():
        yield estimate.state
        yield from (None if value is None else value.tobytes() for value in (estimate.position, estimate.covariance))


def test_the_solver_has_no_undefined_behaviour(tmp_path, monkeypatch):
    """Built so that undefined behaviour ends it, the program finishes with the same bits."""
    shipped = list(answers())
    strict = tmp_path / "strict.wasm"
    strict.write_bytes(solver.build(*solver.TRAP_FLAGS))
    cached = (solver_machine._module, solver_machine.shared)
    with monkeypatch.context() as patch:
        patch.setattr(solver_machine, "SOLVER_PROGRAM", strict)
        [each.cache_clear() for each in cached]
        found = list(answers())
    [each.cache_clear() for each in cached]
    assert found == shipped


def test_the_logarithm_is_right_to_two_roundings(probe):
    rng = np.random.default_rng(1)
    values = [*np.exp(rng.uniform(-700, 700, 2000)), *(1 + rng.uniform(-1e-3, 1e-3, 500)), *rng.uniform(0.5, 2, 500)]
    for x in [*values, 1.0, 5e-324, 2.0**-1022, 1.7976931348623157e308]:
        exact = math.log(x)
        assert abs(probe.log_of(float(x)) - exact) <= 2 * math.ulp(exact) + 1e-19, x
    assert probe.log_of(0.0) == -math.inf
    assert probe.log_of(math.inf) == math.inf
    assert math.isnan(probe.log_of(-1.0))


def test_the_exponential_is_right_to_four_roundings(probe):
    rng = np.random.default_rng(2)
    for x in [*rng.uniform(-700, 700, 2000), *rng.uniform(-1, 1, 1000), 0.0]:
        exact = math.exp(x)
        assert abs(probe.exp_of(float(x)) - exact) <= 4 * math.ulp(exact), x
    assert probe.exp_of(-math.inf) == 0.0
    assert probe.exp_of(-740.0) == pytest.approx(math.exp(-740.0), rel=1e-2)
    assert probe.exp_of(800.0) == math.inf
    assert math.isnan(probe.exp_of(math.nan))


def test_fractions_and_powers_of_two_are_exact(probe):
    rng = np.random.default_rng(3)
    for x in [*rng.normal(size=200) * 2.0 ** rng.integers(-1000, 1000, 200), 5e-324, -3e-310, 0.0, 1.0]:
        assert (probe.part_of(float(x)), probe.exponent_of(float(x))) == math.frexp(x)
    for e in (-1075, -1074, -1050, -1022, -1, 0, 1, 1023):
        assert probe.two_to(e) == math.ldexp(1.0, e)
    assert probe.two_to(1024) == math.inf


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 64, 100, 1000])
def test_sorting_is_stable(probe, count):
    rng = np.random.default_rng(count)
    keys = rng.integers(0, max(count // 3, 1), count).astype(float)
    probe.fill(keys)
    np.testing.assert_array_equal(probe.order(count), np.argsort(keys, kind="stable"))


def test_a_sum_loses_nothing(probe):
    rng = np.random.default_rng(4)
    for _ in range(20):
        values = rng.normal(size=4000) * 10.0 ** rng.uniform(-12, 0, 4000)
        probe.fill(values)
        assert probe.sum_of(4000) == pytest.approx(math.fsum(values), rel=1e-15, abs=1e-18)


def test_threads_take_turns():
    surface = tube(40, 40)
    asked = random_metrics(np.random.default_rng(5), surface, 200, "full rank")
    alone, found = nearest_in_metric(surface, *asked), []
    threads = [threading.Thread(target=lambda: found.append(nearest_in_metric(surface, *asked))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert all(same(alone, other) for other in found)


def test_stored_tables_stay_while_the_memory_grows_and_are_in_the_clone():
    machine, rng, stored = Machine(), np.random.default_rng(6), {}
    for size in (0, 1, 1000, 300_000, 0, 5):
        over = rng.integers(0, 1 << 30, size)
        address = machine.store("Ground", surface=None, over=over)
        assert address not in stored
        stored[address] = over
    squares = rng.uniform(0, 20, 500_000)
    assert len(machine.run("trusts", pokes=len(squares), squares=squares, trust=squares.shape)["trust"]) == len(squares)
    clone = machine.clone_for_thread()
    assert clone is machine.clone_for_thread() is not machine
    stored[machine.store("Ground", surface=None, over=np.arange(7))] = np.arange(7)
    for address, over in stored.items():
        for each in (machine, machine.clone_for_thread()):
            surface, place = each.read(address, SHARED_TABLES["Ground"].dtype.itemsize).view(np.uint32)
            assert surface == 0
            np.testing.assert_array_equal(each.read(int(place), 4 * len(over)).view(np.int32), over)


def test_another_version_of_wasmtime_is_called_as_usual(monkeypatch):
    asked = {"pokes": 3, "squares": np.array([0.0, 1.0, 100.0]), "trust": (3,)}
    direct = Machine().run("trusts", **asked)
    monkeypatch.delattr(wasmtime.Trap, "_from_ptr")
    machine = Machine()
    found = machine.run("trusts", **asked)
    assert isinstance(machine._functions["trusts"], partial)
    assert found["trust"].tolist() == direct["trust"].tolist()


def test_a_cache_folder_that_cannot_be_made_does_not_stop_the_solver(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    solver_machine._module.cache_clear()
    assert Machine().value("heap") > 0
    solver_machine._module.cache_clear()


@pytest.mark.parametrize("surface", [True, False])
def test_two_threads_find_what_one_does_to_the_last_bit(monkeypatch, surface):
    rig = make_rig(RigErrors.paper(), 1)
    rng = np.random.default_rng(8)
    contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng)
    table, channels = ContactTable(contacts), rig.channels.tolist()
    wanted = [method for method in PER_TAXEL if surface or method is not Method.SURFACE]

    def solved(at_once):
        monkeypatch.setattr(methods, "_ANSWERS_PER_SOLVER_CALL", at_once)
        found = methods.estimate_from(table, channels, wanted, rig.scene.noise, rig.surface if surface else None)
        return [list(estimate_bytes(found[method])) for method in wanted]

    told = []
    solve_one = methods.solve
    monkeypatch.setattr(methods, "solve", lambda *asked: (told.append(asked[-1]), solve_one(*asked))[1])
    one = solved(1 << 30)
    assert told == [False]
    assert solved(100) == one
    assert sum(told) == len(told) - 1 - (len(told) - 1) // 3 > 2, "one part in three is left to the thread that asks"
