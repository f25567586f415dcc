"""Decode every field of every point with laspy and discard it: the lower bound for the time of ``bumpymap map``.

python tests/benchmarks/read_all.py FILE
"""

import sys

import laspy

with laspy.open(sys.argv[1], laz_backend=laspy.LazBackend.LazrsParallel) as reader:
    for _ in reader.chunk_iterator(1_000_000):
        pass
