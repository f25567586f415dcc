"""Format profiles as Markdown: for each survey, the figures of all commands side by side."""

from collections.abc import Callable
from typing import Any

from _targets import table

__all__ = ["profile_tables"]

_LEAST = 0.005
"""Parts with a smaller share in all profiles are shown as one."""
_MISSING = {
    "samples": "perf is not installed or may not sample, so there are no shares of the processor time.",
    "files": "strace is not installed or may not trace, so there are no bytes by file.",
}
_NO_KERNEL = "perf may not sample the operating system here, see the setting kernel.perf_event_paranoid."
_OTHERS = "other libraries"


def profile_tables(results: dict[str, dict[str, Any]], cores: int) -> str:
    """Return the tables of all surveys.

    Parameters
    ----------
    results : title of a survey -> label of a command -> figures, as ``profile_map.py`` keeps them
    cores : cores that the runs could use
    """
    return "\n\n".join(_survey(title, labels, cores) for title, labels in results.items())


def _survey(title: str, labels: dict[str, Any], cores: int) -> str:
    parts = [f"**{title}.** Medians of {_rounds(labels)} runs; samples of as many other runs."]
    parts += [_times(labels, cores), _stages(labels)]
    for kind, make in (("samples", _shares), ("files", _files)):
        have = {label: figures for label, figures in labels.items() if figures[kind]}
        parts += [make(have)] if have else []
        parts += [f"{label}: {_MISSING[kind]}" for label in labels if label not in have]
        if kind == "samples":
            parts += [f"{label}: {_NO_KERNEL}" for label, each in have.items() if not _sees_kernel(each["samples"])]
    return "\n\n".join(part for part in parts if part)


def _sees_kernel(samples: dict[str, int]) -> bool:
    return any(part.startswith("operating system") for part in samples)


def _rounds(labels: dict[str, Any]) -> str:
    return " or ".join(dict.fromkeys(str(figures["rounds"]) for figures in labels.values()))


def _times(labels: dict[str, Any], cores: int) -> str:
    def waiting(timed: dict[str, float]) -> float:
        return timed["wall_s"] * cores - timed["cpu_s"]

    rows: list[tuple[str, Callable[[dict[str, float]], str]]] = [
        ("wall time [s]", lambda timed: f"{timed['wall_s']:.2f}"),
        ("user time [s]", lambda timed: f"{timed['user_s']:.2f}"),
        ("system time [s]", lambda timed: f"{timed['system_s']:.2f}"),
        ("of both, in child processes [s]", lambda timed: f"{timed['children_s']:.2f}"),
        (f"waiting: {cores} x wall time, less user and system time [s]", lambda timed: f"{waiting(timed):.2f}"),
        ("page faults, minor", lambda timed: f"{timed['minor_faults']:,.0f}"),
        ("page faults, major", lambda timed: f"{timed['major_faults']:,.0f}"),
        ("bytes of all read calls [MB]", lambda timed: f"{timed['bytes_read'] / 1e6:,.0f}"),
        ("bytes of all write calls [MB]", lambda timed: f"{timed['bytes_written'] / 1e6:,.0f}"),
        ("peak memory [GB]", lambda timed: f"{timed['peak_bytes'] / 1e9:.2f}"),
    ]
    body = [(name, *(show(figures["timed"]) for figures in labels.values())) for name, show in rows]
    return table(("whole command", *labels), body)


def _stages(labels: dict[str, Any]) -> str:
    names = dict.fromkeys(name for figures in labels.values() for name in figures["stages"])
    body = [(name, *(_seconds(figures["stages"].get(name)) for figures in labels.values())) for name in names]
    outside = (f["timed"]["wall_s"] - sum(f["stages"].values()) for f in labels.values())
    return table(("stage [s]", *labels), [*body, ("outside of all stages", *map(_seconds, outside))])


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _shares(labels: dict[str, Any]) -> str:
    shares = {}
    for label, figures in labels.items():
        total = sum(figures["samples"].values())
        shares[label] = {part: count / total for part, count in figures["samples"].items()}
    parts = dict.fromkeys(part for each in shares.values() for part in each)
    small = {part for part in parts if all(each.get(part, 0.0) < _LEAST for each in shares.values())}
    for each in shares.values():
        each[_OTHERS] = sum(each.pop(part, 0.0) for part in small)
    largest = {part: max(each.get(part, 0.0) for each in shares.values()) for part in parts if part not in small}
    order = [*sorted(largest, key=lambda part: -largest[part]), _OTHERS]
    body = []
    for part in order:
        cells = (
            f"{100 * each.get(part, 0.0):.1f} % ({each.get(part, 0.0) * labels[label]['timed']['cpu_s']:.2f} s)"
            for label, each in shares.items()
        )
        body.append((part, *cells))
    return table(("share of the samples (of user and system time)", *labels), body)


def _files(labels: dict[str, Any]) -> str:
    sums = {label: figures["files"] for label, figures in labels.items()}
    names = dict.fromkeys(name for each in sums.values() for name in each)
    body = []
    for name in names:
        cells = (
            " / ".join(f"{count / 1e6:,.1f}" for count in each[name]) if name in each else "" for each in sums.values()
        )
        body.append((name, *cells))
    size = next(iter(labels.values()))["survey_bytes"]
    ratio = (f"{sum(each['the survey'][:2]) / size:.2f}" for each in sums.values())
    body.append((f"read and mapped of the survey, relative to its {size / 1e6:,.1f} MB", *ratio))
    return table(("bytes read / mapped / written [MB]", *labels), body)
