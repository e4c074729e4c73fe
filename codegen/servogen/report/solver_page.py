"""The page of the work-precision diagrams."""

import base64
from collections.abc import Mapping
from pathlib import Path

from servogen.bench.solver.work_precision import WorkPrecision
from servogen.report.templates import pages


def render_solver_page(found: WorkPrecision, figures: Mapping[tuple[str, str], Path]) -> str:
    """The HTML, one file without network. figures: (shape, scalar) -> SVG."""
    encoded = {key: base64.b64encode(path.read_bytes()).decode() for key, path in figures.items()}
    uris = {key: f"data:image/svg+xml;base64,{text}" for key, text in encoded.items()}
    conditions = {key: sorted({p.kappa for p in found.points if (p.shape, p.scalar) == key}) for key in figures}
    template = pages().get_template("solver.html.j2")
    return template.render(found=found, figures=uris, conditions=conditions)
