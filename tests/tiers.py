"""What the short tier of tests has of a list, the rest of which is `long`."""

from collections.abc import Iterable
from typing import Any

import pytest


def short_for(names: Iterable[str], *short: str) -> list[Any]:
    """Parameters of a test: those of `short`, and the others marked as `long`."""
    return [name if name in short else pytest.param(name, marks=pytest.mark.long) for name in names]
