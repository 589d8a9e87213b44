"""Sentences on other plants: whether the winner stays first, what hurts it most, who fails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup

from studies.report.tables.row import Row, is_baseline
from studies.report.words.prose import design_text
from studies.report.words.text import figure, number, percent, plural, signed, symbols
from studies.robustness.paired_interval import SAME
from studies.robustness.robustness import Robustness

TOGETHER = ("together", "ideal")
"""Plants that differ in more than one option."""

_NAMED = 3
_LISTED = 3
_WHOLE = 100.0  # [%] from which decimals say nothing

_SMALL = 1e-3  # [m s] which three decimals do not tell from nothing


def robustness_sentences(found: Robustness, rows: Sequence[Row], names: Sequence[str], of: str) -> list[Markup]:
    """The answer of the section, each a paragraph.

    Parameters
    ----------
    found : Robustness
        With at least one design and scenario.
    rows : sequence of Row
        Of its designs.
    names : sequence of str
        What they are called here.
    of : str
        What the first one is: ``"the winner"``.

    Returns
    -------
    list of Markup
    """
    said = [_stays(found, rows, names, of), Markup(" ").join(_gaps(found, names))]
    if not is_baseline(rows[0]):
        said.append(Markup(" ").join(_hurts(found)))
    said.append(_fails(found, rows, names))
    said += _worse(found, rows, names)
    return [one for one in said if one]


def _stays(found: Robustness, rows: Sequence[Row], names: Sequence[str], of: str) -> Markup:
    """Where the first design is clearly first, where it is level with the best other one, and where it is behind."""
    reference = Markup("<strong>{}</strong>, {},").format(design_text(rows[0]), of)
    if not (found.rival >= 0).any() or len(found.plants) < 2:
        return Markup("{} stands alone here: there is no other design to change ranks with.").format(reference)
    others = range(1, len(found.plants))
    first = [k for k in others if _is_first(found, k)]
    behind = [k for k in others if _is_behind(found, k)]
    level = [k for k in others if k not in first and k not in behind]
    rivals = {int(found.rival[k]) for k in level}
    rival = symbols(names[rivals.pop()]) if len(rivals) == 1 else "the best other design"
    parts: list[Markup] = []
    for words, plants in (
        (Markup("clearly first on"), first),
        (Markup("level with {} on").format(rival), level),
        (Markup("behind on"), behind),
    ):
        if plants:
            whole = f"all {len(others)} other plants" if len(plants) == len(others) > 1 else ""
            of_all = f" of the {plural(len(others), 'other plant')}" if not parts else ""
            parts.append(Markup("{} {}").format(words, whole or f"{len(plants)}{of_all}"))
    if behind:
        parts[-1] += _ranks(found, behind)
    told = Markup(" and ").join([one for one in (Markup(", ").join(parts[:-1]), parts[-1]) if one])
    return Markup("{} is {}, by mean S on the same {}.").format(reference, told, plural(found.n, "departure"))


def _gaps(found: Robustness, names: Sequence[str]) -> Iterator[Markup]:
    """Whether the first design is first in these departures at all, and where it is behind the most."""
    if len(found.plants) < 2 or not (found.rival >= 0).any():
        return
    if not _is_first(found, 0):
        word = "behind" if _is_behind(found, 0) else "level with"
        best = "the others, its law raised" if found.rival[0] < 0 else symbols(names[int(found.rival[0])])
        yield Markup("On the study\u2019s own plant it is {} {} in these departures.").format(word, best)
    behind = [k for k in range(1, len(found.plants)) if _is_behind(found, k) and np.isfinite(found.lead[k])]
    if behind:
        worst = max(behind, key=lambda k: (found.lead[k], -k))
        yield Markup("On <em>{}</em> {} is better by {}\u00a0m·s ({}).").format(
            found.titles[worst], symbols(names[int(found.rival[worst])]), gap_text(float(found.lead[worst])),
            _interval(float(found.lead_low[worst]), float(found.lead_high[worst])),
        )  # fmt: skip


def _is_first(found: Robustness, k: int) -> bool:
    """Better than every other design beyond chance, or the only one whose law did not raise."""
    alone = found.rival[k] < 0 and np.isfinite(found.S[k, 0])
    return bool(alone or found.lead_high[k] < -SAME)


def _is_behind(found: Robustness, k: int) -> bool:
    """Worse than the best other design beyond chance, or without a score."""
    return bool(np.isnan(found.S[k, 0]) or found.lead_low[k] > SAME)


def _ranks(found: Robustness, plants: Sequence[int]) -> Markup:
    """Names of plants with the rank of the first design, the last rank first."""
    order = sorted(plants, key=lambda k: (np.isfinite(found.S[k, 0]), -found.rank[k, 0], k))
    told = [
        Markup("<em>{}</em>, {}").format(found.titles[k], f"rank {found.rank[k, 0]}" if found.rank[k, 0] else "no rank")
        for k in order[:_NAMED]
    ]
    more = f"; and {len(order) - _NAMED} more" if len(order) > _NAMED else ""
    return Markup(" ({}{})").format(Markup("; ").join(told), more)


def _hurts(found: Robustness) -> Iterator[Markup]:
    single = [
        k for k, name in enumerate(found.plants) if k and name not in TOGETHER and np.isfinite(found.change[k, 0])
    ]
    own = float(found.S[0, 0])
    if single and own > 0:
        worst = max(single, key=lambda k: (found.change[k, 0], -k))
        if found.change[worst, 0] > 0:
            said = "Of single options <em>{}</em> ({}) costs it most: mean S {} \u2192 {}\u00a0m·s, {} (interval {}{})."
            yield Markup(said).format(found.titles[worst], found.differences[worst], *_moved(found, worst))
        else:
            yield Markup("No single option makes its mean S larger.")
    for k, name in enumerate(found.plants):
        if name in TOGETHER and np.isfinite(found.change[k, 0]) and own > 0:
            said = "On <em>{}</em> its mean S is {} \u2192 {}\u00a0m·s, {} (interval {}{})."
            yield Markup(said).format(found.titles[k], *_moved(found, k))


def _moved(found: Robustness, k: int) -> tuple[str, str, str, str, str]:
    own = float(found.S[0, 0])
    low, high = (100.0 * float(end[k, 0]) / own for end in (found.low, found.high))
    untold = "" if low > 0 or high < 0 else "; that may be chance"
    digits = 1 if abs(high) < _WHOLE else 0
    interval = (
        f"{number(low, digits)} to {number(high, digits)}\u00a0%" if np.isfinite([low, high]).all() else "not known"
    )
    rise = change_text(found, k, 0)
    return number(own), number(float(found.S[k, 0])), rise, interval, untold


def _fails(found: Robustness, rows: Sequence[Row], names: Sequence[str]) -> Markup:
    more = found.failures[1:] - found.failures[0]
    lines = []
    for i in range(len(rows)):
        if more.size and more[:, i].max() > 0:
            k = 1 + int(more[:, i].argmax())
            lines.append((-int(found.failures[k, i]), i, k, int((more[:, i] > 0).sum())))
    if not lines:
        return Markup("No design fails in more departures than on the study\u2019s own plant.")
    lines.sort()
    told = []
    for _, i, k, plants in lines[:_LISTED]:
        told.append(
            Markup("{} fails on <em>{}</em> in {} of {} departures ({} on the study\u2019s plant){}.{}").format(
                symbols(names[i]), found.titles[k], found.failures[k, i], found.n, found.failures[0, i] or "none",
                _lost(int(found.diverged[k, i]), int(found.failures[k, i])),
                f" It fails more often on {plural(plants - 1, 'other plant')} too." if plants > 1 else "",
            )
        )  # fmt: skip
    if len(lines) > _LISTED:
        rest = len(lines) - _LISTED
        told.append(
            Markup("{} more often on some plant.").format(plural(rest, "other design fails", "other designs fail"))
        )
    return Markup("<strong>Failures.</strong> {}").format(Markup(" ").join(told))


def _lost(diverged: int, failures: int) -> str:
    if not diverged:
        return ""
    who = "it" if failures == 1 else (f"all {failures}" if diverged == failures else f"{diverged} of these")
    return f"; {who} left \u00b120\u00a0m"


def _worse(found: Robustness, rows: Sequence[Row], names: Sequence[str]) -> Iterator[Markup]:
    """Designs that are worse than no control somewhere, beyond chance, though not on the study's plant."""
    told = []
    for i, row in enumerate(rows):
        if is_baseline(row):
            continue
        bad = [is_worse(found, k, i) for k in range(len(found.plants))]
        where = [title for title, here in zip(found.titles, bad, strict=True) if here and not bad[0]]
        if where:
            few = ", ".join(where[:_NAMED]) + (f" and {len(where) - _NAMED} more" if len(where) > _NAMED else "")
            told.append(Markup("{} on <em>{}</em>").format(symbols(names[i]), few))
    if told:
        yield Markup("<strong>Worse than no control</strong>, though not on the study\u2019s plant: {}.").format(
            Markup("; ").join(told)
        )


def _interval(low: float, high: float) -> str:
    return f"interval {gap_text(low)} to {gap_text(high)}" if np.isfinite([low, high]).all() else "interval not known"


def gap_text(value: float) -> str:
    """A difference of scores; a small one with two significant digits, so that it is not shown as none.

    Examples
    --------
    >>> gap_text(-0.2), gap_text(0.00031), gap_text(0.0)
    ('−0.200', '3.1e−4', '0')
    """
    return figure(value, 2) if abs(value) < _SMALL else number(value)


def is_worse(found: Robustness, k: int, i: int) -> bool:
    """Whether a design is worse than no control on a plant, beyond chance."""
    return bool(found.excess_low[k, i] > SAME)


def is_not_shown(found: Robustness, k: int, i: int) -> bool:
    """Whether it came out worse there, but by no more than chance may do."""
    return bool(found.excess[k, i] > SAME) and not is_worse(found, k, i)


def change_text(found: Robustness, k: int, i: int) -> str:
    """Relative change of a design's mean S on a plant; a dash where there is none."""
    own, moved = float(found.S[0, i]), float(found.change[k, i])
    if not (own > 0 and np.isfinite(moved)):
        return "\u2013"
    share = 100.0 * moved / own
    return f"{signed(share, 1 if abs(share) < _WHOLE else 0)}\u00a0%"


def reduction_text(found: Robustness, k: int, i: int) -> str:
    """Reduction of mean S against no control on the same plant."""
    total = float(found.S_uncorrected[k, i])
    return percent(1.0 - float(found.S[k, i]) / total) if total > 0 else "\u2013"
