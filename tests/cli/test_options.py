from dataclasses import asdict, dataclass

import numpy as np
import pytest
import tyro

from legibility.cli.options import flags, levels, made, span
from legibility.errors import InvalidInputError


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        (["0.5"], [0.5]),
        (["-1", "-.5", "1e-3"], [-1, -0.5, 0.001]),
        (["-1:1:9"], np.linspace(-1, 1, 9)),
        (["-1:1:11"], [-1, -0.8, -0.6, -0.4, -0.2, 0, 0.2, 0.4, 0.6, 0.8, 1]),
        (["1:-1:3", "0"], [1, 0, -1, 0]),
        (["0.3:0.3:1"], [0.3]),
    ],
)
def test_levels(entries, expected):
    found = levels(entries)
    np.testing.assert_array_equal(found, expected)
    assert not np.signbit(found[found == 0]).any()


@pytest.mark.parametrize(
    "entries",
    [[], [""], ["a"], ["nan"], ["inf"], ["1.01"], ["-2:1:3"], ["-1:1"], ["-1:1:0"], ["-1:1:2.5"],
     ["-1:1:3:4"], ["nan:1:3"], ["-1:1:9999999999"]],
)  # fmt: skip
def test_wrong_levels(entries):
    with pytest.raises(InvalidInputError, match="legibility must"):
        levels(entries)


@pytest.mark.parametrize(
    ("text", "expected"), [("2..6", (2, 6)), ("3", (3, 3)), (" 4..4 ", (4, 4))]
)
def test_span(text, expected):
    assert span("goals", text) == expected


@pytest.mark.parametrize(
    "text", ["", "..", "2..", "..6", "2-6", "2...6", "a", "-1..3", "2.5", "6..2", "²"]
)
def test_wrong_span(text):
    with pytest.raises(InvalidInputError, match="goals must"):
        span("goals", text)


@dataclass(frozen=True)
class Settings:
    """What to do.

    Attributes:
        size: of the thing.
        goals: least and most.
        widths: of its parts.
        weight: of it, if any.
        kind: of thing.
    """

    size: int = 3
    goals: tuple[int, int] = (2, 6)
    widths: tuple[int, ...] = (1, 2)
    weight: float | None = None
    kind: str = "plain"

    def __post_init__(self):
        if self.size > 9:
            raise InvalidInputError("size must be at most 9")


def test_flags_are_the_fields():
    parsed = tyro.cli(flags(Settings), args=[])
    assert made(Settings, parsed) == Settings()
    arguments = "--goals 3 --widths 4 5 6 --weight -0.5 --size 7"
    parsed = tyro.cli(flags(Settings), args=arguments.split())
    expected = Settings(size=7, goals=(3, 3), widths=(4, 5, 6), weight=-0.5)
    assert made(Settings, parsed) == expected


def test_flags_leave_out_what_is_given_otherwise():
    parsed = tyro.cli(flags(Settings, "kind", "size"), args=[])
    assert asdict(made(Settings, parsed, kind="other", size=5)) == asdict(Settings(5, kind="other"))


@pytest.mark.parametrize(
    ("arguments", "message"), [("--size 10", "at most 9"), ("--goals 6..2", "goals must")]
)
def test_mistakes_in_flags_are_told_in_our_words(arguments, message):
    parsed = tyro.cli(flags(Settings), args=arguments.split())
    with pytest.raises(InvalidInputError, match=message):
        made(Settings, parsed)
