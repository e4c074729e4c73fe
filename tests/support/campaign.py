"""What only the long campaign runs: SERVOGEN_CAMPAIGN=1."""

import os
from collections.abc import Sequence

CAMPAIGN = os.environ.get("SERVOGEN_CAMPAIGN") == "1"


def crossed(first: Sequence[str], second: Sequence[str]) -> list[tuple[str, str]]:
    """Every pair in the campaign; every day the last of `first` with all, and all of `first` with second's first."""
    return [(a, b) for a in first for b in second if CAMPAIGN or a == first[-1] or b == second[0]]
