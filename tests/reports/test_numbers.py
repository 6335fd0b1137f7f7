import pytest

from reports.numbers import significant


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "—"), (0.0, "0"), (0.00123456, "0.00123"), (999.96, "1,000"), (123456.7, "123,457"), (1e12, "1.00e+12")],
)
def test_three_digits_count(value, text):
    assert significant(value) == text
