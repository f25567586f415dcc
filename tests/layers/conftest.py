"""A made-up scan and its classes as fixtures."""

from classed_site import classed_fixture, nothing_fixture, scan_fixture  # noqa: F401 (found by pytest)
