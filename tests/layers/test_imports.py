import subprocess
import sys

CODE = """
import sys
from bumpymap.layers import import_without_pandas
import_without_pandas("pyogrio.raw")
import pyarrow, numpy
assert pyarrow.array(numpy.ones(3)).to_pylist() == [1.0, 1.0, 1.0]
assert "pyogrio.raw" in sys.modules
assert not {"pandas", "geopandas", "cloudpickle", "pyarrow._s3fs"} & set(sys.modules)
import pandas, cloudpickle
assert pyarrow.array([1, 2]).to_pandas().tolist() == [1, 2]
"""


def test_pandas_stays_out_and_can_still_be_imported():
    """In a process of its own: what a module found at its import stays so."""
    subprocess.run([sys.executable, "-c", CODE], check=True)
