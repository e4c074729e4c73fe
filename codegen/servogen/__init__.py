"""servogen: from servo-constraints on a mechanical model, written in CasADi SX, to dependency-free C.

The method is Bajodah, Hodges and Chen, "Inverse Dynamics of Servo-Constraints Based on the Generalized Inverse" (2004).
"""

from servogen import mjcf, urdf
from servogen.analysis.analyse import Analysis, analyse
from servogen.compiler import build, build_solver, reference
from servogen.errors import SceneError
from servogen.fmu.unit import build_fmu
from servogen.package import Package
from servogen.remarks import Remark
from servogen.results import Batch, Control, Info, Path, Status
from servogen.scene.constraints import ControlsInvolved, Holonomic, Nonholonomic, Output
from servogen.scene.limits import Limits
from servogen.scene.mechanism import Mechanism
from servogen.scene.passive import PassiveHolonomic, PassiveNonholonomic
from servogen.scene.scene import Scene
from servogen.scene.solver import Solver
from servogen.scene.symbols import Parameter, Parameters, Ref, References
from servogen.simulate.machine import Actuators
from servogen.simulate.simulation import Simulation
from servogen.version import VERSION

__version__ = VERSION

__all__ = [
    "Actuators",
    "Analysis",
    "Batch",
    "Control",
    "ControlsInvolved",
    "Holonomic",
    "Info",
    "Limits",
    "Mechanism",
    "Nonholonomic",
    "Output",
    "Package",
    "Parameter",
    "Parameters",
    "PassiveHolonomic",
    "PassiveNonholonomic",
    "Path",
    "Ref",
    "References",
    "Remark",
    "Scene",
    "SceneError",
    "Simulation",
    "Solver",
    "Status",
    "__version__",
    "analyse",
    "build",
    "build_fmu",
    "build_solver",
    "mjcf",
    "reference",
    "urdf",
]
