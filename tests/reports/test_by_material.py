from collections import defaultdict
from math import inf, nan

import pytest

from reports.by_material import Measure
from reports.numbers import NOT_APPLICABLE


@pytest.mark.parametrize(("metric", "value", "why"), [("psnr_display", inf, ""), ("ssim", nan, NOT_APPLICABLE)])
def test_frames_without_a_number_are_exact_in_decibels_alone(metric, value, why):
    field = f"scene/metrics/{metric}"
    record = defaultdict(lambda: nan, {"scene/name": "ball"})
    cell = Measure("frames", "", field).over_seeds([record])
    assert (cell.value, cell.why) == (pytest.approx(value, nan_ok=True), why)
