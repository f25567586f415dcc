"""Read JSON of untrusted files: parse it, with a limit on the nesting depth, and hold it against a declared shape."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

__all__ = ["Each", "Nullable", "Number", "parse_json", "shape_fault"]

_DEEPEST = 50
"""Deeper than any file that bumpymap writes."""


def parse_json(text: str) -> Any:
    """Parse JSON text.

    Raises
    ------
    ValueError
        Not JSON, or nested more than 50 deep.
    """
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError(f"it is nested more than {_DEEPEST} deep") from None
    level = [value]
    for _ in range(_DEEPEST):
        level = [child for item in level for child in _children(item)]
        if not level:
            return value
    raise ValueError(f"it is nested more than {_DEEPEST} deep")


def _children(item: Any) -> list[Any]:
    if isinstance(item, dict):
        item = list(item.values())
    return [child for child in item if isinstance(child, dict | list)] if isinstance(item, list) else []


@dataclass(frozen=True, slots=True)
class Number:
    """A finite number, or a whole one, within bounds."""

    low: float = -1e300
    high: float = 1e300
    whole: bool = False

    def __str__(self) -> str:
        return f"a {'whole ' if self.whole else ''}number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class Nullable:
    """A value of a shape, or null."""

    shape: Any


@dataclass(frozen=True, slots=True)
class Each:
    """An object of any names, each with a value of a shape."""

    shape: Any = object


def shape_fault(value: Any, shape: Any, name: str = "it") -> str:
    """Return what is wrong with a value of JSON, or an empty string.

    Parameters
    ----------
    value
        From `parse_json`.
    shape
        ``{name: shape}`` for an object, which may hold more (a name that ends in ``?`` may be missing); ``[shape]`` for
        an array; ``(shape, shape)`` for one of so many; `Number`, `Nullable`, `Each`; else a type.
    name : str
        How the message calls the value.
    """
    if isinstance(shape, Nullable):
        return "" if value is None else shape_fault(value, shape.shape, name)
    if wanted := _unlike(value, shape):
        return f"{name} is {str(value)[:40]!r}; it must be {wanted}"
    within = "" if name == "it" else f"{name}."
    faults = (shape_fault(entry, each, f"{within}{key}") for key, entry, each in _inner(value, shape))
    return next(filter(None, faults), "")


def _unlike(value: Any, shape: Any) -> str:
    """Return what a value should be, or an empty string if it is that; what it holds is not looked at."""
    if isinstance(shape, Number):
        kinds = int if shape.whole else int | float
        good = isinstance(value, kinds) and not isinstance(value, bool) and shape.low <= value <= shape.high
        return "" if good else str(shape)
    if isinstance(shape, dict):
        names = [key for key in shape if not key.endswith("?")]
        good = isinstance(value, dict) and set(names) <= set(value)
        return "" if good else f"an object with {', '.join(names)}"
    if isinstance(shape, tuple):
        return "" if isinstance(value, list) and len(value) == len(shape) else f"an array of {len(shape)}"
    kind, wanted = _KINDS[Each if isinstance(shape, Each) else list if isinstance(shape, list) else shape]
    return "" if isinstance(value, kind) else wanted


def _inner(value: Any, shape: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, value and shape of what a value holds."""
    if isinstance(shape, Each):
        yield from ((key, entry, shape.shape) for key, entry in value.items())
    elif isinstance(shape, dict):
        named = {key.removesuffix("?"): each for key, each in shape.items()}
        yield from ((key, value[key], each) for key, each in named.items() if key in value)
    elif isinstance(shape, list | tuple):
        shapes = shape if isinstance(shape, tuple) else shape * len(value)
        yield from ((str(at), entry, each) for at, (entry, each) in enumerate(zip(value, shapes, strict=True)))


_KINDS: dict[Any, tuple[type, str]] = {
    Each: (dict, "an object"),
    list: (list, "an array"),
    str: (str, "text"),
    bool: (bool, "true or false"),
    object: (object, ""),
}
