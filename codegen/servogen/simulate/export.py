"""A trajectory as text: one CSV file."""

from pathlib import Path
from typing import Any

from servogen.simulate.trajectory import Trajectory


def write_csv(trajectory: Trajectory, file: Path) -> Path:
    """One line a row: t, q_0.., u_0.., tau_0.., psi_0.. (phi_0..), status, rank, sigma_min, the outputs by name.

    Numbers read back as the same ones.
    """
    columns: list[tuple[str, Any]] = [("t", trajectory.t)]
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
    texts = [[str(number) for number in column] for _, column in columns]  # the shortest that reads back
    lines = (",".join(row) for row in zip(*texts, strict=True))
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8", newline="\n")
    return file
