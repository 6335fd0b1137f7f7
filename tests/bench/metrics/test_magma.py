import flip_evaluator
import numpy as np
import pytest

from bench.inputs.errors import InputError
from bench.metrics.display import decode_srgb
from bench.metrics.flip import LDR, magma


def test_colours_are_those_of_the_oracle():
    rng = np.random.default_rng(0)
    reference, test = rng.random((2, 40, 50, 3), dtype=np.float32)
    theirs = flip_evaluator.evaluate(reference, test, "LDR", computeMeanError=False)[0]
    metric = LDR()
    ours = magma(metric.error_map(metric.prepare(decode_srgb(reference), 1.0), decode_srgb(test)))
    # Where a value lies within rounding of the border of two colours, the neighbour may be taken.
    same = (np.abs(ours - theirs) < 1e-6).all(-1)
    assert same.mean() > 0.99
    assert np.abs(ours - theirs).max() < 0.02


@pytest.mark.parametrize("bad", [np.array([[1.1]]), np.array([[-0.1]]), np.array([[np.nan]]), np.array([[1]])])
def test_values_outside_the_unit_interval_are_refused(bad):
    with pytest.raises(InputError, match="error_map"):
        magma(bad)
