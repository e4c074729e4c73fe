"""Were certificates ever given in vain? Millions of systems, decided by the inertia of S S^T - LB^2 I in 113 bits."""

import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from servogen.compiler import build_solver
from servogen.plan.solver import plan_solver
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver
from servogen.tools import find_tool

SOURCE = Path(__file__).with_name("false_certificates.c")


@dataclass(frozen=True)
class FalseCertificates:
    """How many of `systems` each step accepted, and in vain. quick: the QR of solve; qr: that of the ladder behind."""

    m: int
    l: int
    scalar: Scalar
    seed: int
    systems: int
    normal: int
    false_normal: int
    qr: int
    false_qr: int
    quick: int
    false_quick: int
    bounds: int
    high_bounds: int
    low_bounds: int


def false_certificates(m: int, l: int, scalar: Scalar, systems: int, seed: int = 1) -> FalseCertificates:
    """Counts for one shape, 2 <= m <= l. Raises ToolMissing without gcc (its __float128 decides)."""
    if not 2 <= m <= l:
        raise ValueError(f"{m} x {l}: certificates are those of wide shapes of two rows or more")
    compiler = find_tool("gcc", "gcc")
    plan = plan_solver(m, l, scalar, Solver())
    with tempfile.TemporaryDirectory(prefix="servogen-certificates-") as name:
        folder = Path(name)
        build_solver(m, l, folder, scalar=scalar, prefix="pinv")
        numbers = {
            "ROWS": m, "COLUMNS": l, "REAL": plan.real, "SOURCE": '"pinv.c"', "RTOL": plan.rtol.hex(),
            "NORMAL_LIMIT": plan.normal_limit.hex(), "NORMAL_ROUNDING": plan.normal_rounding.hex(),
            "EPSILON": EPSILON[scalar].hex(),
        }  # fmt: skip
        defines = [f"-D{key}={value}" for key, value in numbers.items()]
        command = [str(compiler), "-std=gnu99", "-O2", "-ffp-contract=off", *defines, f"-I{folder}", str(SOURCE)]
        subprocess.run([*command, "-o", str(folder / "count"), "-lm"], check=True, capture_output=True)
        done = subprocess.run(
            [str(folder / "count"), str(systems), str(seed)], check=True, capture_output=True, text=True
        )
    counts = [int(word) for word in done.stdout.split()]
    return FalseCertificates(m, l, scalar, seed, *counts)
