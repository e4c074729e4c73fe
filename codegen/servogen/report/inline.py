"""A matplotlib figure as an SVG element inside the page: light, of any width, its words real text."""

import io
import re
from html import escape
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from servogen.results import FloatArray

POINTS = 1200
"""Points beyond which a curve is drawn by the least and the largest of each stretch: nobody sees more at this size."""

_OWN_FONT = re.compile(r"(font: [^;\"]*?)'[^;\"]*")
_FAMILY = re.compile(r"font-family: [^;\"]*;? ?")
_NO_TURN = re.compile(r' transform="rotate\(-0[^"]*"')
_LONG_NUMBER = re.compile(r"(\d+\.\d\d)\d+")
_LOCAL_NAME = re.compile(r'(\bid="|url\(#|href="#)([^")]+)')


def inline_svg(figure: Figure, label: str, prefix: str) -> str:
    """The element; label: what it shows, for who cannot see it; prefix: of its ids, unique on the page."""
    for axis in figure.axes:
        for word in axis.texts:
            word.set_path_effects([])  # or each letter becomes a path; the style sheet gives words their halo
        for line in axis.get_lines():
            line.set_data(*thinned(np.asarray(line.get_xdata()), np.asarray(line.get_ydata())))
    written = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "servogen"}):
        figure.savefig(written, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = written.getvalue()
    body = text[text.index("</defs>") + len("</defs>") : text.rindex("</svg>")]  # the first ones are a style
    box = re.search(r'viewBox="([^"]+)"', text)
    assert box is not None
    used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', body))
    body = _LOCAL_NAME.sub(lambda m: f"{m[1]}{prefix}-{m[2]}" if m[2] in used else m[1] + m[2], body)
    body = re.sub(r' id="(?!' + re.escape(prefix) + r'-)[^"]*"', "", body)
    body = _LONG_NUMBER.sub(r"\1", _FAMILY.sub("", _NO_TURN.sub("", _OWN_FONT.sub(r"\1var(--plot)", body))))
    body = re.sub(r"\s*\n\s*", "\n", re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL))
    return f'<svg class="plot" viewBox="{box[1]}" role="img" aria-label="{escape(label)}">{body}</svg>'


def thinned(x: FloatArray, y: FloatArray) -> tuple[Any, Any]:
    """A curve of at most about POINTS points; where it has more, the extremes of each stretch, in their order."""
    if len(x) <= POINTS or y.ndim != 1:
        return x, y
    edges = np.linspace(0, len(x), POINTS // 2 + 1).astype(int)
    kept = {0, len(x) - 1}
    for first, last in pairwise(edges):
        stretch = np.where(np.isfinite(y[first:last]), y[first:last], 0.0)
        kept |= {first + int(np.argmin(stretch)), first + int(np.argmax(stretch))}
    rows = sorted(kept)
    return x[rows], y[rows]
