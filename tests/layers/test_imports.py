import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.util import find_spec

import pytest

from bumpymap.layers import _imports

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


def test_what_is_hidden_is_hidden_from_one_thread_alone(monkeypatch):
    def elsewhere(name):
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(find_spec, name).result()

    def imported(name):
        assert elsewhere("pandas") is not None
        with pytest.raises(ModuleNotFoundError, match="pandas is not imported here"):
            find_spec("pandas")
        return import_module(name)

    for name in [name for name in sys.modules if name.split(".")[0] in {"pandas", "geopandas"}]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(_imports, "import_module", imported)
    _imports.import_without_pandas("json")
    assert not [finder for finder in sys.meta_path if isinstance(finder, _imports._Hidden)]
