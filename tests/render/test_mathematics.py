"""Own sine, cosine and square root: the constants derived again, the claimed error at the worst arguments known, the
same bits from every compiler and level. SERVOGEN_CAMPAIGN=1 walks every float32."""

import os
import re
import subprocess
from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.render import mathematics, minimax
from support.c import STRICT, compiler
from support.mathematics import Compiled, write
from support.mutate import mutated

SCALARS = mathematics.SCALARS
UINT = {"float64": np.uint64, "float32": np.uint32}
CAMPAIGN = os.environ.get("SERVOGEN_CAMPAIGN") == "1"
LEVELS = ("-O0", "-O1", "-O2", "-O3")
PER_RANGE = 100_000 if CAMPAIGN else 1000


@pytest.fixture(scope="module", params=SCALARS)
def own(request, tmp_path_factory):
    compiler("gcc")
    return Compiled(tmp_path_factory.mktemp("own"), request.param)


def bits(x):
    return x.view(UINT[x.dtype.name])


def ulps(got, exact, scalar):
    """Errors in units in the last place of the exact value; NaN counts as infinite."""
    digits, lowest = (53, -1074) if scalar == "float64" else (24, -149)
    errors = []
    for value, truth in zip(got.tolist(), exact, strict=True):
        unit = mp.mpf(2) ** max(mp.frexp(truth)[1] - digits, lowest)
        errors.append(float(abs(mp.mpf(value) - truth) / unit) if value == value else np.inf)
    return np.array(errors)


def random_arguments(scalar, rng, count=PER_RANGE):
    """Both signs, logarithmically over all finite numbers, and evenly over angles that occur."""
    kind = np.dtype(scalar)
    whole = np.frombuffer(rng.bytes(count * kind.itemsize), kind)
    angles = [rng.uniform(-reach, reach, count).astype(kind) for reach in (0.8, 3.2, 100.0, mathematics.NEAR[scalar])]
    return np.concatenate([whole[np.isfinite(whole)], *angles])


def close_to_multiples(scalar, rng):
    """Numbers closest to a multiple of pi/2 in every binade, by continued fractions, and their neighbours; and the
    nearest numbers to random multiples up to the end of the short reduction."""
    kind = np.dtype(scalar)
    digits, first, last = (53, -52, 971) if scalar == "float64" else (24, -23, 104)
    found = []
    with mp.workprec(2400):
        for exponent in range(first, last + 1, 1 if CAMPAIGN or scalar == "float32" else 7):
            ratio = mp.ldexp(2 / mp.pi, exponent)
            for denominator in _denominators(ratio - mp.floor(ratio), 2**digits):
                scaled = denominator << max(0, digits - denominator.bit_length())
                found += [mp.ldexp(m, exponent) for m in (denominator, scaled)]
        limit = int(mathematics.NEAR[scalar] * 2 / mp.pi)
        found += [int(k) * mp.pi / 2 for k in rng.integers(1, limit, PER_RANGE // 2)]
        x = np.array([float(v) for v in found if v < float(np.finfo(kind).max)]).astype(kind)
    around = [np.nextafter(x, kind.type(np.inf)), x, np.nextafter(x, kind.type(0))]
    x = np.concatenate(around)
    return np.concatenate([x, -x])[np.tile(np.isfinite(x), 2)]


def _denominators(ratio, limit):
    """The two largest denominators below `limit` of the continued fraction of a number in [0, 1)."""
    before, now, rest = 0, 1, ratio
    while rest and (following := before + int(mp.floor(1 / rest)) * now) < limit:
        before, now, rest = now, following, 1 / rest - mp.floor(1 / rest)
    return [q for q in (before, now) if q]


def exactly(function, x):
    """The function at the very numbers, to 40 digits."""
    with mp.workdps(40):
        return [function(mp.mpf(float(v))) for v in x]


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("name", ["sine", "cosine"])
def test_coefficients_are_derived_again(name, scalar):
    stored = {"sine": mathematics.SINE, "cosine": mathematics.COSINE}[name][scalar]
    assert minimax.derive(name, scalar) == stored
    claim = mathematics.POLYNOMIAL_ERROR[scalar][name == "cosine"]
    assert claim / 1.2 < minimax.largest_error(stored, name) <= claim


@pytest.mark.parametrize(("scalar", "count", "beyond"), [("float64", 2, 85), ("float64", 4, 150), ("float32", 3, 55)])
def test_parts_of_pi_are_short_and_sum_to_it(scalar, count, beyond):
    parts = mathematics.pi_parts(scalar, count)
    digits = 53 if scalar == "float64" else 24
    largest = int(mathematics.NEAR[scalar] * 2 / np.pi) + 1
    for part in parts[:-1]:
        assert part.numerator.bit_length() + largest.bit_length() <= digits, "k times the part must be exact"
    with mp.workprec(400):
        rest = mp.pi / 2 - sum(mp.mpf(p.numerator) / p.denominator for p in parts)
        assert abs(rest) < mp.mpf(2) ** -beyond


@pytest.mark.parametrize("scalar", SCALARS)
def test_words_of_two_over_pi(scalar):
    words = mathematics.two_over_pi_words(scalar)
    value = sum(Fraction(w, 2 ** (32 * (k + 1))) for k, w in enumerate(words))
    lead = 32 * (2 if scalar == "float64" else 1)
    with mp.workprec(2000):
        exact = mp.ldexp(2 / mp.pi, -lead)
        error = exact - mp.mpf(value.numerator) / value.denominator
        assert 0 <= error < mp.mpf(2) ** (-32 * len(words))


def test_within_one_ulp(own):
    scalar = own.dtype.name
    rng = np.random.default_rng(7)
    x = np.concatenate([random_arguments(scalar, rng), close_to_multiples(scalar, rng)])
    for function, name in ((own.sin, "sin"), (own.cos, "cos")):
        error = ulps(function(x), exactly(getattr(mp, name), x), scalar)
        worst = int(np.argmax(error))
        assert error[worst] <= mathematics.LARGEST_ERROR, f"{name}({float(x[worst]).hex()}): {error[worst]} ulps"
        assert error[worst] > 0.5, "so small an error was not measured"


def test_every_float32_within_one_ulp(tmp_path):
    """Against float64's sine, whose own error is 2^-29 ulps here: 2.1e9 numbers in the campaign, else every 997th."""
    own, stride = Compiled(tmp_path, "float32"), 1 if CAMPAIGN else 997
    first, last, chunk = 0, 0x7F800000, stride * 2**20
    for start in range(first, last, chunk):
        x = np.arange(start, min(start + chunk, last), stride, dtype=np.uint64).astype(np.uint32).view(np.float32)
        for got, exact in zip(own.sincos(x), (np.sin(x.astype(float)), np.cos(x.astype(float))), strict=True):
            unit = np.ldexp(1.0, np.maximum(np.frexp(exact)[1] - 24, -149))
            error = np.abs(got.astype(float) - exact) / unit
            assert np.max(error) <= mathematics.LARGEST_ERROR, float(x[np.argmax(error)]).hex()


def test_pair_and_symmetry(own):
    """sincos has the bits of sin and cos; sin is odd and cos even, bit for bit."""
    rng = np.random.default_rng(8)
    x = np.concatenate([random_arguments(own.dtype.name, rng), close_to_multiples(own.dtype.name, rng)])
    s, c = own.sincos(x)
    assert np.array_equal(bits(s), bits(own.sin(x)))
    assert np.array_equal(bits(c), bits(own.cos(x)))
    assert np.array_equal(bits(own.sin(-x)), bits(-s))
    assert np.array_equal(bits(own.cos(-x)), bits(c))


def test_special_arguments(own):
    kind = own.dtype.type
    for x in (np.nan, np.inf, -np.inf):
        values = [own.sin([x]), own.cos([x]), *own.sincos([x])]
        assert all(np.isnan(v[0]) for v in values)
    smallest = float(np.finfo(kind).smallest_subnormal)
    x = np.array([0.0, -0.0, smallest, -smallest, 3 * smallest, float(np.finfo(kind).tiny)], kind)
    assert np.array_equal(bits(own.sin(x)), bits(x))
    assert np.array_equal(own.cos(x), np.ones_like(x))


def test_no_step_where_the_reduction_changes(own):
    """Neighbours across pi/4, the odd multiples of it, and the end of the short reduction differ by their distance."""
    kind = own.dtype
    near = mathematics.NEAR[kind.name]
    odd = np.array([k * np.pi / 4 for k in range(1, 200, 2)] + [near, near * 1.0001, near * 0.9999]).astype(kind)
    for _ in range(3):
        following = np.nextafter(odd, kind.type(np.inf))
        for function in (own.sin, own.cos):
            step = np.abs(function(following).astype(float) - function(odd).astype(float))
            assert np.all(step <= (following - odd).astype(float) + 2 * np.finfo(kind).eps)
        odd = following


def test_same_bits_from_every_compiler_and_level(tmp_path):
    for scalar in SCALARS:
        rng = np.random.default_rng(9)
        x = np.concatenate([random_arguments(scalar, rng), close_to_multiples(scalar, rng)])
        found = {}
        for name in ("gcc", "clang"):
            compiler(name)
            for level in LEVELS:
                own = Compiled(tmp_path, scalar, name, (level,))
                values = [*own.sincos(x), own.sin(x), own.cos(x), own.sqrt(np.abs(x))]
                found[name, level] = b"".join(v.tobytes() for v in values)
        assert len(set(found.values())) == 1, f"{scalar}: {[k for k in found if found[k] != found['gcc', '-O0']]}"


def test_integer_square_root_is_correctly_rounded(tmp_path):
    for scalar in SCALARS:
        own = Compiled(tmp_path, scalar, flags=("-O2", "-DSERVOGEN_INTEGER_SQRT"))
        kind = np.dtype(scalar)
        rng = np.random.default_rng(10)
        x = np.abs(random_arguments(scalar, rng, 200_000))
        low = np.abs(rng.integers(0, 2**20, 1000).astype(UINT[scalar])).view(kind)  # subnormal
        squares = rng.integers(1, 2 ** (kind.itemsize * 3), 1000).astype(kind) ** 2
        ends = np.array([0.0, -0.0, np.inf, np.finfo(kind).max, np.finfo(kind).tiny, 1.0, 2.0, 4.0], kind)
        x = np.concatenate([x, low, squares, np.nextafter(squares, kind.type(0)), ends])
        assert np.array_equal(bits(own.sqrt(x)), bits(np.sqrt(x)))
        assert np.all(np.isnan(own.sqrt(np.array([-1.0, -np.inf, np.nan, -np.finfo(kind).tiny], kind))))


@pytest.mark.parametrize("fault", ["sine", "pi", "word", "select"])
def test_a_fault_is_found(fault, tmp_path):
    """The measuring of errors itself: a wrong coefficient, a wrong part of pi/2 or word of 2/pi, a wrong quadrant."""

    def plant(text):
        numbers = mathematics.math_context("float64")
        old, new = {
            "sine": (numbers["sine"][2], numbers["sine"][2][:-8] + numbers["sine"][3][-4:]),
            "pi": (numbers["short"][1], numbers["cosine"][5]),
            "word": (f"0x{numbers['words'][20]:08x}u", "0x12345678u"),
            "select": ("((quadrant + 1) & 2)", "((quadrant + 3) & 2)"),
        }[fault]
        return mutated(text, re.escape(old), new)

    own = Compiled(tmp_path, "float64", edit=plant)
    x = random_arguments("float64", np.random.default_rng(11), 200)
    errors = [ulps(f(x), exactly(g, x), "float64") for f, g in ((own.sin, mp.sin), (own.cos, mp.cos))]
    assert np.max(errors) > mathematics.LARGEST_ERROR


@pytest.mark.parametrize("name", ["gcc", "clang"])
@pytest.mark.parametrize("scalar", SCALARS)
def test_strict_flags(name, scalar, tmp_path):
    text = write(tmp_path, scalar)
    flags = [compiler(name), *STRICT, "-ffp-contract=off", "-c", text, "-o", tmp_path / "own.o"]
    for define in ((), ("-DSERVOGEN_INTEGER_SQRT",)):
        done = subprocess.run([*map(str, flags), *define], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_a_scene_calls_what_it_needs():
    scene = load_scene("planar_arm_3r")
    source = {m: (p := sg.build(scene, math=m)).path.joinpath(f"{p.prefix}.c").read_text() for m in ("own", "libm")}
    assert "_sincos(" in source["own"]
    assert " = sin(" not in source["own"]
    assert " = sin(" in source["libm"]
    assert "two_over_pi" not in source["libm"]
    spacecraft = sg.build(load_scene("spacecraft"))
    assert "two_over_pi" not in spacecraft.path.joinpath("spacecraft.c").read_text()
    assert spacecraft.manifest["math"] == "own"
    with pytest.raises(sg.SceneError, match="choose 'own' or 'libm'"):
        sg.build(scene, math="other")
