"""SCENE on the command line: a built-in name, or path/to/file.py[:variable]."""

import importlib
import importlib.util
import pkgutil
import sys
import traceback
from pathlib import Path
from types import ModuleType

import servogen.scenes
from servogen.errors import SceneError
from servogen.scene.scene import Scene


def builtin_names() -> tuple[str, ...]:
    """The built-in scenes by name, sorted."""
    return tuple(sorted(m.name for m in pkgutil.iter_modules(servogen.scenes.__path__)))


def builtin_summary(name: str) -> str:
    """The first sentence of a built-in scene's file."""
    text = importlib.import_module(f"servogen.scenes.{name}").__doc__ or ""
    return text.strip().splitlines()[0]


def load_scene(spec: str) -> Scene:
    """The scene that `spec` names. SceneError for what does not exist, does not run or is no scene."""
    if spec in builtin_names():
        scene = importlib.import_module(f"servogen.scenes.{spec}").scene
        assert isinstance(scene, Scene)
        return scene
    path, _, variable = spec.partition(":") if not Path(spec).exists() else (spec, "", "")
    file = Path(path)
    if not file.is_file():
        raise SceneError(
            f"no scene {spec!r}: neither a built-in one ({', '.join(builtin_names())}) nor a file; "
            "give path/to/file.py or path/to/file.py:variable"
        )
    return _scene_of(_run(file), file, variable or None)


def _run(file: Path) -> ModuleType:
    loader = importlib.util.spec_from_file_location(file.stem, file)
    if loader is None or loader.loader is None:
        raise SceneError(f"{file} is no Python file; its name must end in .py")
    module = importlib.util.module_from_spec(loader)
    sys.path.insert(0, str(file.parent))  # so that a scene can import its neighbours
    try:
        loader.loader.exec_module(module)
    except SceneError as error:
        raise SceneError(f"{_place(file, error)}: {error}") from error
    except Exception as error:
        raise SceneError(f"{_place(file, error)}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(file.parent))
    return module


def _place(file: Path, error: BaseException) -> str:
    """file:line of the user's own statement that failed."""
    if isinstance(error, SyntaxError):
        return f"{file}:{error.lineno}"
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename) == file]
    return f"{file}:{lines[-1]}" if lines else str(file)


def _scene_of(module: ModuleType, file: Path, variable: str | None) -> Scene:
    scenes = {name: value for name, value in vars(module).items() if isinstance(value, Scene)}
    if variable is not None:
        if variable not in scenes:
            raise SceneError(f"{file} defines no scene {variable!r}; it has {', '.join(scenes) or 'none'}")
        return scenes[variable]
    if "scene" in scenes:
        return scenes["scene"]
    if len({id(s) for s in scenes.values()}) == 1:
        return next(iter(scenes.values()))
    if scenes:
        raise SceneError(f"{file} defines several scenes; name one as {file}:{next(iter(scenes))}")
    raise SceneError(f"{file} defines no scene; assign an sg.Scene to a variable named scene")
