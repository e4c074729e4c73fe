"""All rivals of one scene, and ours with each pass of the optimiser left out."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

from servogen.bench.contenders import BASELINE, CContender, Contender, casadi_c, servogen_c
from servogen.bench.inputs import Inputs
from servogen.bench.peers.robots import adam_scene, pinocchio_c
from servogen.bench.peers.sympy_c import sympy_c
from servogen.bench.results import Bench, Output
from servogen.bench.run import bench
from servogen.loading import load_scene, scene_module
from servogen.optimise.search import SEARCH
from servogen.scene.scene import Scene
from servogen.tools import ToolMissing
from servogen.urdf.load import load

OUTPUTS = (Output.SYSTEM, Output.ANSWER)
NAIVE = "CasADi"
WITHOUT_WEIGHT = "the constraint alone is compared, without the scene's weight and y, which the peers do not have"
AS_WRITTEN = (
    "CasADi with adam's model and Pinocchio take the URDF's 1.57079632679 as written, servogen as a quarter turn: "
    "what they differ by is most of their error here"
)


def bench_peers(spec: str, flags: Sequence[str] = ("-O2",), **options: Any) -> Bench:
    """`bench` of the scene that `spec` names, with all its peers; options as of `bench`."""
    peers = Peers(scene_module(spec), flags)
    result = bench(peers.scene or load_scene(spec), flags=flags, contenders=peers, **options)
    return replace(result, remarks=(*result.remarks, *peers.remarks))


class Peers:
    """Chooses the contenders of a scene from its file; `remarks` says who is missing, and how to get him."""

    def __init__(self, module: ModuleType, flags: Sequence[str], ablation: bool = True) -> None:
        self.module, self.flags, self.ablation = module, flags, ablation
        self.remarks: list[str] = []
        self.scene: Scene | None = None  # what is compared, where it is not the file's own scene
        if hasattr(module, "scene_of"):
            self.scene = module.scene_of(load(module.ROBOT_FILE, quiet=True))
            self.remarks.append(WITHOUT_WEIGHT)

    def __call__(self, scene: Scene, inputs: Inputs, capacity: int) -> Sequence[Contender]:
        found: list[Contender] = [servogen_c(scene, inputs, capacity, s, OUTPUTS) for s in ("float64", "float32")]
        rival = scene
        if hasattr(self.module, "scene_of"):
            found += self._if_present(lambda: self._with_adam(inputs, capacity))
            rival = self._adam or scene
            if self._adam is not None and load(self.module.ROBOT_FILE, quiet=True).notes:
                self.remarks.append(AS_WRITTEN)
        for name, cse, ldlt in ((NAIVE, False, False), (BASELINE, True, False), (f"{BASELINE}, LDL^T", True, True)):
            found.append(casadi_c(rival, inputs, capacity, name, cse, outputs=OUTPUTS, ldlt=ldlt))
        found += self._if_present(lambda: [sympy_c(scene, inputs, capacity)])
        if hasattr(self.module, "scene_of"):
            found += self._if_present(lambda: [pinocchio_c(self.module, inputs, capacity, self.flags)])
        if self.ablation:
            for name in SEARCH:
                without = frozenset([name])
                found.append(servogen_c(scene, inputs, capacity, "float64", (Output.SYSTEM,), without))
        return found

    _adam: Scene | None = None

    def _with_adam(self, inputs: Inputs, capacity: int) -> list[CContender]:
        self._adam = adam_scene(self.module)
        return [servogen_c(self._adam, inputs, capacity, "float64", OUTPUTS, name="servogen, adam's model")]

    def _if_present(self, make: Callable[[], list[CContender]]) -> list[CContender]:
        try:
            return make()
        except ToolMissing as missing:
            self.remarks.append(str(missing))
            return []
