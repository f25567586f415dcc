"""Faults that are known: name of the hostile file to what is wrong. A fault that is mended must leave this list."""

__all__ = ["KNOWN"]

KNOWN: dict[str, str] = {}
