"""A trajectory as text: one CSV file."""

from pathlib import Path

import numpy as np

from servogen.results import FloatArray
from servogen.simulate.trajectory import Trajectory


def write_csv(trajectory: Trajectory, file: Path) -> Path:
    """One line a row: t, q_0.., u_0.., tau_0.., psi_0.. (phi_0..), status, rank, sigma_min, the outputs by name.

    Numbers read back as the same ones.
    """
    columns: list[tuple[str, FloatArray]] = [("t", trajectory.t)]
    for name, values in (
        ("q", trajectory.q),
        ("u", trajectory.u),
        ("tau", trajectory.tau),
        (trajectory.constraint_name, trajectory.constraint),
    ):
        columns += [(f"{name}_{k}", values[:, k]) for k in range(values.shape[1])]
    columns += [("status", trajectory.status), ("rank", trajectory.rank), ("sigma_min", trajectory.sigma_min)]
    columns += list(trajectory.outputs.items())
    header = ",".join(f'"{name}"' if "," in name else name for name, _ in columns)
    lines = (",".join(_text(x) for x in row) for row in zip(*(c for _, c in columns), strict=True))
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8", newline="\n")
    return file


def _text(number: np.generic) -> str:
    return str(number.item()) if isinstance(number, np.integer) else np.format_float_positional(number, trim="-") \
        if 1e-5 <= abs(number) < 1e16 or number == 0 else np.format_float_scientific(number, trim="-")
