"""The evidence for assessors, ours beside CasADi's under the same commands: python -m servogen.bench.assess."""

import argparse
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from servogen.bench.contenders import casadi_c
from servogen.bench.inputs import drawn
from servogen.compiler import build
from servogen.loading import builtin_names, load_scene
from servogen.verify.evidence import Finding, coverage, listed, misra, tidy, unlisted


def main() -> int:
    """Print it all; 1 where something is not listed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(builtin_names()))
    given = parser.parse_args()
    good = True
    with tempfile.TemporaryDirectory(prefix="servogen-evidence-") as name:
        for scene in given.scenes:
            for scalar in ("float64", "float32"):
                package = build(load_scene(scene), Path(name) / f"{scene}-{scalar}", scalar)
                file = package.path / f"{package.prefix}.c"
                findings, tidied = misra([file]), tidy([file])
                good &= not unlisted([*findings, *tidied])
                print(f"{package.prefix}: MISRA {_numbers(findings)}; clang-tidy {len(tidied)}", flush=True)
                for f in unlisted([*findings, *tidied]):
                    print(f"    NOT LISTED: {f.rule} at {f.file}:{f.line}")
            folder = Path(name) / f"casadi-{scene}"
            folder.mkdir()
            try:
                theirs = casadi_source(scene, folder)
            except Exception as problem:  # a scene CasADi's rival has no form for
                print(f"    CasADi: none ({problem})")
                continue
            print(f"    CasADi's: MISRA {_numbers(misra([theirs]))}; clang-tidy {len(tidy([theirs]))}", flush=True)
    total, taken, missed = coverage()
    print(f"branches of the solver: {taken} of {total} taken")
    for b in missed:
        print(f"    {b.function}: {b.text}: {b.reason or 'NO REASON LISTED'}")
    return 0 if good and all(b.reason for b in missed) else 1


def casadi_source(scene_name: str, folder: Path) -> Path:
    """CasADi's own C for a scene's matrix, right side and answer."""
    scene = load_scene(scene_name)
    contender = casadi_c(scene, drawn(scene, 4, 0), 4, "CasADi cse", cse=True)
    for file in contender.files:
        (folder / file.name).write_text(file.text)
    return next(folder / f.name for f in contender.files if f.name.endswith(".c"))


def _numbers(findings: Sequence[Finding]) -> str:
    """Findings by category: how many, of how many rules, and those that are not advisory by rule."""
    rules = listed()["misra"]
    category = {f.rule: rules.get(f.rule, {}).get("category", "unlisted") for f in findings}
    advisory = sum(category[f.rule] == "advisory" for f in findings)
    others = Counter(f.rule for f in findings if category[f.rule] != "advisory")
    text = ", ".join(f"{rule} ({n})" for rule, n in sorted(others.items()))
    return f"{advisory} advisory, {sum(others.values())} required: {text or 'none'}"


if __name__ == "__main__":
    raise SystemExit(main())
