"""What grows with a robot: generation time, operations, code size and compile time for chains of 2 to 20 links.

    python -m servogen.bench.chain [--links 2,4,8] [--urdf FILE --floating --points A,B] [--limit 300] [--out DIR]

Beside CasADi's own C for the same model and the same recursions, Q solved with by its LDL^T, after `cse`. With --urdf
one robot is measured instead, m = 3 rows a point. Times are the processor's, so that a busy machine does not count.
Needs a C compiler and `size`.
"""

import argparse
import json
import resource
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import servogen as sg
from servogen.bench import user
from servogen.bench.results import Output
from servogen.compiler import compile_functions, derived_scene, target_for
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input
from servogen.render.render import render

LINKS = tuple(range(2, 21, 2))
_GAINS: dict[str, Any] = {"Theta1": -20.0, "Theta2": -100.0}


@dataclass(frozen=True)
class Size:
    """One generator's code for S and z. generated, compiled: seconds; compiled and text (bytes) are None beyond the
    limit."""

    generator: str
    links: int
    rows: int
    operations: int
    generated: float
    compiled: float | None
    text: int | None


def chain(links: int) -> str:
    """URDF of a chain whose joints turn about z, y, z, ..., its bodies without symmetry."""
    parts = ['<robot name="chain"><link name="link0"/>']
    for k in range(1, links + 1):
        axis = "0 0 1" if k % 2 else "0 1 0"
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0.02 -0.01 0.1{k % 10}"/><mass value="1.{k % 10}"/>'
            f'<inertia ixx="0.03" iyy="0.0{2 + k % 3}" izz="0.01" ixy="0.001" ixz="-0.002" iyz="0.003"/>'
            "</inertial></link>"
            f'<joint name="joint{k}" type="continuous"><parent link="link{k - 1}"/><child link="link{k}"/>'
            f'<origin xyz="0 0.01 0.2"/><axis xyz="{axis}"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def positions(robot: sg.urdf.Robot, points: Sequence[str]) -> sg.Scene:
    """The scene that places these frames; of a robot with less than four joints only along x."""
    ref = sg.References(**{f"r_{point}": [0.1, 0.2, 0.3] for point in points})
    size = 3 if len(robot.joints) > 3 else 1
    errors = {point: robot.position(point) - getattr(ref, f"r_{point}") for point in points}
    rows = [sg.Holonomic(point, error[:size], **_GAINS) for point, error in errors.items()]
    base = robot.q.size1() - len(robot.joints)
    low, high = [-2.0] * robot.q.size1(), [2.0] * robot.q.size1()
    if base:
        low[3:7], high[3:7] = [0.4] * 4, [0.6] * 4
    return sg.Scene("chain", robot.mechanism, rows, references=ref, domain={"q": (low, high), "u": (-1.0, 1.0)})


def ours(path: Path, floating: bool, points: Sequence[str], flags: Sequence[str], limit: float) -> Size:
    """From the file to C, and its compilation."""
    start = time.process_time()
    robot = sg.urdf.load(path, base="floating" if floating else "fixed", quiet=True)
    scene = positions(robot, points)
    formulation, _ = derived_scene(scene)
    system = [q for q in formulation.quantities if q.name in ("S", "z")]  # alone: the solver ends at 12 controls
    module = compile_functions(scene, system, formulation.mass, target_for("chain", "float64", None))
    files = {f.name: f.text for f in render(module)}
    seconds = time.process_time() - start
    (entry,) = module.entry_points
    compiled, text = compile_alone(files, flags, limit)
    operations = entry.kernel.program.operations()["total"]
    return Size("servogen", len(robot.joints), scene.rows, operations, seconds, compiled, text)


def casadis(path: Path, floating: bool, points: Sequence[str], flags: Sequence[str], limit: float) -> Size:
    """The same robot's SX, differentiated and solved with by CasADi."""
    start = time.process_time()
    robot = sg.urdf.load(path, base="floating" if floating else "fixed", quiet=True)
    scene = positions(robot, points)
    expressions = user.expressions(scene, ldlt=True)
    S, z = (ca.cse(expressions[o]) for o in (Output.MATRIX, Output.RIGHT))
    system = ca.cse(ca.vertcat(ca.vec(S.T), z))
    arguments = user.arguments(scene)
    function = ca.Function("system", [symbol for _, symbol in arguments], [system])
    with tempfile.TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("system")
        generator.add(function)
        generator.generate(f"{folder}/")
        files = {"system.c": (Path(folder) / "system.c").read_text()}
    seconds = time.process_time() - start
    fields = [(Input(name, symbol.size1()), symbol) for name, symbol in arguments]
    operations = lower_expressions("count", fields, [("out", system)]).operations()["total"]
    compiled, text = compile_alone(files, flags, limit)
    return Size("CasADi cse, LDL^T", len(robot.joints), scene.rows, operations, seconds, compiled, text)


def compile_alone(files: dict[str, str], flags: Sequence[str], limit: float) -> tuple[float | None, int | None]:
    """Seconds and bytes of code; None where the compiler takes longer than `limit`."""

    def within() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (round(limit), round(limit) + 1))

    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text)
        (source,) = (name for name in files if name.endswith(".c"))
        start = _of_children()
        try:
            subprocess.run(["cc", *flags, "-c", source, "-o", "x.o"], cwd=folder, check=True, preexec_fn=within)
        except subprocess.CalledProcessError:
            if _of_children() - start < 0.9 * limit:
                raise
            return None, None
        seconds = _of_children() - start
        sizes = subprocess.run(["size", "x.o"], cwd=folder, check=True, capture_output=True, text=True)
        return seconds, int(sizes.stdout.splitlines()[1].split()[0])


def _of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def draw(sizes: Sequence[Size], folder: Path, flags: Sequence[str]) -> Path:
    """chain.svg: four panels over the number of links; a line ends where the limit was passed."""
    panels = {
        "generated": "generation time, s",
        "operations": "operations of S and z",
        "text": "code, bytes",
        "compiled": f"compile time at {' '.join(flags)}, s",
    }
    figure = Figure(figsize=(13, 3.6))
    FigureCanvasAgg(figure)
    for axes, (name, title) in zip(figure.subplots(1, 4), panels.items(), strict=True):
        for generator, colour in (("servogen", "#b3261e"), ("CasADi cse, LDL^T", "#3b5b7a")):
            rows = [(s.links, getattr(s, name)) for s in sizes if s.generator == generator and getattr(s, name)]
            axes.plot(*zip(*rows, strict=True), "o-", color=colour, markersize=4, label=generator)
        axes.set_yscale("log")
        axes.set_title(title, loc="left", fontsize=10)
        axes.set_xlabel("links of the chain")
        axes.set_xticks(range(2, 21, 6))
        axes.grid(True, color="#e6e6e6", linewidth=0.8)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.axes[0].legend(frameon=False, fontsize=9)
    figure.tight_layout()
    path = folder / "chain.svg"
    with matplotlib.rc_context({"svg.hashsalt": "servogen", "svg.fonttype": "path"}):
        figure.savefig(path, metadata={"Date": None, "Creator": "servogen"})
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--links", default=",".join(map(str, LINKS)))
    parser.add_argument("--urdf", type=Path)
    parser.add_argument("--floating", action="store_true")
    parser.add_argument("--points", default="")
    parser.add_argument("--flags", default="-O2")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds a compiler may take")
    parser.add_argument("--only", choices=("servogen", "casadi"))
    parser.add_argument("--out", type=Path, default=Path("bench"))
    chosen = parser.parse_args()
    flags = chosen.flags.split()
    generators = {"servogen": ours, "casadi": casadis}
    run = [g for name, g in generators.items() if chosen.only in (None, name)]
    sizes = []
    with tempfile.TemporaryDirectory() as folder:
        cases = [(chosen.urdf, chosen.floating, chosen.points.split(","))] if chosen.urdf else []
        for n in [] if chosen.urdf else [int(x) for x in chosen.links.split(",")]:
            path = Path(folder) / f"chain{n}.urdf"
            path.write_text(chain(n))
            cases.append((path, False, [f"link{n}"]))
        for case in cases:
            for generate in run:
                sizes.append(generate(*case, flags, chosen.limit))
                print(json.dumps(asdict(sizes[-1])), flush=True)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "chain.json").write_text(json.dumps([asdict(s) for s in sizes], indent=2) + "\n")
    if len(cases) > 1:
        print(draw(sizes, chosen.out, flags))


if __name__ == "__main__":
    main()
