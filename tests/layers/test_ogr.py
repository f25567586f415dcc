import sys

import pytest

from bumpymap.layers._ogr import announced


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An installed package that counts how often it is imported."""
    (tmp_path / "announceable").mkdir()
    (tmp_path / "announceable" / "__init__.py").write_text('import builtins\n__version__ = "3.1"\nvalue = 7\n')
    (tmp_path / "announceable" / "part.py").write_text("value = 8\n")
    info = tmp_path / "announceable-3.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: announceable\nVersion: 3.1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "announceable"
    for name in ("announceable", "announceable.part"):
        sys.modules.pop(name, None)


def test_a_package_tells_its_version_without_being_imported(package):
    with announced(package):
        import announceable

        assert announceable.__version__ == "3.1"
        assert "value" not in vars(announceable)
    assert package not in sys.modules
    assert announceable.value == 7  # who keeps it gets the package


def test_whoever_asks_for_more_gets_the_package(package):
    with announced(package):
        import announceable
        import announceable.part

        assert announceable.value == 7
        assert announceable.part.value == 8
    assert sys.modules[package].value == 7


def test_an_imported_package_stays(package):
    import announceable

    with announced(package):
        assert sys.modules[package] is announceable
    assert sys.modules[package] is announceable


def test_a_package_that_is_not_there_is_not_there():
    with announced("no_such_package"), pytest.raises(ModuleNotFoundError):
        import no_such_package  # noqa: F401
