"""Instances of one claim: most of them may be long tests where a few show what any of them would."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def instances(values: Iterable[Any], *, long: Collection[Any]) -> list[Any]:
    """Return the values of a parametrised test, some of them as long tests.

    Parameters
    ----------
    values : iterable
    long : collection
        Those that only --long runs; each must be among the values, and not all of them are.
    """
    values = list(values)
    unknown = [value for value in long if value not in values]
    assert not unknown, f"no instances: {unknown}"
    assert len(long) < len(values), "an instance must stay in the suite"
    return [pytest.param(value, marks=pytest.mark.long) if value in long else value for value in values]
