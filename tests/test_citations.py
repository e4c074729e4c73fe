"""Every citation resolves inside the repository; codegen/docs/sources.md tells which forms a citation may have."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from servogen.plan.thresholds import SWEEP_CAPS
from servogen.verify.stress.bars import BARS

ROOT = Path(__file__).parents[1]
DOCUMENTS = {p.name: p.read_text() for folder in (".", "codegen", "codegen/docs") for p in (ROOT / folder).glob("*.md")}
SOURCES, NUMERICS = DOCUMENTS["sources.md"], DOCUMENTS["numerics.md"]
EQUATIONS = 54

NAME = r"(?:(?:de|van der) )?[A-Z][\w'-]+"
EQUATION = re.compile(r"\b(?:Eqs?\.|[Ee]quations?) (\(?\d+\)?(?:(?:-|, | and |, and )\(?\d+\)?(?![\d.]))*)")
DOCUMENT = re.compile(r"(?<![\w.-])(\w[\w-]*\.md)\b(?:: (.{60}))?")
LITERATURE = re.compile(rf"({NAME}(?:, {NAME})*(?: and {NAME})?)( et al\.)? (?:\((\d{{4}})\)|((?:1[89]|20)\d\d)[),;])")
ROUTINE = re.compile(r"\bLAPACK's (d\w+)")
REPORT = re.compile(r"\b([A-Za-z][\w-]*#\d+)\b")
LOOSE = re.compile(r"\b(?:NUMERICS|SINGULARITY|ERRATA)\b|\b[A-Z]{3,} section \d|\bAPI: [A-Z]")
"""A document by a name in capitals, which is no file, in place of "numerics.md: Tolerances"."""


def unresolved(text: str) -> Iterator[str]:
    """The citations of a text that lead nowhere."""
    # a citation may run over a line's end, whatever the language begins its comments with
    text = re.sub(r"\s*\n[ \t]*(?:/?\*+(?= )|#|//|>)?[ \t]*", " ", text) + " " * 60
    for found in EQUATION.finditer(text):
        yield from (found[0] for n in re.findall(r"\d+", found[1]) if not 1 <= int(n) <= EQUATIONS)
    for found in DOCUMENT.finditer(text):
        headings = re.findall(r"^#+ (.+)$", DOCUMENTS.get(found[1], ""), re.MULTILINE)
        place = (found[2] or "").removeprefix('"')
        if found[1] not in DOCUMENTS or (place and not any(place.startswith(h) for h in headings)):
            yield found[0].strip()
    for found in LITERATURE.finditer(text):
        authors, year = found[1], found[3] or found[4]
        listed = [a for a, y in re.findall(r"\*\*([^*]+) \((\d{4})\)\*\*", SOURCES) if y == year]
        known = {re.split(r", | and ", a)[0] for a in listed} if found[2] else set(listed)
        if not any(
            authors == a or authors.endswith(f", {a}") for a in known
        ):  # a capital word may stand before a comma
            yield found[0]
    yield from (f[0] for f in ROUTINE.finditer(text) if f"`{f[1]}`" not in SOURCES)
    yield from (f[0] for f in REPORT.finditer(text) if not re.search(rf"\b{re.escape(f[1])}\b", SOURCES))
    yield from (f[0] for f in LOOSE.finditer(text))


def files() -> Iterator[Path]:
    """Whatever has comments or is prose: sources, templates, documents, and the C of one scalar of every scene."""
    kinds = {".py", ".j2", ".c", ".h", ".cpp", ".hpp", ".md", ".toml", ".txt"}
    yield from (ROOT / name for name in ("README.md", "dev"))
    for folder in ("codegen", "examples", "firmware_sim", "tests"):
        yield from (p for p in (ROOT / folder).rglob("*") if p.suffix in kinds and p != Path(__file__))
    yield from (p for p in (ROOT / "generated").glob("*/f64/*.[ch]"))


def prose(path: Path) -> str:
    """The text of a file; of C its comments alone."""
    text = path.read_text()
    return "\n".join(re.findall(r"/\*.*?\*/", text, re.DOTALL)) if path.suffix in (".c", ".h") else text


def test_every_citation_resolves() -> None:
    wrong = [f"{p.relative_to(ROOT)}: {citation}" for p in files() for citation in unresolved(prose(p))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "citation",
    [
        "Eq. (55)",
        "Eqs. (13)-(71)",
        "by equations (3), (11) and (0)",
        "theory.md",
        "numerics.md: Tolerance of nothing",
        "see numerics.md:\n   Dampening",
        "Nobody (1967)",
        "Bjoerck (1968)",
        "(Cox and Hyam 1998)",
        "Hodges et al. (2004)",
        "Bajodah and Chen (2004)",
        "LAPACK's dgesvx",
        "casadi#1",
        "the bars of NUMERICS",
        "DESIGN section 4",
    ],
)
def test_a_citation_that_leads_nowhere_is_found(citation: str) -> None:
    assert list(unresolved(f"/* The step ends here, {citation}; then it goes on. */"))


@pytest.mark.parametrize(
    "citation",
    [
        "Eqs. (13)-(17), (26) and (54)",
        "numerics.md: Tolerances, and more",
        "numerics.md",
        "ARCHITECTURE.md",
        "Bajodah, Hodges and Chen\n   (2004)",
        "(Bajodah et al. 2004, Eq. (11))",
        "after de Rijk (1989)",
        "LAPACK's dlasv2",
        "PX4-Matrix#148",
    ],
)
def test_a_good_citation_passes(citation: str) -> None:
    assert not list(unresolved(f"/* The step ends here, {citation}; then it goes on. */"))


def test_the_bars_told_are_those_that_are_held() -> None:
    told = dict(re.findall(r"^- `(.+)`: ([\d.]+)$", NUMERICS, re.MULTILINE))
    assert {quantity: float(bar) for quantity, bar in told.items()} == BARS
    assert f"Caps\nare {SWEEP_CAPS[0][1]}, {SWEEP_CAPS[1][1]}, {SWEEP_CAPS[2][1]} and {SWEEP_CAPS[3][1]}" in NUMERICS
