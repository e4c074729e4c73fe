"""A trajectory, or what many runs came to, as text: one CSV file."""

from pathlib import Path
from typing import Any

from servogen.simulate.runs import Runs
from servogen.simulate.trajectory import Trajectory


def write_runs_csv(runs: Runs, file: Path) -> Path:
    """One line a run: seed, verdict, t of its end, what it drew, error and end of each row of psi, largest controls."""
    columns: list[tuple[str, Any]] = [("seed", runs.seeds), ("verdict", runs.words), ("t", runs.t)]
    columns += [(n, runs.draws[:, k]) for k, n in enumerate(runs.names)]
    for name, values in (("error", runs.error), ("end", runs.end), ("tau", runs.tau)):
        columns += [(f"{name}_{k}", values[:, k]) for k in range(values.shape[1])]
    columns += [("share_of_tolerance", runs.share), ("rows_limited", runs.rows_limited)]
    texts = [[_cell(str(entry)) for entry in column] for _, column in columns]
    lines = [",".join(_cell(name) for name, _ in columns), *(",".join(row) for row in zip(*texts, strict=True))]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return file


def _cell(text: str) -> str:
    return f'"{text}"' if "," in text else text


def write_csv(trajectory: Trajectory, file: Path) -> Path:
    """One line a row: t, q_0.., u_0.., tau_0.., psi_0.. (phi_0..), status, rank, sigma_min, drift where there are
    passive constraints, the outputs by name.

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
    columns += [("drift", trajectory.drift)] if len(trajectory.drift) else []
    columns += list(trajectory.outputs.items())
    header = ",".join(_cell(name) for name, _ in columns)
    texts = [[str(number) for number in column] for _, column in columns]  # the shortest that reads back
    lines = (",".join(row) for row in zip(*texts, strict=True))
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8", newline="\n")
    return file
