"""What a test does where something it needs is not on this machine."""

import os
from typing import NoReturn

import pytest


def skip_or_fail(missing: object) -> NoReturn:
    """Skips and says why; fails instead where SERVOGEN_REQUIRE_ALL=1 (on machines that must check everything)."""
    if os.environ.get("SERVOGEN_REQUIRE_ALL") == "1":
        pytest.fail(f"SERVOGEN_REQUIRE_ALL=1, but {missing}")
    pytest.skip(str(missing))
