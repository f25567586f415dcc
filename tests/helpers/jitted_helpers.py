"""Helpers of kernels, compiled by numba in this process, to be called from Python."""

from numba import njit

from bumpytiles import native


def jitted(function):
    """Return a helper, or the plain function of a kernel, that numba compiles when it is called."""
    for helper in native._helpers:
        native._register(helper)
    return njit(error_model="numpy", **native._helpers.get(function, {}))(function)
