import os
import sys
from pathlib import Path

from hypothesis import settings

# No test may depend on a clock; in CI the same examples are tried every time.
settings.register_profile("bumpymap", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("bumpymap")

sys.path.append(str(Path(__file__).parent / "helpers"))  # modules that several rooms' tests share
