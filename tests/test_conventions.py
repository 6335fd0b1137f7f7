"""The script that shows what a convention of PSNR is worth: `tools/conventions.py`."""

import conventions
import numpy as np
import pytest


def test_a_convention_compares_what_it_says():
    truth = np.full((4, 4, 3), 0.25)
    truth[0, 0] = 4.0  # above white
    answer = truth.copy()
    answer[0, 0] = 2.0  # clipped to the same white
    found = conventions.conventions(truth, answer)
    assert found["display"] == found["linear, clipped"] == conventions.MOST_DB
    assert found["linear"] == pytest.approx(-10 * np.log10(4 / 16))
    assert found["display, each slice's own exposure"] < 30


def test_an_error_in_the_dark_counts_more_as_displayed():
    truth = np.full((4, 4, 3), 0.02)
    found = conventions.conventions(truth, truth + 0.01)
    assert found["linear"] == found["linear, clipped"] == pytest.approx(40)
    assert found["display, each slice's own exposure"] < found["display"] < 30
