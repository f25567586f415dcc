"""Make bumpymap/kernels and tiles/bumpytiles/kernels, the machine code of all kernels: python docs/models/kernels.py.

It takes two minutes. On any x86-64 processor since 2013 the bytes are the same, with Python 3.11 and the versions of
.ci/constraints.txt. A folder may be named to write to instead.
"""

import os
import shutil
import sys
from pathlib import Path

from bumpytiles.native import package_kernels

os.environ["NUMBA_OPT"] = "0"  # helpers are optimised once, as parts of a kernel


def main(folder: str | None = None) -> None:
    """Write a file a kernel."""
    for package in ("bumpymap", "bumpytiles"):
        kernels = package_kernels(package)
        out = Path(folder, package) if folder else kernels[0].shipped.parent
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        for kernel in kernels:
            code = kernel.compile()
            (out / kernel.shipped.name).write_bytes(kernel.head(code) + code)


if __name__ == "__main__":
    main(*sys.argv[1:])
