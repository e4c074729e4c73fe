"""A mechanism and its motion as an SVG element: still as it is, moving where the page's script runs."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from servogen.results import FloatArray
from servogen.simulate.drawing import Motion

WIDTH, LEAST, MOST = 400.0, 220.0, 400.0  # of the picture, and its least and its largest height
_MARGIN = 26.0
_GHOSTS = 5
_AZIMUTH, _ELEVATION = np.radians(-60.0), np.radians(25.0)  # from where space is looked at
_SPACE = np.array(
    [
        [-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0],
        [-np.sin(_ELEVATION) * np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH), np.cos(_ELEVATION)],
    ]
)
"""The picture's right and up, of a point in space: an orthographic view, z upwards."""


@dataclass(frozen=True)
class Drawing:
    """svg: the element, with poses from the start to the end; motion: JSON of all poses for the script; grid: the
    distance of the grid's lines in words; seconds: what the motion takes."""

    svg: str
    motion: str
    grid: str
    seconds: float


def draw_motion(motion: Motion, label: str, unit: str = "") -> Drawing:
    """label: what it shows, for who cannot see it; unit: of the points."""
    space = motion.lines[0].shape[2] == 3
    reach = np.vstack([line.reshape(-1, line.shape[2]) for line in motion.lines])
    step = _nice(np.ptp(reach, axis=0).max() / 5 or 0.2)
    ground = _ground(reach, step) if space else np.zeros((0, 3))
    flat = [line @ _SPACE.T if space else line for line in motion.lines]
    seen = np.vstack([*(line.reshape(-1, 2) for line in flat), ground @ _SPACE.T if space else np.zeros((0, 2))])
    frame = _Frame.around(seen)
    behind = _floor(frame, ground, step) if space else _plane(frame, step)
    shadows = [(line * [1.0, 1.0, 0.0]) @ _SPACE.T for line in motion.lines if line.shape[1] > 1] if space else []
    every = [*((frame.place(line), "shadow") for line in shadows),
             *((frame.place(line), "mark" if line.shape[1] == 1 else "link") for line in flat)]  # fmt: skip
    still = "".join(_pose([p], [f"{kind} still"], 0, ghost=False) for p, kind in every if not _moves(p))
    moving = [(p, kind) for p, kind in every if _moves(p)]
    pictured, kinds = [p for p, _ in moving], [kind for _, kind in moving]
    ghosts = "".join(_pose(pictured, kinds, k, ghost=True) for k in _chosen(flat, frame))
    paths = "".join(_path(p) for p, kind in zip(pictured, kinds, strict=True) if kind != "shadow")
    pose = _pose(pictured, kinds, -1, ghost=False)
    svg = (
        f'<svg class="drawing" viewBox="0 0 {WIDTH:g} {frame.height:.0f}" role="img" aria-label="{escape(label)}">'
        f'{behind}{still}{paths}<g class="ghosts">{ghosts}</g><g class="pose">{pose}</g></svg>'
    )
    poses = np.hstack([np.zeros((len(motion.t), 0)), *(_twice(p).reshape(len(motion.t), -1) for p in pictured)])
    rows = ",".join("[" + ",".join(f"{x:.1f}" for x in row) + "]" for row in poses)
    times, sizes = json.dumps(motion.t.round(4).tolist()), json.dumps([_twice(p).shape[1] for p in pictured])
    text = f'{{"t":{times},"sizes":{sizes},"poses":[{rows}]}}'
    return Drawing(svg, text, f"{step:g} {unit}".rstrip(), float(motion.t[-1] - motion.t[0]))


@dataclass(frozen=True)
class _Frame:
    """From points to the picture: x = left + scale (p - low), y downwards."""

    low: FloatArray
    scale: float
    left: float
    height: float

    @classmethod
    def around(cls, points: FloatArray) -> "_Frame":
        low, high = points.min(axis=0), points.max(axis=0)
        size = np.maximum(high - low, 1e-9 + 1e-3 * float(np.max(high - low)))
        inner = np.array([WIDTH, MOST]) - 2 * _MARGIN
        scale = float(np.min(inner / size))
        height = min(MOST, max(LEAST, scale * size[1] + 2 * _MARGIN))
        middle = (low + high) / 2
        low = middle - (np.array([WIDTH, height]) / 2 - _MARGIN) / scale
        return cls(low, scale, _MARGIN, height)

    def place(self, points: FloatArray) -> FloatArray:
        moved = (points - self.low) * self.scale + self.left
        moved[..., 1] = self.height - moved[..., 1]
        placed: FloatArray = moved
        return placed

    @property
    def high(self) -> FloatArray:
        end: FloatArray = self.low + (np.array([WIDTH, self.height]) - 2 * self.left) / self.scale
        return end


def _chosen(lines: Sequence[FloatArray], frame: _Frame) -> list[int]:
    """Poses before the last, equally far from one another along the way."""
    moved = sum(np.linalg.norm(np.diff(line, axis=0), axis=2).sum(axis=1) for line in lines)
    way = np.concatenate([[0.0], np.cumsum(moved)])
    if way[-1] * frame.scale < 4:  # pixels: it does not move
        return []
    return sorted({int(np.searchsorted(way, way[-1] * k / _GHOSTS)) for k in range(_GHOSTS)})


def _pose(lines: Sequence[FloatArray], kinds: Sequence[str], at: int, ghost: bool) -> str:
    shown = [(line, kind) for line, kind in zip(lines, kinds, strict=True) if not (ghost and kind != "link")]
    return "".join(f'<polyline class="{kind}" points="{_points(_twice(line)[at])}"/>' for line, kind in shown)


def _path(line: FloatArray) -> str:
    """Where the last point of a polyline went."""
    return f'<polyline class="path" points="{_points(line[:, -1])}"/>'


def _moves(line: FloatArray) -> bool:
    """By more than half a pixel."""
    return bool(np.ptp(line, axis=0).max() > 0.5)


def _twice(line: FloatArray) -> FloatArray:
    """A single point as a line of no length, which round ends make a dot."""
    return np.repeat(line, 2, axis=1) if line.shape[1] == 1 else line


def _points(points: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _plane(frame: _Frame, step: float) -> str:
    """A grid behind a drawing in the plane, with its numbers."""
    parts = []
    for axis in (0, 1):
        first = np.ceil((frame.low[axis] - frame.left / frame.scale) / step)
        last = np.floor((frame.high[axis] + frame.left / frame.scale) / step)
        for k in np.arange(first, last + 1):
            at = float(frame.place(np.full(2, k * step))[axis])
            ends = (f'x1="{at:.1f}" x2="{at:.1f}" y1="0" y2="{frame.height:.0f}"',
                    f'y1="{at:.1f}" y2="{at:.1f}" x1="0" x2="{WIDTH:.0f}"')[axis]  # fmt: skip
            parts.append(f'<line class="{"axis" if k == 0 else "grid"}" {ends}/>')
            number = f"{k * step + 0.0:.6g}".replace("-", "−")
            place = (f'x="{at:.1f}" y="{frame.height - 4:.0f}" text-anchor="middle"',
                     f'x="3" y="{at + 3.5:.1f}"')[axis]  # fmt: skip
            if not (axis == 1 and at > frame.height - 16) and not (axis == 0 and at < 26):
                parts.append(f"<text {place}>{number}</text>")
    return "".join(parts)


def _ground(reach: FloatArray, step: float) -> FloatArray:
    """The corners of the floor z = 0 under it, whole steps from the origin."""
    low = np.floor(np.minimum(reach.min(axis=0), 0.0) / step)
    high = np.ceil(np.maximum(reach.max(axis=0), 0.0) / step)
    return step * np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])


def _floor(frame: _Frame, ground: FloatArray, step: float) -> str:
    """A grid on the floor, and the three axes at the origin."""
    low, high = ground[0], ground[-1]
    parts = []
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + step / 2, step):
            ends = np.zeros((2, 3))
            ends[:, axis], ends[:, 1 - axis] = at, (low[1 - axis], high[1 - axis])
            parts.append(f'<polyline class="grid" points="{_points(frame.place(ends @ _SPACE.T))}"/>')
    for axis, name in enumerate("xyz"):
        ends = np.zeros((2, 3))
        ends[1, axis] = step
        (x0, y0), (x, y) = frame.place(ends @ _SPACE.T)
        parts.append(f'<line class="axis" x1="{x0:.1f}" y1="{y0:.1f}" x2="{x:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{x + 3:.1f}" y="{y - 3:.1f}">{name}</text>')
    return "".join(parts)


def _nice(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value * (1 - 1e-9)))
