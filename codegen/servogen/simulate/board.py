"""The closed loop inside an emulated board: controller and plant in one image, the rows out by semihosting."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servogen.render.render import environment
from servogen.results import FloatArray
from servogen.scalars import Scalar
from servogen.simulate.sources import LoopSources
from servogen.tools import firmware_sim


class BoardRunError(RuntimeError):
    """The image did not run to its end; the message holds what it said."""


@dataclass(frozen=True)
class Setup:
    """What <prefix>_setup of the C holds, in its order: arrays by name, real and whole numbers by name."""

    arrays: dict[str, FloatArray]
    reals: dict[str, float]
    numbers: dict[str, int]


def run_on_board(
    sources: LoopSources, sizes: Sequence[int], setup: Setup, scalar: Scalar, target: str, build_dir: Path
) -> tuple[FloatArray, Any, tuple[int, int, float]]:
    """Build the loop's image and run it: rows (N, sum(sizes) + 2), marks (N, 3), and reason, detail, t of its end.

    Raises ToolMissing, HarnessBuildError, and BoardRunError where the run breaks off.
    """
    # here, for only a run on a board needs it, and it takes its time to import
    from servogen.verify.harness import (
        build_images,
        complaint_of,
        execute,
        floats_of,
        require_target,
        words_of,
        write_if_changed,
    )
    from servogen.verify.vectors import literal

    require_target(target)
    prefix = sources.controller.prefix
    text = (
        environment()
        .get_template("setup.h.j2")
        .render(
            p=prefix,
            sizes=sizes,
            arrays=[(n, [literal(float(x), scalar) for x in v] or ["0"]) for n, v in setup.arrays.items()],
            numbers=[
                *(literal(float(np.dtype(scalar).type(x)), scalar) for x in setup.reals.values()),
                *setup.numbers.values(),
            ],
        )
    )
    header = build_dir / "vectors" / f"{prefix}_setup.h"
    write_if_changed(header, text)
    files = (firmware_sim() / "simulate" / "main.c", sources.controller.path / f"{prefix}.c", *sources.sources)
    folders = (header.parent, sources.controller.path, *sources.include_folders)
    options = {
        "PROGRAM": ";".join(f.resolve().as_posix() for f in files),
        "PROGRAM_FOLDERS": ";".join(f.resolve().as_posix() for f in folders),
        "PROGRAM_HEADER": header.name,
        "PROGRAM_BITS": "64" if scalar == "float64" else "32",
    }
    command = build_images([], target, "gcc", build_dir, options)["program"]
    code, log = execute(command, timeout=24 * 3600.0)
    lines = [words_of(line) for line in log.splitlines()]
    end = next((w for w in lines if w[""] == "stop"), None)
    if end is None or code != 0:
        raise BoardRunError(f"{prefix} on {target} broke off: {complaint_of(log, code) or 'no end was printed'}")
    rows = [floats_of(w["bits"].rstrip(",")) for w in lines if w[""] == "row"]
    marks = [(int(w["status"]), int(w["rank"]), int(w["limited"])) for w in lines if w[""] == "row"]
    width = sum(sizes) + 2
    values = np.array(rows, np.dtype(scalar)).reshape(-1, width)
    stop = int(end["reason"]), int(end["detail"]), float(floats_of(end["bits"].rstrip(","))[0])
    return values, np.array(marks, np.int32).reshape(-1, 3), stop
