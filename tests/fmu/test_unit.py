"""Functional Mock-up Units: valid by FMI's own rules, and together the same machine as servogen's loop, to the bit."""

import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest
import servogen as sg
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.wanted import load_simulation

HOLD = 0.002
STEPS = 60
FLAGS = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wmissing-prototypes -Wshadow -Werror"


class Unit:
    """An instance of a unit, its variables by name."""

    def __init__(self, file: Path, folder: Path) -> None:
        described = fmpy.read_model_description(str(file))
        self.variables = {v.name: v for v in described.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU3Slave(
            guid=described.instantiationToken,
            modelIdentifier=described.coSimulation.modelIdentifier,
            unzipDirectory=fmpy.extract(str(file), str(folder)),
            instanceName="unit",
        )
        self.fmu.instantiate(
            loggingOn=True, logMessage=lambda _env, _status, _category, text: self.messages.append(text.decode())
        )

    def start(self, **values: Any) -> None:
        self.fmu.enterInitializationMode()
        self.put(**values)
        self.fmu.exitInitializationMode()

    def put(self, **values: Any) -> None:
        for name, value in values.items():
            v = self.variables[name.replace("__", ".")]
            numbers = [float(x) for x in np.atleast_1d(value)] if v.type.startswith("Float") else [int(value)]
            getattr(self.fmu, f"set{v.type}")([v.valueReference], numbers)

    def get(self, name: str) -> Any:
        v = self.variables[name]
        size = int(np.prod([int(d.start) for d in v.dimensions], initial=1))
        return np.array(getattr(self.fmu, f"get{v.type}")([v.valueReference], size))

    def step(self, k: int) -> None:
        self.fmu.doStep(k * HOLD, HOLD)

    def names(self, causality: str) -> set[str]:
        return {n for n, v in self.variables.items() if v.causality == causality}


@pytest.fixture(scope="module", params=["planar_arm_3r", "spacecraft"])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[sg.Scene, dict[str, Path]]:
    """A scene, and the files of its controller and its plant. The second one integrates its controls itself."""
    scene, simulation = load_simulation(request.param)
    folder = tmp_path_factory.mktemp("units")
    files = {
        name: sg.build_fmu(scene, folder, plant=name == "plant", simulation=simulation)
        for name in ("controller", "plant")
    }
    return scene, files


@pytest.fixture
def units(pair: tuple[sg.Scene, dict[str, Path]], tmp_path: Path) -> Iterator[tuple[Unit, Unit]]:
    controller, plant = (Unit(file, tmp_path / name) for name, file in pair[1].items())
    yield controller, plant
    for unit in (controller, plant):
        unit.fmu.terminate()
        unit.fmu.freeInstance()


@pytest.fixture(scope="module")
def loop(pair: tuple[sg.Scene, dict[str, Path]]) -> ClosedLoop:
    scene = pair[0]
    start = load_simulation(scene.name)[1].start
    return ClosedLoop(scene, sg.Simulation(start=start, duration=STEPS * HOLD, step=HOLD, hold=HOLD))


def test_valid_by_the_standards_rules(pair: tuple[sg.Scene, dict[str, Path]]) -> None:
    for file in pair[1].values():
        assert validate_fmu(str(file)) == []


def _started(controller: Unit, plant: Unit) -> None:
    """Both initialised, the controller at the plant's state, the plant under the controller's first answer."""
    plant.start()
    controller.start(**_read(controller, plant))
    plant.put(tau=controller.get("tau"))


def _read(controller: Unit, plant: Unit) -> dict[str, Any]:
    """What the controller's inputs take of the plant's outputs."""
    return {n: plant.get(n) for n in ("q", "u") if n in controller.names("input")}


def test_the_loop_bit_by_bit(units: tuple[Unit, Unit], loop: ClosedLoop) -> None:
    """Controller before plant in each step is a controller without delay."""
    controller, plant = units
    run = loop.run()
    _started(controller, plant)
    for k in range(STEPS):
        np.testing.assert_array_equal(plant.get("q"), run.q[k])
        np.testing.assert_array_equal(plant.get("u"), run.u[k])
        controller.put(**_read(controller, plant))
        controller.step(k)
        plant.put(tau=controller.get("tau"))
        np.testing.assert_array_equal(controller.get("tau"), run.tau[k])
        assert controller.get("info.status")[0] == run.status[k]
        assert controller.get("info.rank")[0] == run.rank[k]
        plant.step(k)
    assert np.any(run.u[0] != run.u[STEPS - 1])  # it moved


def test_both_at_once_is_a_delay_of_one_tick(units: tuple[Unit, Unit], loop: ClosedLoop) -> None:
    controller, plant = units
    run = loop.run(delay=HOLD)
    _started(controller, plant)
    for k in range(STEPS):
        np.testing.assert_array_equal(np.hstack([plant.get("q"), plant.get("u")]), np.hstack([run.q[k], run.u[k]]))
        controller.put(**_read(controller, plant))
        controller.step(k)
        plant.step(k)
        plant.put(tau=controller.get("tau"))


def test_a_tick_only_so_often(units: tuple[Unit, Unit]) -> None:
    controller, plant = units
    controller.fmu.enterInitializationMode()
    controller.put(settings__hold=3 * HOLD)
    controller.fmu.exitInitializationMode()
    seen = []
    for k in range(9):
        controller.put(u=plant.get("u") + 0.01 * k)
        controller.step(k)
        seen.append(tuple(controller.get("tau")))
    assert [len({*seen[k : k + 3]}) for k in (0, 3, 6)] == [1, 1, 1]
    assert len({seen[0], seen[3], seen[6]}) == 3


def test_a_snapshot_and_bytes_bring_the_state_back(units: tuple[Unit, Unit]) -> None:
    _, plant = units
    plant.start(tau=np.full(plant.get("tau").size, 0.3))
    plant.step(0)
    state = plant.fmu.getFMUState()
    plant.step(1)
    once = plant.get("q")
    plant.fmu.setFMUState(plant.fmu.deserializeFMUState(plant.fmu.serializeFMUState(state)))
    plant.step(1)
    np.testing.assert_array_equal(plant.get("q"), once)
    plant.fmu.freeFMUState(state)
    plant.fmu.reset()
    plant.start(tau=np.full(plant.get("tau").size, 0.3))
    plant.step(0)
    plant.step(1)
    np.testing.assert_array_equal(plant.get("q"), once)


def test_a_refusal_keeps_the_command_and_the_state(units: tuple[Unit, Unit]) -> None:
    controller, plant = units
    _started(controller, plant)
    controller.step(0)
    command = controller.get("tau")
    controller.put(u=np.full(plant.get("u").size, np.nan))
    controller.step(1)
    assert controller.get("info.status")[0] == sg.Status.NONFINITE
    np.testing.assert_array_equal(controller.get("tau"), command)
    assert "returned status -1" in controller.messages[-1]
    before = plant.get("q"), plant.get("u")
    plant.put(tau=np.full(command.size, np.inf))
    with pytest.raises(FMICallException) as failed:
        plant.step(1)
    assert failed.value.status == 2  # discarded: another step may be tried
    np.testing.assert_array_equal(np.hstack([plant.get("q"), plant.get("u")]), np.hstack(before))


def test_a_parameter_changes_between_steps_and_settings_do_not(units: tuple[Unit, Unit]) -> None:
    _, plant = units
    plant.start(tau=np.ones(plant.get("tau").size))
    name = sorted(plant.names("parameter") - {"settings.substeps", "settings.method"})[0]
    state = plant.fmu.getFMUState()
    plant.step(0)
    light = plant.get("u")
    plant.fmu.setFMUState(state)
    plant.put(**{name: 1.5 * plant.get(name)})
    plant.step(0)
    assert not np.array_equal(plant.get("u"), light)
    plant.fmu.freeFMUState(state)
    with pytest.raises(FMICallException):
        plant.put(settings__substeps=4)
    assert "cannot be set now" in plant.messages[-1]
    with pytest.raises(FMICallException):
        plant.put(q=plant.get("q"))
    plant.fmu.reset()
    with pytest.raises(FMICallException):
        plant.start(settings__substeps=0)
    plant.fmu.reset()


def test_sources_compile_strictly_and_link_beside_others(
    pair: tuple[sg.Scene, dict[str, Path]], tmp_path: Path
) -> None:
    """As a source unit every function has the identifier before it."""
    if shutil.which("gcc") is None or shutil.which("nm") is None:
        pytest.skip("no gcc, no nm")
    for file in pair[1].values():
        folder = tmp_path / file.stem
        zipfile.ZipFile(file).extractall(folder)
        shell, built = folder / f"sources/{file.stem}_fmu.c", tmp_path / f"{file.stem}.o"
        options = [*FLAGS.split(), "-DSERVOGEN_SCALAR_BITS=64", f"-I{folder / 'sources'}"]
        subprocess.run(["gcc", *options, "-c", str(shell), "-o", str(built)], check=True)
        symbols = subprocess.run(["nm", "-g", "--defined-only", str(built)], capture_output=True, text=True).stdout
        assert {line.split()[-1].startswith(f"{file.stem}_fmi3") for line in symbols.splitlines()} == {True}
        headers = (folder / "sources/fmi3Functions.h").read_text()
        exported = {w.strip(";") for w in headers.split() if w.startswith("fmi3") and w.endswith(";")}
        assert {line.split("_fmi3")[-1] for line in symbols.splitlines()} == {name[4:] for name in exported}


def test_the_same_scene_the_same_bytes(pair: tuple[sg.Scene, dict[str, Path]], tmp_path: Path) -> None:
    scene, files = pair
    simulation = load_simulation(scene.name)[1]
    again = sg.build_fmu(scene, tmp_path, plant=True, simulation=simulation)
    assert again.read_bytes() == files["plant"].read_bytes()


def test_what_does_not_fit_is_refused(pair: tuple[sg.Scene, dict[str, Path]], tmp_path: Path) -> None:
    scene = pair[0]
    (tmp_path / "file").write_text("")
    with pytest.raises(sg.SceneError, match="is a file, or lies below one"):
        sg.build_fmu(scene, tmp_path / "file", binary=False)
    with pytest.raises(sg.SceneError, match="start: 'v' is unknown"):
        sg.build_fmu(scene, tmp_path, simulation=sg.Simulation(start={"v": 1.0}))


def test_a_unit_starts_on_the_plants_passive_constraints(tmp_path: Path) -> None:
    q, u, f = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("f")
    par = sg.Parameters(rod=1.0)
    rod = sg.PassiveHolonomic("rod", q[1] - q[0] - par.rod)
    mech = sg.Mechanism(q=q, u=u, tau=f, Q=ca.DM.eye(2), P=[0, 0], G=[1, 0], passive=[rod])
    scene = sg.Scene("pushed", mech, [sg.Nonholonomic("v", u[0] - 1, Theta=-2.0)], parameters=par)
    simulation = sg.Simulation(start={"q": [0, 2], "u": [1, 0]}, plant={"rod": 3.0})
    for plant in (False, True):
        file = sg.build_fmu(scene, tmp_path, plant=plant, simulation=simulation, binary=False)
        start = {v.name: v.start for v in fmpy.read_model_description(str(file)).modelVariables}
        assert np.allclose(np.array(start["q"].split(), float), [-0.5, 2.5])
        assert np.allclose(np.array(start["u"].split(), float), [0.5, 0.5])
