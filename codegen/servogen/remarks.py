"""Remarks: what is odd about a scene and yet no error. The stages return them; here they are said."""

import sys
import warnings
from collections.abc import Iterable
from pathlib import Path

_PACKAGE = str(Path(__file__).resolve().parent)


class Remark(UserWarning):
    """The category of every remark on a scene: `warnings.filterwarnings("ignore", category=sg.Remark)`."""


def say(remarks: Iterable[str]) -> None:
    """Each as a warning at the line outside servogen that called it, however deep inside servogen this is."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    for text in remarks:
        warnings.warn(text, Remark, stacklevel=level)
