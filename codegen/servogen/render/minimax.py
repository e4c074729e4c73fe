"""Minimax polynomials by Remez' exchange, at 60 digits: python -m servogen.render.minimax derives the coefficients of
`mathematics.py` and prints them with their errors. A test repeats it."""

from collections.abc import Callable, Sequence
from typing import Any

import mpmath as mp

from servogen.ir.numbers import as_fraction, nearest
from servogen.render.mathematics import SCALARS, TERMS

Function = Callable[[Any], Any]
DIGITS = 60
GRID = 600


def sine_target(z: Any) -> Any:
    """(sin(r) / r - 1) / z with z = r^2: what the sine's polynomial approximates."""
    if z < mp.mpf("1e-8"):
        return -mp.mpf(1) / 6 + z / 120 - z**2 / 5040 + z**3 / 362880
    r = mp.sqrt(z)
    return (mp.sin(r) / r - 1) / z


def sine_weight(z: Any) -> Any:
    """What an error of that polynomial does to sin(r), relatively."""
    r = mp.sqrt(z)
    return z if z == 0 else z * r / mp.sin(r)


def cosine_target(z: Any) -> Any:
    """(cos(r) - 1 + z / 2) / z^2 with z = r^2."""
    if z < mp.mpf("1e-8"):
        return mp.mpf(1) / 24 - z / 720 + z**2 / 40320 - z**3 / 3628800
    return (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2


def cosine_weight(z: Any) -> Any:
    """What an error of that polynomial does to cos(r), relatively."""
    return z**2 / mp.cos(mp.sqrt(z))


TARGETS: dict[str, tuple[Function, Function]] = {
    "sine": (sine_target, sine_weight),
    "cosine": (cosine_target, cosine_weight),
}


def high() -> Any:
    """The largest r^2: pi/4 and a margin for the rounding of the quotient."""
    return (mp.pi / 4 * (1 + mp.mpf(2) ** -18)) ** 2


def minimax(target: Function, weight: Function, terms: int, top: Any, rounds: int = 12) -> list[Any]:
    """The polynomial of `terms` coefficients, lowest first, of least largest |weight (p - target)| on (0, top]."""
    points = [top / 2 * (1 - mp.cos(mp.pi * (2 * k + 1) / (2 * terms + 2))) for k in range(terms + 1)]
    grid = [top / 2 * (1 - mp.cos(mp.pi * (k + 1) / GRID)) for k in range(GRID)]
    exact = [(z, target(z), weight(z)) for z in grid]
    coefficients: list[Any] = []
    for _ in range(rounds):
        rows = [[z**i for i in range(terms)] + [(-1) ** k / weight(z)] for k, z in enumerate(points)]
        solution = mp.lu_solve(mp.matrix(rows), mp.matrix([target(z) for z in points]))
        coefficients = list(solution)[:terms]
        errors = [(w * (horner(coefficients, z) - t), z) for z, t, w in exact]
        found = _extrema(errors)
        if len(found) < terms + 1:
            break
        points = found[-(terms + 1) :]
    return coefficients


def _extrema(errors: Sequence[tuple[Any, Any]]) -> list[Any]:
    """The place of the largest error in each stretch of one sign."""
    best: list[tuple[Any, Any]] = []
    for error, z in errors:
        if best and (best[-1][0] > 0) == (error > 0):
            if abs(error) > abs(best[-1][0]):
                best[-1] = (error, z)
        else:
            best.append((error, z))
    return [z for _, z in best]


def horner(coefficients: Sequence[Any], z: Any) -> Any:
    """The polynomial's value; coefficients lowest first."""
    value = mp.mpf(0)
    for c in reversed(coefficients):
        value = value * z + c
    return value


def largest_error(coefficients: Sequence[Any], name: str, points: int = 2000) -> Any:
    """The largest relative error that the polynomial alone leaves in sin(r) or cos(r)."""
    target, weight = TARGETS[name]
    with mp.workdps(DIGITS):
        top = high()
        places = [top * (k + 1) / points for k in range(points)]
        return max(abs(weight(z) * (horner([mp.mpf(c) for c in coefficients], z) - target(z))) for z in places)


def derive(name: str, scalar: str) -> tuple[float, ...]:
    """The coefficients: each is rounded to the scalar in turn, and those above it are fitted anew."""
    found: list[float] = []
    with mp.workdps(DIGITS):
        target, weight = TARGETS[name]
        for done in range(TERMS[scalar]):
            exact = minimax(target, weight, TERMS[scalar] - done, high())
            found.append(nearest(as_fraction(exact[0]), scalar))
            target, weight = _next(target, weight, mp.mpf(found[-1]))
    return tuple(found)


def _next(target: Function, weight: Function, first: Any) -> tuple[Function, Function]:
    """What is left to approximate once the lowest coefficient is fixed."""
    return lambda z: (target(z) - first) / z, lambda z: weight(z) * z


def main() -> None:
    """Print the coefficients and their errors."""
    for scalar in SCALARS:
        for name in TARGETS:
            found = derive(name, scalar)
            error = largest_error(found, name)
            print(f"{scalar} {name}: {found}  # 2^{float(mp.log(error, 2)):.1f}")


if __name__ == "__main__":
    main()
