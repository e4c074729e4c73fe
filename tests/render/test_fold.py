"""Long lines of C: broken where it does least harm, and never so that a reader of loops or of comments is misled."""

from servogen.render.fold import LONGEST, folded

NAME = "a_rather_long_name_of_a_function"


def test_short_lines_stay() -> None:
    text = "int a; /* short */\n\n#define B 1 /* short */\n"
    assert folded(text) == text


def test_a_statement_breaks_before_what_binds_least() -> None:
    line = f"    x = {NAME}(first, second) * {NAME}(third, fourth) + {NAME}(fifth, sixth) * {NAME}(seventh, eighth);"
    assert folded(line).split("\n") == [
        f"    x = {NAME}(first, second) * {NAME}(third, fourth)",
        f"        + {NAME}(fifth, sixth) * {NAME}(seventh, eighth);",
    ]


def test_a_comment_flows_on_into_its_next_line() -> None:
    text = "/*" + " word" * 25 + "\n   and the end. */\nint x;\n"
    lines = folded(text).split("\n")
    assert [len(line) <= LONGEST for line in lines] == [True] * 4
    assert lines[1].endswith("word and the end. */")
    assert folded(text).split() == text.split()


def test_a_comment_behind_a_long_line_goes_in_front_of_it() -> None:
    loop = f"    for (i = 0; i < 12 && {NAME}(i); ++i) {{"
    comment = "/* which is said here at such a length that it does not fit */"
    assert folded(f"{loop} {comment}") == f"    {comment}\n{loop}"


def test_the_head_of_a_loop_and_a_single_long_name_stay() -> None:
    loop = f"    for (i = 0; i < 12 && {NAME}_{NAME}_{NAME}_{NAME}; ++i) {{"
    assert folded(loop) == loop
    assert folded("x" * 200) == "x" * 200


def test_it_ends_whatever_the_line() -> None:
    """A condition that has no place but in its indent, and a word of a comment as long as a line."""
    for line in (
        f"    if (!({'x' * 130})) {{",
        f"    if (!({NAME}(a) && {'y' * 140} && {'z' * 140})) {{",
        "    in.x = " + " + ".join(["t" * 70] * 5) + ";",
        "    /* " + "w" * 150 + " and more words behind it */",
        "/* " + "w" * 150 + " */",
    ):
        assert "".join(folded(line).split()) == "".join(line.split())
