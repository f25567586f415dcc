import sys
from pathlib import Path

# The generators are a package of their own, which the fuzzer uses too.
sys.path.append(str(Path(__file__).parent))
