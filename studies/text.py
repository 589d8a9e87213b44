# ruff: noqa: RUF001 - what is shown has dashes and Greek letters
"""Numbers, symbols and units as text, the same for terminal, Markdown and pages; HTML and SVG have true minus signs."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from ldctoolkit.declared import GainValue
from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS

if TYPE_CHECKING:
    from markupsafe import Markup

_GREEK = {
    "alpha": "α", "beta": "β", "delta": "δ", "kappa": "κ", "lambda": "λ",
    "mu": "μ", "omega": "ω", "phi": "φ", "psi": "ψ", "rho": "ρ", "sigma": "σ", "theta": "θ",
}  # fmt: skip
SYMBOL = re.compile(
    r"(?<![A-Za-z0-9_])([A-Za-z]|sigma|delta|psi|rho|lambda)_([A-Za-z0-9]{1,5}(?:_[A-Za-z0-9]{1,4})?)(?![A-Za-z0-9_])"
)
"""A symbol with an index, as the code writes it: ``y_s``, ``K_psi``."""

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]|[\u202a-\u202e\u2066-\u2069]")

DASH = "–"  # where there is no number
_HYPHEN = re.compile(r"(?<![\w.])-(?=[\d∞])|(?<=\de)-(?=\d)")

_SMALL = 1e-3  # a difference below this [m s] is shown with two digits of its own, not with decimals


def printable(text: str) -> str:
    """The text without characters that XML forbids, and without those that turn the direction of what follows."""
    return _NOT_XML.sub("\ufffd", text)


def shorten(text: str, most: int) -> str:
    """At most that many printable characters."""
    shown = printable(text)
    return shown if len(shown) <= most else shown[: most - 1] + "…"


def symbol_parts(match: re.Match[str]) -> tuple[str, str]:
    """Base and index of a `SYMBOL`, Greek names as letters."""
    base, index = match.groups()
    shown = ", ".join(_GREEK.get(part, part) for part in index.split("_"))
    return _GREEK.get(base, base), shown


def symbols(text: str) -> Markup:
    """Escaped HTML with true minus signs, in which ``K_psi`` is set as a letter with an index."""
    return _with_indices(text, "{}<sub>{}</sub>")


def symbols_svg(text: str) -> Markup:
    """The same as text of an SVG element."""
    return _with_indices(text, '{}<tspan dy="3" font-size="75%">{}</tspan><tspan dy="-3">\u200b</tspan>')


def _with_indices(text: str, form: str) -> Markup:
    from markupsafe import Markup, escape

    escaped = str(escape(true_minus(printable(text))))
    return Markup(SYMBOL.sub(lambda match: form.format(*symbol_parts(match)), escaped))


def true_minus(text: str) -> str:
    """Numbers in a text with a true minus sign."""
    return _HYPHEN.sub("−", text)


def formatted(value: float, form: str) -> str:
    """A number by a format specification; a dash where there is none, and no sign before zero."""
    if not math.isfinite(value):
        return DASH if math.isnan(value) else ("∞" if value > 0 else "-∞")
    shown = format(value, form)
    return shown if shown.strip("-+0.,") else shown.lstrip("-+")


def number(value: float, digits: int = 3) -> str:
    """A number with that many decimals; a dash where there is none."""
    return formatted(value, f".{digits}f")


def figure(value: float, digits: int = 3) -> str:
    """A number with that many significant digits, for quantities of any size; powers of ten where they help."""
    small = value and abs(value) < 1e-3
    mantissa, e, exponent = formatted(value, f".{digits - 1}e" if small else f".{digits}g").partition("e")
    return f"{mantissa}e{int(exponent)}" if e else mantissa


def signed(value: float, digits: int = 3) -> str:
    """Like `number`, with a plus sign for what is greater than zero."""
    shown = number(value, digits)
    return f"+{shown}" if 0 < value < math.inf and shown.strip("0.") else shown


def difference_text(value: float, digits: int = 4) -> str:
    """A difference of S with its sign, and with two digits however small it is."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else signed(value)
    return signed(value, digits) if abs(value) >= _SMALL else f"{value:+.1e}"


def percent(value: float, digits: int = 1) -> str:
    r"""A share as per cent, with a no-break space before the sign."""
    return f"{number(100.0 * value, digits)}\u00a0%"


def change(reduction: float) -> str:
    r"""The change that a reduction means, with its sign."""
    return f"{signed(-100.0 * reduction, 1)}\u00a0%"


def compact(value: GainValue) -> str:
    """The value of a gain as it is written in a study file."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)


def unit_text(unit: str) -> str:
    """A unit with raised powers and middle dots: ``kg m^2`` becomes ``kg·m²``; empty for a pure number."""
    if unit == "1":
        return ""
    raised = re.sub(
        r"\^(-?\d)", lambda m: m[1].replace("-", "⁻").translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")), unit
    )
    return raised.replace(" ", "·")


def plural(count: int, one: str, many: str | None = None) -> str:
    """``1 design``, ``1,200 designs``."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"


PARAMETER_UNIT_TEXT = dict(zip(PARAMETER_NAMES, map(unit_text, PARAMETER_UNITS), strict=True))
"""Unit of each departure parameter on a page."""

PARAMETER_MEANINGS = {
    "T": "duration",
    "d_y": "peak lateral departure",
    "sigma_y": "lateral residual",
    "v_mean": "mean speed",
    "a_mean": "mean acceleration",
    "sigma_v": "speed residual",
    "c_0": "initial curvature, outward",
    "dc": "change of curvature, outward",
}
"""What each departure parameter is."""


def parameter_label(name: str) -> str:
    """Name and unit of a parameter: ``d_y [m]``."""
    return f"{name} [{PARAMETER_UNIT_TEXT[name]}]" if PARAMETER_UNIT_TEXT.get(name) else name
