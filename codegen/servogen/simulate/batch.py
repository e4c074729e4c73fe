"""Many runs of one compiled loop without their rows, as a job that any process on a like machine can do."""

import ctypes as ct
import hashlib
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from servogen.results import FloatArray
from servogen.scalars import Scalar
from servogen.twins.compiled import c_real

SUM_STATUSES, SUM_CONTROLS = 8, 12
"""As in firmware_sim/simulate/summary.h."""


@dataclass(frozen=True, eq=False)
class Job:
    """What all runs share. Picklable: the loop is the bytes of its shared library.

    arrays, reals, numbers: of <prefix>_setup, in its order. sizes: of q, u, tau and psi. claim: the arrays of
    sum_claim; rows: of a run that finishes.
    """

    library: bytes
    prefix: str
    scalar: Scalar
    arrays: dict[str, FloatArray]
    reals: dict[str, float]
    numbers: dict[str, int]
    sizes: tuple[int, int, int, int]
    claim: dict[str, Any]
    rows: int


@dataclass(frozen=True, eq=False)
class Part:
    """Some of the runs: own arrays (N, size) by name, seeds (N,), and the prescribed state at the start (N, n)."""

    arrays: dict[str, FloatArray]
    seeds: Any
    states: FloatArray


def do(job: Job, part: Part) -> Any:
    """The runs of a part: a structured array (N,), sum_run of simulate/summary.h, and reason, detail, t of its end."""
    library = _library(job.library)
    real = np.dtype(job.scalar)
    setup_type, stop_type = setup_struct(job.scalar), stop_struct(job.scalar)
    shared = {n: np.ascontiguousarray(a, real) for n, a in job.arrays.items()}
    own = {n: np.ascontiguousarray(a, real) for n, a in part.arrays.items()}
    claim_arrays = {n: np.ascontiguousarray(a) for n, a in job.claim.items()}
    claim = _Claim(*job.sizes, *(claim_arrays[n].ctypes.data for n in ("low", "high", "angle", "tolerance")))
    claim.states = part.states.shape[1]
    claim.forward, claim.place = (claim_arrays[n].ctypes.data for n in ("forward", "place"))
    claim.rows = job.rows
    begin, advance, sum_begin = (
        getattr(library, n) for n in (f"{job.prefix}_begin", f"{job.prefix}_advance", "sum_begin")
    )
    size = getattr(library, f"{job.prefix}_run_bytes")
    size.restype = ct.c_size_t
    run = (ct.c_double * (size() // 8 + 1))()
    found = np.zeros(len(part.seeds), OUTCOME)
    stop, summary = stop_type(), _Run()
    numbers = dict(job.numbers)
    for k, seed in enumerate(part.seeds):
        state = np.concatenate([part.states[k], np.zeros(part.states.shape[1])])
        numbers["seed"] = int(seed)
        pointers = (own[n][k].ctypes.data if n in own else a.ctypes.data for n, a in shared.items())
        setup = setup_type(*pointers, *job.reals.values(), *numbers.values())
        sum_begin(ct.byref(summary), ct.byref(claim), ct.c_void_p(state.ctypes.data))
        begin(run, ct.byref(setup), library.sum_keep, ct.byref(summary))
        advance(run, ct.c_uint32(2**32 - 1), library.sum_keep, ct.byref(summary), ct.byref(stop))
        for name in SUMMARY.names or ():
            found[name][k] = getattr(summary, name)
        found["reason"][k], found["detail"][k], found["t"][k] = stop.reason, stop.detail, stop.t
    return found


@lru_cache(maxsize=8)
def _library(content: bytes) -> ct.CDLL:
    """Loaded once in a process; the file may go as soon as it is mapped."""
    with tempfile.TemporaryDirectory(prefix="servogen-runs-") as folder:
        file = Path(folder) / f"{hashlib.sha256(content).hexdigest()[:16]}.so"
        file.write_bytes(content)
        return ct.CDLL(str(file))


def setup_struct(scalar: Scalar) -> Any:
    """<prefix>_setup."""
    names = ("parameters", "plant", "q", "u", "tau", "given", "limit", "slew", "keep", "mean", "noise", "quantum")
    fields: list[tuple[str, Any]] = [(n, ct.c_void_p) for n in names]
    fields += [(n, c_real(scalar)) for n in ("step", "tick")]
    fields += [(n, ct.c_uint32) for n in ("substeps", "steps", "row_every", "tick_every", "delay", "seed")]
    fields += [(n, ct.c_int) for n in ("method", "hold", "frugal", "project")]
    fields += [(n, ct.c_void_p) for n in ("physics", "world")]
    return type("Setup", (ct.Structure,), {"_fields_": fields})


def stop_struct(scalar: Scalar) -> Any:
    """sim_stop."""
    fields = [("reason", ct.c_int), ("detail", ct.c_int), ("t", c_real(scalar))]
    return type("Stop", (ct.Structure,), {"_fields_": fields})


class _Claim(ct.Structure):
    """sum_claim."""

    _fields_ = [
        *((n, ct.c_int) for n in ("q", "u", "tau", "constraint")),
        *((n, ct.c_void_p) for n in ("low", "high", "angle", "tolerance")),
        ("states", ct.c_int),
        *((n, ct.c_void_p) for n in ("forward", "place")),
        ("rows", ct.c_int64),
    ]


class _Run(ct.Structure):
    """sum_run."""

    _fields_ = [
        *((n, ct.c_void_p) for n in ("claim", "state")),
        *((n, ct.c_double * SUM_CONTROLS) for n in ("error", "end", "tau")),
        *((n, ct.c_double) for n in ("share", "third", "last")),
        *((n, ct.c_int64) for n in ("rows", "off", "left", "inconsistent", "limited", "rows_limited")),
        ("statuses", ct.c_int64 * SUM_STATUSES),
    ]


SUMMARY = np.dtype(
    [
        *((n, np.float64, (SUM_CONTROLS,)) for n in ("error", "end", "tau")),
        *((n, np.float64) for n in ("share", "third", "last")),
        *((n, np.int64) for n in ("rows", "off", "left", "inconsistent", "limited", "rows_limited")),
        ("statuses", np.int64, (SUM_STATUSES,)),
    ]
)
OUTCOME = np.dtype([*SUMMARY.descr, ("reason", np.int32), ("detail", np.int32), ("t", np.float64)])
