"""The page of certificates: what the generated C costs on boards, and how that was found."""

from collections.abc import Sequence

from servogen.report.templates import pages
from servogen.verify.board_certificate import BoardCertificate
from servogen.version import VERSION


def render_board_page(certificates: Sequence[BoardCertificate], problems: Sequence[str]) -> str:
    """The HTML of certificates: scene x board x scalar at a glance, then each function of each."""
    return (
        pages()
        .get_template("boards.html.j2")
        .render(
            certificates=certificates,
            boards=list(dict.fromkeys(c.target for c in certificates)),
            rows=list(dict.fromkeys((c.scene, c.scalar) for c in certificates)),
            cells={(c.scene, c.scalar, c.target): c for c in certificates},
            answer=lambda c: next(e for e in c.entries if e.name == "control"),
            problems=problems,
            version=VERSION,
        )
    )
