"""Numbers in messages are written as a person would write them."""

import re
from pathlib import Path

import pytest

import lfmesh as lf
from lfmesh.scene.literals import percent, plain


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (99.6, 2, "100"),
        (9.7, 1, "10"),
        (1234.0, 2, "1200"),
        (0.5, 2, "0.5"),
        (-250.4, 1, "-300"),
        (2.5e-9, 2, "2.5e-09"),
        (3.4e17, 2, "3.4e+17"),
        (float("inf"), 2, "inf"),
        (float("nan"), 2, "nan"),
    ],
)
def test_a_number_has_no_exponent_where_none_is_needed(value: float, digits: int, text: str) -> None:
    assert plain(value, digits) == text


@pytest.mark.parametrize("share", [0.0, 1e-5, 0.004, 0.0995, 0.1, 0.995, 0.9999, 1.0, 9.999, 10.0, 123.4])
def test_a_percentage_has_no_exponent(share: float) -> None:
    assert re.fullmatch(r"(more than )?\d+(\.\d+)? %", percent(share)), percent(share)


def test_no_percentage_is_written_with_so_few_digits_that_100_has_an_exponent() -> None:
    sources = Path(lf.__file__).parent.rglob("*.py")
    assert not [path for path in sources if re.search(r":\.[12]g\} ?%", path.read_text())]


def test_all_of_the_light_is_100_percent() -> None:
    assert percent(1.0) == "100 %"
