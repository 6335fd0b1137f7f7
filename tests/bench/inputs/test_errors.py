import errno
import os

import pytest

from bench import cli
from bench.inputs.errors import InputError, readable, said_by, unwritable, visible


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("satin, 64 × 64 — θ_o", "satin, 64 × 64 — θ_o"),
        ("a\n::error file=x::b", r"a\n::error file=x::b"),
        ("\x1b[2J\r\x9b\x7f", r"\x1b[2J\r\x9b\x7f"),
        ("right\u202eleft\u2028next", r"right\u202eleft\u2028next"),
        ("not \udcff UTF-8", r"not \udcff UTF-8"),
        ("::error::x ##[error]y a::b a##b", r"\x3a:error::x \x23#[error]y a::b a##b"),
    ],
)
def test_a_text_neither_steers_a_terminal_nor_starts_a_command(text, shown):
    assert visible(text) == shown


class SilentError(Exception):
    def __str__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("\n\n  second\nthird"), "ValueError: second"),
        (ValueError(), "ValueError"),
        (SilentError(), "SilentError, whose message cannot be shown"),
    ],
)
def test_any_error_is_described_in_one_line(error, said):
    assert said_by(error) == said


def test_an_error_is_one_line_whatever_it_names(capsys):
    assert cli.main(["table", "no\n::error file=x::run\x1b[2J"]) == 2
    said = capsys.readouterr().err
    assert r"no\n::error file=x::run\x1b[2J: " in said
    assert said.count("\n") == 1


def test_a_read_only_file_system_needs_another_place_and_not_more_room():
    said = unwritable(OSError(errno.EROFS, os.strerror(errno.EROFS), "out/a.npz"))
    assert said.startswith("out/a.npz: ")
    assert "$NEUBTF_CACHE" in said
    assert "$NEUBTF_CACHE" not in unwritable(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "a"))


def test_a_file_that_may_not_be_read_is_not_called_damaged():
    with pytest.raises(InputError, match=r"^a\.npz: .*denied.*permissions$"), readable("a.npz"):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "a.npz")
