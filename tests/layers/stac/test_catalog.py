"""catalog.json: valid, opened by pystac without a network, with every complete map and nothing else."""

import hashlib
import json
import shutil
import socket
from pathlib import Path

import pystac
import pytest
from stac_check import faults

from bumpymap.core import OutputError
from bumpymap.core.types import CostTable
from bumpymap.layers import write_catalog, write_products
from bumpymap.views import write_map_views


@pytest.fixture(scope="module")
def night(tmp_path_factory, make_field):
    root = tmp_path_factory.mktemp("night")
    for seed, name in enumerate(("a", "Grube Süd")):
        (root / name).mkdir()
        field = make_field(9, 7, seed=seed)
        manifest = {"survey": {"name": name, "checksum": None, "dates": None}}
        write_products(CostTable.of(field), root / name, views=write_map_views, local=False, manifest=manifest)
    (root / "failed").mkdir()
    shutil.copytree(root / "a", root / "half")
    (root / "half" / "run.json").unlink()
    shutil.copytree(root / "a", root / "before")
    (root / "before" / "item.json").unlink()
    write_catalog(root, ["a", "Grube Süd", "failed", "half", "before", "missing"], title="Night of May 3")
    return root


def catalog_of(folder):
    return json.loads((folder / "catalog.json").read_text(encoding="utf-8"))


def test_a_catalogue_is_valid_and_links_to_complete_maps(night):
    catalog = catalog_of(night)
    assert faults(catalog) == []
    assert (catalog["id"], catalog["title"]) == ("Night-of-May-3", "Night of May 3")
    assert [link["href"] for link in catalog["links"] if link["rel"] == "item"] == [
        "./a/item.json",
        "./Grube Süd/item.json",
    ]
    assert faults({**catalog, "links": [{"rel": "item"}]})


def test_pystac_opens_it_and_finds_every_file(night, monkeypatch):
    def refuse(*_):
        raise AssertionError("something asked for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    catalog = pystac.Catalog.from_file(str(night / "catalog.json"))
    items = list(catalog.get_items(recursive=True))
    assert [item.id for item in items] == ["a", "Grube-S-d"]
    for item in items:
        assert item.get_parent() is catalog
        assert item.get_root() is catalog
        checked = 0
        for name, asset in item.get_assets().items():
            content = open(asset.get_absolute_href(), "rb").read()  # noqa: PTH123, SIM115
            if "file:checksum" in asset.extra_fields:
                assert asset.extra_fields["file:checksum"] == f"1220{hashlib.sha256(content).hexdigest()}"
                checked += 1
            assert Path(asset.href).name == name
        assert checked >= 9
        assert item.common_metadata.start_datetime.year == 1970
        assert faults(item.to_dict(transform_hrefs=False)) == []


def test_names_that_a_link_cannot_hold_are_escaped(night, tmp_path):
    names = ["100% #2?", "b\udce9"]
    for name in names:
        shutil.copytree(night / "a", tmp_path / name)
    write_catalog(tmp_path, names, title="")
    hrefs = [link["href"] for link in catalog_of(tmp_path)["links"] if link["rel"] == "item"]
    assert hrefs == ["./100%25 %232%3F/item.json", "./b%E9/item.json"]


def test_no_link_or_folder_is_replaced(night, tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "catalog.json").symlink_to(tmp_path / "mine")
    with pytest.raises(OutputError, match=r"catalog\.json is a link or no file.*Remove it"):
        write_catalog(tmp_path, [], title="x")
    assert (tmp_path / "mine").read_text() == "mine"
    (tmp_path / "catalog.json").unlink()
    (tmp_path / "catalog.json").mkdir()
    with pytest.raises(OutputError, match="is a link or no file"):
        write_catalog(tmp_path, [], title="x")
