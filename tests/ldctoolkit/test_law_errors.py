"""What a law raised becomes one line that can be printed and stored, whatever the exception is like."""

import asyncio

import pytest

from ldctoolkit.errors import InputError
from ldctoolkit.law_checks import raised


class Silent(Exception):
    def __str__(self) -> str:
        raise SystemExit("no words")


class Stopped(Exception):
    def __str__(self) -> str:
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (Silent(), "Silent: its message cannot be read, __str__ raises SystemExit"),
        (ValueError("a \ud800 b"), r"ValueError: a \ud800 b"),
        (ValueError("a\x1b[31m\x00\tb\x7f\nc\u202e"), "ValueError: a[31m b c"),
        (InputError("K: 'ü'\x07"), "K: 'ü'"),
        (asyncio.CancelledError(), "CancelledError"),
    ],
)
def test_one_clean_line(error: BaseException, line: str) -> None:
    assert raised(error) == line
    assert raised(error).isprintable()
    raised(error).encode("utf-8")


def test_the_longest_line() -> None:
    assert len(raised(InputError("\ud800" * 400))) == 500


def test_an_interrupt_is_none_of_a_law() -> None:
    with pytest.raises(KeyboardInterrupt):
        raised(Stopped())
