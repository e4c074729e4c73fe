"""SCENE on the command line: a built-in name, or path/to/file.py[:variable]."""

import difflib
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


def scene_summary(spec: str) -> str:
    """The first line of what the scene's file says of itself, or its name."""
    text = (scene_module(spec).__doc__ or "").strip()
    return text.splitlines()[0] if text else f"From {Path(spec).name}."


def load_scene(spec: str) -> Scene:
    """The scene that `spec` names. SceneError for what does not exist, does not run or is no scene."""
    return load(spec)[1]


def scene_module(spec: str) -> ModuleType:
    """The file in which the scene that `spec` names is written, as a module."""
    return load(spec)[0]


def scene_folder(spec: str) -> Path:
    """The folder of the file in which the scene that `spec` names is written."""
    file = load(spec)[0].__file__
    assert file is not None
    return Path(file).parent


def load(spec: str) -> tuple[ModuleType, Scene]:
    """The scene that `spec` names, and its file as a module. SceneError as for `load_scene`."""
    if spec in builtin_names():
        module = importlib.import_module(f"servogen.scenes.{spec}")
        assert isinstance(module.scene, Scene)
        return module, module.scene
    path, _, variable = spec.partition(":") if not Path(spec).exists() else (spec, "", "")
    file = Path(path)
    if file.is_dir():
        raise SceneError(f"{path} is a folder; give path/to/file.py or path/to/file.py:variable")
    if not file.is_file():
        raise SceneError(_not_found(spec, file))
    module = _run(file)
    return module, _scene_of(module, file, variable or None)


def _not_found(spec: str, file: Path) -> str:
    """No such scene: a slip of the pen in a name or in a file's, or a list of what there is."""
    close = difflib.get_close_matches(spec, builtin_names(), 1)
    if close:
        return f"no scene {spec!r}; did you mean {close[0]}? (servogen list shows all; yours is path/to/file.py)"
    if not file.parent.is_dir():
        return f"no file {file}: there is no folder {file.parent}"
    close = difflib.get_close_matches(file.name, [f.name for f in file.parent.glob("*.py")], 1)
    if close:
        return f"no file {file}; did you mean {file.with_name(close[0])}?"
    if file.suffix == ".py" or len(file.parts) > 1:
        return f"no file {file}; give path/to/file.py or path/to/file.py:variable"
    return (
        f"no scene {spec!r}: neither a built-in one ({', '.join(builtin_names())}) nor a file; "
        "give path/to/file.py or path/to/file.py:variable"
    )


def _run(file: Path) -> ModuleType:
    name = f"servogen_scene_{file.stem}"
    loader = importlib.util.spec_from_file_location(name, file)
    if loader is None or loader.loader is None:
        raise SceneError(f"{file} is no .py file; give the Python file that defines the scene")
    module = importlib.util.module_from_spec(loader)
    sys.modules[name] = module  # so that a scene can define dataclasses
    sys.path.insert(0, str(file.parent))  # and import its neighbours
    try:
        loader.loader.exec_module(module)
    except SceneError as error:
        raise SceneError(f"{_place(file, error)}: {error}") from error
    except (SyntaxError, ValueError) as error:
        binary = "null bytes" in str(error) or "decode" in str(error)
        remedy = "; it is no Python source, give the file that defines the scene" if binary else ""
        raise SceneError(f"{_place(file, error)}: {type(error).__name__}: {error}{remedy}") from error
    except (Exception, SystemExit) as error:
        raise SceneError(f"{_place(file, error)}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(file.parent))
    return module


def _place(file: Path, error: BaseException) -> str:
    """file:line of the user's own statement that failed; the file where no line is to blame."""
    if isinstance(error, SyntaxError):
        return f"{file}:{error.lineno}" if error.lineno else str(file)
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename) == file.absolute()]
    return f"{file}:{lines[-1]}" if lines else str(file)


def _scene_of(module: ModuleType, file: Path, variable: str | None) -> Scene:
    scenes = {name: value for name, value in vars(module).items() if isinstance(value, Scene)}
    if variable is not None:
        if variable not in scenes:
            close = difflib.get_close_matches(variable, scenes, 1)
            hint = f"did you mean {close[0]}? It" if close else "it"
            raise SceneError(f"{file} defines no scene {variable!r}; {hint} has {', '.join(scenes) or 'none'}")
        return scenes[variable]
    if "scene" in scenes:
        return scenes["scene"]
    if len({id(s) for s in scenes.values()}) == 1:
        return next(iter(scenes.values()))
    if scenes:
        raise SceneError(
            f"{file} defines several scenes: {', '.join(scenes)}; name one, as in {file}:{next(iter(scenes))}"
        )
    raise SceneError(f"{file} defines no scene; assign an sg.Scene to a variable named scene")
