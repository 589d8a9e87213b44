"""Hours, rates and sizes as text."""

from __future__ import annotations

import math

from studies.report.words.text import number


def hours(value: float) -> str:
    """Hours with two decimals where they are few.

    Examples
    --------
    >>> hours(0.5), hours(1234.5)
    ('0.50', '1,234')
    """
    return number(value, 2) if value < 10.0 else number(value, 1) if value < 100.0 else f"{value:,.0f}"


def rate(value: float) -> str:
    """Events per hour; a dash without any hours.

    Examples
    --------
    >>> rate(12.34), rate(0.034)
    ('12.3', '0.034')
    """
    if not math.isfinite(value):
        return number(value)
    return number(value, 0 if value >= 100.0 else 1 if value >= 10.0 else 2 if value >= 0.1 or value == 0.0 else 3)


def size(count: int) -> str:
    """Bytes in a unit that gives a short number, powers of ten.

    Examples
    --------
    >>> size(17), size(31_400_000)
    ('17 B', '31.4 MB')
    """
    value, units = float(count), iter(("kB", "MB", "GB", "TB"))
    unit = "B"
    while value >= 999.5 and unit != "TB":
        value, unit = value / 1000.0, next(units)
    return f"{value:.0f} {unit}" if unit == "B" or value >= 99.95 else f"{value:.1f} {unit}"
