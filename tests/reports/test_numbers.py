from math import inf

import pytest

from reports.numbers import as_read, fixed, significant


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "—"),
        (0.0, "0"),
        (0.00123456, "0.00123"),
        (999.96, "1,000"),
        (9.996, "10.0"),
        (99.96, "100"),
        (123456.7, "123,457"),
        (1e12, "1.00e+12"),
    ],
)
def test_three_digits_count(value, text):
    assert significant(value) == text


def test_a_minus_is_as_wide_as_a_plus():
    assert fixed(-1234.04, 1) == "−1,234.0"


@pytest.mark.parametrize(
    ("value", "digits", "read"),
    [
        (1234.567, 1, 1234.6),
        (0.00123456, -3, 0.00123),
        (12345.6, -3, 12346),
        (12345678.9, -3, 1.23e7),
        (9.996, -3, 10),
        (inf, -3, inf),
    ],
)
def test_a_number_is_rounded_as_it_reads(value, digits, read):
    assert as_read(value, digits) == read
