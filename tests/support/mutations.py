"""URDF texts with something wrong about them: `python -m support.mutations COUNT` loads as many and tells what came."""

import re
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import servogen as sg

_WORDS = (
    "", " ", "nan", "inf", "-1", "0", "0 0 0", "1e400", "1e-320", "1_0", "${m}", "<", "&", '"', "\0", "\xe9", "x:y",
    "<robot>", "</link>", "<mimic joint='j1'/>", "<limit lower='a'/>", "<inertial/>", "<axis/>", "<origin rpy='1'/>",
    "<!--", "]]>", "<?xml?>", "floating", "planar", "prismatic", "world", "a", "base",
)  # fmt: skip


_SPOTS = (r'(?<=")[^"<>]*(?=")', r"<[a-z]+[^<>]*/>", r'[a-z]+="[^"]*"', r"<(link|joint)[^>]*>.*?</\1>", r"[a-z]+")
"""Values, empty elements, attributes, whole links and joints, words."""


def mutate(text: str, generator: np.random.Generator) -> bytes:
    """One or two changes: values replaced, or elements and parts of the text cut out, doubled, or mixed with others."""
    for _ in range(generator.integers(1, 3)):
        word = str(generator.choice(_WORDS))
        spots = list(re.finditer(_SPOTS[int(generator.integers(len(_SPOTS)))], text))
        a, b = spots[int(generator.integers(len(spots)))].span() if spots else (0, len(text))
        if generator.random() < 0.1:
            a, b = sorted(int(x) for x in generator.integers(0, len(text) + 1, 2))
        part = text[a : min(b, a + 400)]
        text = text[:a] + ("", part + part, word, word + part)[int(generator.integers(4))] + text[b:]
    return text.encode("utf-8", "surrogateescape")


def campaign(texts: list[str], count: int, seed: int, folder: Path) -> Counter[str]:
    """What `count` mutated files came to: "loaded", or "refused". Any other error passes on."""
    found: Counter[str] = Counter()
    path = folder / "bot.urdf"
    for k in range(count):
        generator = np.random.default_rng([seed, k])
        path.write_bytes(mutate(texts[k % len(texts)], generator))
        try:
            robot = sg.urdf.load(path, base="floating" if k % 3 == 0 else "fixed", quiet=True)
            assert robot.mechanism.Q.size1() == robot.u.size1()
            found["loaded"] += 1
        except sg.SceneError as error:
            found["refused" if "\n" not in str(error) else "refused in several lines"] += 1
    return found


if __name__ == "__main__":
    from support.robots import A1, ODD

    with tempfile.TemporaryDirectory() as name:
        print(campaign([ODD, A1.read_text()], int(sys.argv[1]), 0, Path(name)))
