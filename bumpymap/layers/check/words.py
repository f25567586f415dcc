"""Findings of a check in words, for pages and the terminal."""

from collections.abc import Iterable, Sequence

import numpy as np

from bumpymap.core import CheckedDrive, CheckResult, MapAgreement, count_text

__all__ = [
    "FEW",
    "check_headline",
    "check_verdict",
    "columns_words",
    "drive_notes",
    "level_words",
    "metres",
    "names_of",
    "percent",
    "skipped_words",
    "sorted_reasons",
    "warnings_of",
]

FEW = 5
"""Fewer stretches on the map say nothing about it."""
LEVEL = 1.15
"""Up to this factor of its median ratio from 1 a map holds."""
INSIDE = 0.8
"""Share of readings that the map's interval should hold; a level that is off with fewer is off beyond all errors."""
RANKS, ROUGHLY = 0.8, 0.5
"""From these Spearman correlations on a map ranks ground rightly, and roughly."""
EVEN = 1.5
"""Ground is too even to rank if its 90 % quantile is less than this factor above its 10 % quantile."""


def check_headline(result: CheckResult) -> str:
    """Return the result in two or three sentences: whether the map holds, over how much ground, how well."""
    agreement = result.agreement
    if agreement is None:
        measured, lengths = result.stretches.measured, result.stretches.way_m
        known = np.isfinite(measured) & (lengths > 0.0)
        count = count_text(len(result.drives), "drive")
        if not known.any():
            return f"Nothing was measured on {count}."
        mean, way = float(np.average(measured[known], weights=lengths[known])), float(np.sum(lengths))
        return f"{count} measured over {metres(way)}: a ride cost of {mean:.3f} rad/m on average. No map was checked."
    over = f"{metres(agreement.way_m)} in {count_text(agreement.stretches, 'stretch', 'stretches')}"
    if agreement.stretches < FEW:
        return f"Too little was driven on the map to judge it: {over}. Drive at least {FEW} stretches of it."
    parts = [f"{check_verdict(result)}. Over {over} it {level_words(agreement)} in the median"]
    parts[0] += f", and half of the stretches are off by less than {percent(agreement.median_error)}."
    parts.append(f"{percent(agreement.inside)} of the drives' readings lie in its 80 % interval.")
    return " ".join(parts)


def check_verdict(result: CheckResult) -> str:
    """Return whether the map holds, in one sentence without its full stop; for at least ``FEW`` stretches."""
    agreement = result.agreement
    if agreement is None or not np.isfinite(agreement.median_ratio):
        return "The map cannot be judged"
    level = 1 / LEVEL <= agreement.median_ratio <= LEVEL
    allowed = "" if round(agreement.inside, 2) < INSIDE else " by no more than its interval allows"
    rank = agreement.spearman
    stretches = result.stretches
    known = stretches.measured[np.isfinite(stretches.c_r) & (stretches.measured > 0.0)]
    low, high = np.quantile(known, [0.1, 0.9]) if len(known) else (1.0, 1.0)
    if high < EVEN * low or not np.isfinite(rank):
        even = "the ground driven is too even to say whether the map ranks ground rightly"
        return f"The level of the map holds; {even}" if level else f"The map's level is off{allowed}; {even}"
    if round(rank, 2) >= RANKS:  # as it is shown
        return "The map holds" if level else f"The map ranks the ground rightly, but its level is off{allowed}"
    if round(rank, 2) >= ROUGHLY:
        return f"The map ranks the ground only roughly{'' if level else f', and its level is off{allowed}'}"
    return "The map does not rank this ground as the vehicle felt it"


def columns_words(drive: CheckedDrive) -> list[str]:
    """Return which columns a drive was read from, and the quantity where its name differs, for each file."""
    found: dict[str, list[str]] = {}
    for quantity, column in drive.columns.items():
        place, separator, name = column.rpartition(": ")
        said = name if name.startswith(quantity) else f"{name} as {quantity}"
        found.setdefault(place if separator else "the log", []).append(said)
    return [f"read from {place}: {', '.join(columns)}" for place, columns in found.items()]


def level_words(agreement: MapAgreement) -> str:
    """Return "reads 8 % low" for a median ratio of 0.92."""
    ratio = agreement.median_ratio
    if not np.isfinite(ratio):
        return "cannot be compared"
    if abs(ratio - 1.0) < 0.005:
        return "reads neither high nor low"
    if ratio > 2.0:
        return f"reads {ratio:.1f} times too high"
    return f"reads {percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"


def metres(length: float) -> str:
    """Return a length in m, or in km from 5 km on."""
    return f"{length:,.0f} m" if length < 5000.0 else f"{length / 1000:,.1f} km"


def percent(part: float) -> str:
    """Return a share in per cent without decimals; a dash if it is not known."""
    return f"{100 * part:.0f} %" if np.isfinite(part) else "\N{EN DASH}"


def sorted_reasons(result: CheckResult) -> list[tuple[str, float]]:
    """Return why parts of the ways do not count, and their length over all drives, m; the longest first."""
    total: dict[str, float] = {}
    for drive in result.drives:
        for reason, length in drive.left_out_m.items():
            total[reason] = total.get(reason, 0.0) + length
    return sorted(((reason, length) for reason, length in total.items() if length > 0.0), key=lambda item: -item[1])


def names_of(items: Sequence[str], most: int = 3) -> str:
    """Return names, the first few of them."""
    shown = ", ".join(items[:most])
    return shown if len(items) <= most else f"{shown} and {len(items) - most} more"


def drive_notes(result: CheckResult) -> list[str]:
    """Return from which columns each drive was read and what was guessed, a sentence each."""
    return [note for drive in result.drives for note in _named(result, drive, [*columns_words(drive), *drive.notes])]


def skipped_words(result: CheckResult) -> list[str]:
    """Return which drives are left out, and why, a sentence each."""
    return [f"{drive} is left out: {why}" for drive, why in result.skipped.items()]


def warnings_of(result: CheckResult) -> list[str]:
    """Return the warnings of the whole check and of each drive that counts, each once."""
    own = [text for drive in result.drives for text in _named(result, drive, drive.warnings)]
    return list(dict.fromkeys([*result.warnings, *own]))


def _named(result: CheckResult, drive: CheckedDrive, texts: Iterable[str]) -> list[str]:
    """Put the name of a drive before texts that do not say it, where there are several drives."""
    several, name = len(result.drives) > 1, drive.name
    return [f"{name}: {text}" if several and not text.startswith(name) else text for text in texts]
