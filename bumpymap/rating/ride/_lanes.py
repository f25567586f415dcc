"""Numbers of eight patches side by side.

A processor computes eight numbers as fast as one, but only where nothing depends on their order. The sums over one
patch keep their order, and so their bits; eight patches know nothing of each other. Written out for eight, compiled
code holds them in one register.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from bumpytiles import helper

LANES = 8
"""Patches side by side."""
Lanes = tuple[Any, Any, Any, Any, Any, Any, Any, Any]
"""A number of each of them."""


@helper
def same(value: Any) -> Lanes:
    """One number for all lanes."""
    return value, value, value, value, value, value, value, value


@helper
def load(values: Any, first: int) -> Lanes:
    """Eight numbers of an array, from a place on."""
    return (
        values[first],
        values[first + 1],
        values[first + 2],
        values[first + 3],
        values[first + 4],
        values[first + 5],
        values[first + 6],
        values[first + 7],
    )


@helper
def store(lanes: Lanes, out: Any, first: int) -> None:
    """Write eight numbers to an array, from a place on."""
    for lane, value in enumerate(lanes):
        out[first + lane] = value


@helper
def each2(function: Callable[..., Any], a: Lanes, b: Lanes) -> Lanes:
    """Apply a helper that takes two numbers to each lane."""
    return (
        function(a[0], b[0]),
        function(a[1], b[1]),
        function(a[2], b[2]),
        function(a[3], b[3]),
        function(a[4], b[4]),
        function(a[5], b[5]),
        function(a[6], b[6]),
        function(a[7], b[7]),
    )


@helper
def each3(function: Callable[..., Any], a: Lanes, b: Lanes, c: Lanes) -> Lanes:
    """Apply a helper that takes three numbers to each lane."""
    return (
        function(a[0], b[0], c[0]),
        function(a[1], b[1], c[1]),
        function(a[2], b[2], c[2]),
        function(a[3], b[3], c[3]),
        function(a[4], b[4], c[4]),
        function(a[5], b[5], c[5]),
        function(a[6], b[6], c[6]),
        function(a[7], b[7], c[7]),
    )


@helper
def each4(function: Callable[..., Any], a: Lanes, b: Lanes, c: Lanes, d: Lanes) -> Lanes:
    """Apply a helper that takes four numbers to each lane."""
    return (
        function(a[0], b[0], c[0], d[0]),
        function(a[1], b[1], c[1], d[1]),
        function(a[2], b[2], c[2], d[2]),
        function(a[3], b[3], c[3], d[3]),
        function(a[4], b[4], c[4], d[4]),
        function(a[5], b[5], c[5], d[5]),
        function(a[6], b[6], c[6], d[6]),
        function(a[7], b[7], c[7], d[7]),
    )


@helper
def _sum(a: Any, b: Any) -> Any:
    return a + b


@helper
def _with_part(total: Any, weight: Any, value: Any) -> Any:
    return total + weight * value


@helper
def _with_size(total: Any, value: Any) -> Any:
    return total + abs(value)


@helper
def _with_square(total: Any, value: Any) -> Any:
    wide = np.float64(value)
    return total + wide * wide


@helper
def add(total: Lanes, more: Lanes) -> Lanes:
    """Add numbers."""
    return each2(_sum, total, more)


@helper
def add_part(total: Lanes, weight: Any, values: Lanes) -> Lanes:
    """Add numbers times a weight."""
    return each3(_with_part, total, same(weight), values)


@helper
def add_size(total: Lanes, values: Lanes) -> Lanes:
    """Add absolute values."""
    return each2(_with_size, total, values)


@helper
def add_square(total: Lanes, values: Lanes) -> Lanes:
    """Add squares, in double precision."""
    return each2(_with_square, total, values)
