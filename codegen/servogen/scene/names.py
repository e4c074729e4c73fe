"""Names that reach the generated C: identifiers, and what they must not be."""

import re

from servogen.errors import SceneError

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")

C_KEYWORDS = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    alignas alignof atomic bool complex false generic imaginary noreturn nullptr static_assert thread_local true
    typeof typeof_unqual""".split()
)

CXX_KEYWORDS = frozenset(
    """and and_eq asm bitand bitor catch char8_t char16_t char32_t class compl concept const_cast consteval constexpr
    constinit co_await co_return co_yield decltype delete dynamic_cast explicit export friend mutable namespace
    new noexcept not not_eq operator or or_eq private protected public reinterpret_cast requires static_cast
    template this throw try typeid typename using virtual wchar_t xor xor_eq""".split()
)

# Object-like macros of the standard headers and of common compilers, and function-like ones of <math.h>.
STANDARD_MACROS = frozenset(
    """I NULL EOF NAN INFINITY HUGE_VAL HUGE_VALF HUGE_VALL MATH_ERRNO MATH_ERREXCEPT math_errhandling errno assert
    NDEBUG EDOM ERANGE EILSEQ CHAR_BIT INT_MAX INT_MIN UINT_MAX LONG_MAX LONG_MIN SIZE_MAX DBL_EPSILON DBL_MAX
    DBL_MIN FLT_EPSILON FLT_MAX FLT_MIN FLT_RADIX M_E M_LOG2E M_LOG10E M_LN2 M_LN10 M_PI M_PI_2 M_PI_4 M_1_PI
    M_2_PI M_2_SQRTPI M_SQRT2 M_SQRT1_2 DOMAIN SING OVERFLOW UNDERFLOW PLOSS TLOSS MAXFLOAT FP_NAN FP_INFINITE
    FP_ZERO FP_SUBNORMAL FP_NORMAL FP_ILOGB0 FP_ILOGBNAN fpclassify isfinite isinf isnan isnormal signbit
    isgreater isgreaterequal isless islessequal islessgreater isunordered stdin stdout stderr BUFSIZ EXIT_FAILURE
    EXIT_SUCCESS RAND_MAX SIGINT offsetof va_arg va_start va_end unix linux i386 near far min max
    signgam BIG_ENDIAN LITTLE_ENDIAN PDP_ENDIAN BYTE_ORDER FD_SETSIZE NFDBITS MB_CUR_MAX WCONTINUED WEXITED WNOHANG
    WNOWAIT WSTOPPED WUNTRACED HAVE_INITFINI_ARRAY""".split()
)

# Families of them: those of <stdint.h>, and what the headers add for each floating type.
_MACRO_FAMILY = re.compile(
    r"""U?INT(_LEAST|_FAST)?\d*(PTR|MAX)?_(MAX|MIN|WIDTH|C) | (PTRDIFF|SIG_ATOMIC|SIZE|WCHAR|WINT)_(MAX|MIN|WIDTH)
    | M_(E|LOG2E|LOG2_E|LOG10E|LN2|INVLN2|LN2HI|LN2LO|LN10|IVLN10|PI|PI_2|PI_4|3PI_4|TWOPI|1_PI|2_PI|SQRTPI|2_SQRTPI
      |SQRT2|SQRT3|SQRT1_2)(l|f(\d+x?)?)? | S?NAN(L|F(\d+X?)?)? | HUGE_VAL_F\d+X? | FP_(INT|LLOGB)\w+""",
    re.VERBOSE,
)

# Files that headers of C and POSIX would be hidden by, and names that Windows keeps for devices.
HEADERS = frozenset(
    """assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
    aio cpio dirent dlfcn endian fcntl fmtmsg fnmatch ftw glob grp iconv langinfo libgen libintl monetary mqueue ndbm
    netdb nl_types poll pthread pwd regex sched search semaphore spawn strings stropts syslog tar termios trace ulimit
    unistd utime utmpx wordexp malloc memory values features""".split()
)
DEVICES = frozenset(["con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))])

LONGEST = 100
"""Characters of a prefix: file systems take 255 bytes for a name, and what stands behind a prefix is longer than it."""

# Keywords of the Python twins, and the names the inputs of every scene have.
INPUT_NAMES = ("q", "u", "t", "tau", "y")
CALL_NAMES = frozenset({"dt", "last", "self"})


def check_identifier(name: str, what: str) -> str:
    """Return `name` if it can stand in C, in C++ and in a call of a twin; SceneError otherwise."""
    if not isinstance(name, str) or not _IDENTIFIER.match(name):
        raise SceneError(
            f"{what} {name!r} is not a C identifier; use letters, digits and underscores, not starting with a digit"
        )
    for kind, words in (
        ("a C keyword", C_KEYWORDS),
        ("a C++ keyword", CXX_KEYWORDS),
        ("a standard macro", STANDARD_MACROS),
    ):
        if name in words:
            raise SceneError(f"{what} {name!r} is {kind}; choose another name")
    if _MACRO_FAMILY.fullmatch(name):
        raise SceneError(f"{what} {name!r} is a standard macro; choose another name")
    if name.startswith("__") or re.match(r"_[A-Z]", name):
        raise SceneError(f"{what} {name!r} is reserved for the C implementation; drop the leading underscore")
    return name


def check_file_name(name: str, what: str) -> str:
    """As `check_identifier`, and free to be a file <name>.h beside the headers of a system, whatever its case."""
    check_identifier(name, what)
    if len(name) > LONGEST:
        raise SceneError(f"{what} {name[:20]!r}... has {len(name)} characters; give it at most {LONGEST}")
    if name.lower() in HEADERS:
        raise SceneError(f"{what} {name!r} would hide the standard header <{name.lower()}.h>; choose another name")
    if name.lower() in DEVICES:
        raise SceneError(
            f"{what} {name!r} is a device on Windows, which can have no file {name}.h; choose another name"
        )
    return name


def check_field_name(name: str, what: str) -> str:
    """As `check_identifier`, and free to be a field beside the inputs q, u, t, tau and y."""
    check_identifier(name, what)
    if name in INPUT_NAMES:
        raise SceneError(f"{what} {name!r} collides with the input {name}; choose another name")
    if name in CALL_NAMES:
        raise SceneError(f"{what} {name!r} collides with a keyword of the controller's calls; choose another name")
    return name


def comment_safe(text: str) -> str:
    """`text` on one line, and unable to end the C comment it is put in."""
    visible = "".join(c if c.isprintable() else " " for c in str(text))
    return " ".join(visible.split()).replace("*/", "* /").replace("/*", "/ *")
