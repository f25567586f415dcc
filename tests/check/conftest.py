import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def made_drives():
    """The module of drives in closed form."""
    spec = importlib.util.spec_from_file_location("made_drives", Path(__file__).with_name("made_drives.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules["made_drives"] = module
    spec.loader.exec_module(module)
    return module
