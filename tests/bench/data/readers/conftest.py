import os
import re
from pathlib import Path

import numpy as np
import pytest

from bench.btf import BTF, ArraySource
from bench.data.readers import open_btf
from bench.directions.hemisphere import from_degrees
from bench.inputs.errors import InputError


@pytest.fixture
def data():
    if "NEUBTF_DATA" not in os.environ:
        pytest.skip("NEUBTF_DATA is not set: it names the folder of real data")
    return Path(os.environ["NEUBTF_DATA"])


@pytest.fixture(scope="session")
def samples():
    import fuzz_readers

    return fuzz_readers


@pytest.fixture
def refused():
    """Asserts that no BTF opens at a path, in one line that names the path and says what is wrong."""

    def refuse(path, what, named=None, **options):
        with pytest.raises(InputError, match=what) as caught:
            open_btf(path, **options)
        assert re.fullmatch(f".*{re.escape(str(named or path))}.*", str(caught.value))

    return refuse


@pytest.fixture
def btf():
    """A BTF of 4 × 3 pairs and 5 × 6 texels with highlights far above 1 and one held-out pair."""
    views = from_degrees([0, 15, 30, 75], [0, 60, 120, 300])
    lights = from_degrees([11, 45, 75], [15, 200, 345])
    view, light = np.divmod(np.arange(12), 3)
    values = np.random.default_rng(1).gamma(0.5, 20.0, (12, 5, 6, 3)).astype(np.float32)
    notes = {"heldout": np.arange(12) == 7, "periodic": True, "provenance": {"ppmm": 10.0, "note": "kept"}}
    return BTF("sample", views[view], lights[light], ArraySource(values), **notes)
