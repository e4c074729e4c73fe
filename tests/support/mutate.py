"""Faults planted into C, each proven to have changed the code and not a comment alone."""

import re


def mutated(code: str, pattern: str, replacement: str, count: int = 0) -> str:
    """C with each match of a regular expression replaced (the first `count`); AssertionError where no code changes."""
    changed, found = re.subn(pattern, replacement, code, count=count)
    assert found, f"{pattern!r} matches nothing in the code"
    assert _without_comments(changed) != _without_comments(code), f"{pattern!r} matches comments alone"
    return changed


def _without_comments(code: str) -> str:
    return re.sub(r"/\*.*?\*/", "", code, flags=re.DOTALL)
