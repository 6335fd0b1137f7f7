import pytest

from reports.numbers import significant


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
