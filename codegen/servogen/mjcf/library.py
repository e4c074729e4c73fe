"""MuJoCo itself, an optional dependency."""

from types import ModuleType

from servogen.tools import ToolMissing


def mujoco_module() -> ModuleType:
    """The Python package. ToolMissing, with the command that installs it, where it is not there."""
    try:
        import mujoco
    except ImportError:
        raise ToolMissing("MuJoCo is not installed; pip install 'servogen[mujoco]'") from None
    assert isinstance(mujoco, ModuleType)
    # MuJoCo writes its warnings into a log in the user's folder; those that matter are read from its counters instead
    mujoco.set_mju_user_warning(lambda _: None)
    return mujoco
