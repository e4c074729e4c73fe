"""MathML, which browsers set themselves: symbols as the user named them, and the textbook's formulas."""

import re
from collections.abc import Sequence
from html import escape

GREEK = dict(
    zip(
        """alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi
        omega Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega""".split(),
        "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ",
        strict=True,
    )
)
_FORMULA = re.compile(
    r"\^(-1|-T|T|\+|\([a-z0-9-]+\))|([A-Za-z]+(?:_[A-Za-z0-9_]+)?)([0-9]*)('*)|([0-9.]+)|([-+=,()|\[\]])|(\s+)|(.)"
)
_MATRICES = frozenset("A B C D F G J K L N P Q R S T W X I".split())


def tag(name: str, *parts: str, **attributes: str) -> str:
    """One element; its parts are MathML already."""
    given = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f"<{name}{given}>{''.join(parts)}</{name}>"


def mi(text: str, upright: bool = False) -> str:
    """An identifier: one letter slants, a word stands."""
    return tag("mi", escape(text), **({"mathvariant": "normal"} if upright and len(text) == 1 else {}))


def mo(text: str) -> str:
    return tag("mo", escape(text))


def mn(text: str) -> str:
    return tag("mn", escape(text))


def row(*parts: str) -> str:
    return parts[0] if len(parts) == 1 else tag("mrow", *parts)


def bracketed(inner: str) -> str:
    return tag("mrow", mo("("), inner, mo(")"))


def matrix(rows: Sequence[Sequence[str]]) -> str:
    """A matrix in brackets; a scalar as it is."""
    if len(rows) == 1 and len(rows[0]) == 1:
        return rows[0][0]
    lines = (tag("mtr", *(tag("mtd", entry) for entry in entries)) for entries in rows)
    return tag("mtable", *lines, displaystyle="true", **{"class": "matrix"})  # its brackets are the style sheet's


def symbol(name: str) -> str:
    """theta_0 as a Greek letter with its index, r_dot_0 primed, m_B with a subscript, other words upright."""
    words = [w for w in re.sub(r"(?<=[A-Za-z])([0-9]+)$", r"_\1", name).split("_") if w] or ["_"]
    base, below, primes = words[0], [], ""
    for word in words[1:]:
        if word in ("dot", "ddot"):
            primes = "′" if word == "dot" else "″"
        else:
            below.append(GREEK.get(word, word))
    text = mi(GREEK.get(base, base))
    if primes:  # as the rest of the page writes rates; a dot above is lost in small print
        text = tag("mrow", text, tag("mo", primes, lspace="0", rspace="0"))
    if not below:
        return text
    index = [mn(word) if word.isdigit() else mi(word) for word in below]
    return tag("msub", text, row(*(part for k, one in enumerate(index) for part in ((mo(","),) if k else ()) + (one,))))


def formula(text: str) -> str:
    """A formula of the textbook in ASCII, "psi_u Q^-1 G": powers raised, indices lowered, Greek letters; words stay."""
    parts: list[str] = []
    for power, name, digits, primes, number, sign, space, other in _FORMULA.findall(text):
        if power:
            parts[-1] = tag("msup", parts[-1], tag("mrow", mo("−") + mn("1")) if power == "-1" else _power(power))
        elif name:
            parts.append(_name(name, digits, len(primes)))
        elif number:
            parts.append(mn(number))
        elif sign:
            parts.append(mo("−" if sign == "-" else sign))
        elif space:
            parts.append(tag("mspace", width="0.22em"))
        else:
            parts.append(tag("mtext", escape(other)))
    return tag("mrow", *parts)


def _power(power: str) -> str:
    if power[0] == "(":  # of a derivative
        return tag(
            "mrow", *(mn(x) if x.isdigit() else mi(x) if x.isalpha() else mo(x.replace("-", "−")) for x in power)
        )
    return tag("mrow", mo("−"), mi("T", upright=True)) if power == "-T" else mi(power) if power == "T" else mo(power)


def _name(name: str, digits: str, primes: int) -> str:
    base = name.split("_")[0]
    if base not in GREEK and base not in _MATRICES and len(base) > 1:
        return tag("mtext", escape(name + digits + "'" * primes))
    text = symbol("_".join([name, digits]) if digits else name)
    return row(text, tag("mo", "′" * primes, lspace="0", rspace="0.1em")) if primes else text


def math(*parts: str, display: bool = True) -> str:
    """The whole formula, in a line of its own or in the text."""
    return tag("math", *parts, **({"display": "block"} if display else {}))
