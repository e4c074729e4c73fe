"""How a scene's own file wants it simulated."""

from servogen.errors import SceneError
from servogen.loading import load
from servogen.scene.scene import Scene
from servogen.simulate.simulation import Simulation, with_units_of_rates


def load_simulation(spec: str) -> tuple[Scene, Simulation]:
    """The scene that `spec` names, and how its file wants it simulated.

    That is the file's variable `simulation` for its variable `scene` or its only scene, `<variable>_simulation` for
    a scene of another name; defaults where there is none.
    """
    module, scene = load(spec)
    scenes = {name: value for name, value in vars(module).items() if isinstance(value, Scene)}
    names = [f"{name}_simulation" for name, value in scenes.items() if value is scene]
    if scenes.get("scene") is scene or len({id(s) for s in scenes.values()}) == 1:
        names.append("simulation")
    found = [vars(module)[name] for name in names if name in vars(module)]
    if found and not isinstance(found[0], Simulation):
        raise SceneError(f"{spec}: the variable simulation is a {type(found[0]).__name__}; make it an sg.Simulation")
    return scene, with_units_of_rates(scene, found[0] if found else Simulation())
