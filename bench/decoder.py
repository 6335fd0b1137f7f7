"""The former name of a part of `bench.training`: it warns in this version, and goes in the next."""

import warnings
from typing import Any

from bench import training


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    warnings.warn(f"bench.decoder is bench.training now: import {name} from there", DeprecationWarning, stacklevel=2)
    return getattr(training, name)
