"""What `info` adds to control: instructions by callgrind, and time in one process.

    python -m servogen.bench.info_cost [SCENE ...] [--bar 15] [--flags=-O2]

Exit 1 where an addition is above the bar, in per cent of the instructions. Needs a C compiler and valgrind.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from servogen.bench import instructions
from servogen.bench.contenders import Call, CContender, output_sizes, servogen_c
from servogen.bench.driver import Driver, compile_driver
from servogen.bench.inputs import Inputs, drawn
from servogen.bench.results import Output
from servogen.loading import builtin_names, load_scene
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene

STATES = 256
ROUNDS = 30
BAR = 15.0
"""Per cent of control's instructions that info may add in a built-in scene."""


class Cost(NamedTuple):
    """Per call of control, the first without info, the second with it."""

    instructions: tuple[float, float]
    nanoseconds: tuple[float, float]

    @property
    def added(self) -> float:
        """Instructions that info adds, in per cent."""
        return 100 * (self.instructions[1] / self.instructions[0] - 1)

    @property
    def time_added(self) -> float:
        return 100 * (self.nanoseconds[1] / self.nanoseconds[0] - 1)


def cost(scene: Scene, scalar: Scalar, folder: Path, flags: tuple[str, ...], compiler: str = "cc") -> Cost:
    """Over STATES states of the scene's domain; the time is the least of ROUNDS."""
    inputs = drawn(scene, STATES, 0)
    plain = servogen_c(scene, inputs, STATES, scalar, (Output.ANSWER,))
    pair = (plain, _with_info(plain))
    driver = compile_driver(pair, output_sizes(scene), inputs, STATES, folder, compiler, flags)
    counted = [instructions.count(driver, inputs, k).total for k in range(2)]
    return Cost((counted[0], counted[1]), _least_times(driver, inputs))


def _with_info(plain: CContender) -> CContender:
    p = plain.calls[Output.ANSWER].symbol.removesuffix("_control")
    asked = Call(f"{p}_control(&model, &inputs[k], out, &info)", f"{p}_control")
    return replace(
        plain,
        name=f"{plain.name} with info",
        identifier=f"{plain.identifier}_info",
        declarations=f"{plain.declarations}\n\nstatic {p}_info info;",
        calls={Output.ANSWER: asked},
    )


def _least_times(driver: Driver, inputs: Inputs) -> tuple[float, float]:
    rounds = [driver.times(inputs, STATES, 4, start) for start in range(ROUNDS)]
    least = np.min(np.concatenate(rounds, axis=1), axis=1)
    return float(least[0]), float(least[1])


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(builtin_names()))
    parser.add_argument("--bar", type=float, default=BAR, help="per cent")
    parser.add_argument("--flags", default="-O2", help="of the compiler")
    chosen = parser.parse_args()
    above = False
    for name in chosen.scenes:
        scene = load_scene(name)
        for scalar in EPSILON:
            with TemporaryDirectory(prefix="servogen-info-") as folder:
                found = cost(scene, scalar, Path(folder), tuple(chosen.flags.split()))
            above |= found.added > chosen.bar
            counts, times = found.instructions, found.nanoseconds
            print(
                f"{name:32s}{scalar:8s} {counts[0]:7.0f} -> {counts[1]:7.0f} instructions, +{found.added:5.1f} %"
                f"   {times[0]:7.1f} -> {times[1]:7.1f} ns, +{found.time_added:5.1f} %",
                flush=True,
            )
    return int(above)


if __name__ == "__main__":
    sys.exit(main())
