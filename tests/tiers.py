"""What the short tier of tests has of a list, the rest of which is `long`."""

from collections.abc import Iterable
from typing import Any

import pytest


def long(*values: Any) -> Any:
    """The parameters of a long test."""
    return pytest.param(*values, marks=pytest.mark.long)


def short_for(names: Iterable[Any], *short: Any) -> list[Any]:
    """Parameters of a test: those of `short`, and the others marked as `long`."""
    return [name if name in short else long(name) for name in names]
