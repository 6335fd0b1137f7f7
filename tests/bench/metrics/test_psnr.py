import math

import numpy as np
import pytest
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio

from bench.metrics.display import to_display, to_log1p
from bench.metrics.psnr import DisplayPSNR, LinearRMSE, LogPSNR, psnr
from bench.records import MOST_DB

METRICS = [DisplayPSNR(), LogPSNR(), LinearRMSE()]


def pair(seed=0, shape=(17, 23, 3)):
    rng = np.random.default_rng(seed)
    reference = rng.random(shape) ** 3 * 4
    return reference, np.maximum(reference + 0.1 * rng.standard_normal(shape), 0)


def test_psnr_is_that_of_scikit_image():
    reference, test = pair()
    for metric, transform, peak in ((DisplayPSNR(), to_display, 1.0), (LogPSNR(), to_log1p, math.log1p(8))):
        ours = metric.values(metric.score(metric.prepare(reference, 0.4), test))
        theirs = peak_signal_noise_ratio(transform(reference, 0.4), transform(test, 0.4), data_range=peak)
        assert ours == pytest.approx(theirs, abs=1e-10)


def test_rmse_is_that_of_scikit_image_at_any_exposure():
    reference, test = pair()
    metric = LinearRMSE()
    for exposure in (0.1, 3.0):
        ours = metric.values(metric.score(metric.prepare(reference, exposure), test))
        assert ours == pytest.approx(math.sqrt(mean_squared_error(reference, test)), rel=1e-12)


def test_a_slice_counts_as_at_most_a_step_of_a_display():
    assert psnr(0.0, 1.0) == np.inf
    assert DisplayPSNR().values(np.array([0.0, 1e-12, 0.01])) == pytest.approx([MOST_DB, MOST_DB, 20])
    assert DisplayPSNR().pool(np.array([0.0, 0.02])) == pytest.approx(20)
    assert DisplayPSNR().pool(np.zeros(3)) == MOST_DB


def test_pooled_psnr_is_that_of_all_slices_as_one():
    pairs = [pair(seed) for seed in range(4)]
    for metric in METRICS:
        raw = np.array([metric.score(metric.prepare(r, 0.5), t) for r, t in pairs])
        tall = metric.prepare(np.concatenate([r for r, _ in pairs]), 0.5)
        whole = metric.score(tall, np.concatenate([t for _, t in pairs]))
        assert metric.pool(raw) == pytest.approx(metric.values(whole), rel=1e-12)
