import pytest

from reports.numbers import fixed, integer, significant


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "—"),
        (0, "0"),
        (0.0, "0"),
        (0.00123456, "0.00123"),
        (1.0, "1.00"),
        (12.345, "12.3"),
        (999.96, "1,000"),
        (123456.7, "123,457"),
        (-3.14159, "-3.14"),
        (2.5e-9, "2.50e-09"),
        (1e12, "1.00e+12"),
    ],
)
def test_three_digits_count(value, text):
    assert significant(value) == text


def test_other_numbers():
    assert (integer(1234567), integer(None)) == ("1,234,567", "—")
    assert (fixed(1234.5678, 2), fixed(None, 2)) == ("1,234.57", "—")
