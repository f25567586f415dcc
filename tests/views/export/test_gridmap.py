"""The bag, read back with rosbags, and its message placed by the rules of grid_map.

github.com/ANYbotics/grid_map: grid_map_core/src/GridMapMath.cpp (getPositionFromIndex: index (0, 0) is the corner at
+x, +y), grid_map_ros GridMapMsgHelpers.hpp (layout: dimension 0 is column_index, data column by column).
"""

import shutil
import sys
import warnings

import numpy as np
import pytest
import rasterio

from bumpymap.core import BadInputError, UsageError
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

pytest.importorskip("rosbags")


def read_bag(folder):
    """The one message, by the definition that the bag itself holds."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    with Reader(folder) as reader:
        (topic,) = reader.connections
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(topic.msgdef.data, topic.msgtype))
        ((_, time, raw),) = reader.messages()
        assert (topic.topic, topic.msgtype, time) == ("/grid_map", "grid_map_msgs/msg/GridMap", 0)
        return store.deserialize_cdr(raw, topic.msgtype)


def cells(message, name):
    """x, y and value of every cell."""
    array = message.data[message.layers.index(name)]
    outer, inner = array.layout.dim
    assert (outer.label, inner.label) == ("column_index", "row_index")
    rows, cols = inner.size, outer.size
    assert (outer.stride, inner.stride, array.layout.data_offset) == (rows * cols, rows, 0)
    info = message.info
    assert (rows, cols) == (round(info.length_x / info.resolution), round(info.length_y / info.resolution))
    assert (message.outer_start_index, message.inner_start_index) == (0, 0)
    matrix = np.asarray(array.data, np.float32).reshape(cols, rows).T
    first = info.pose.position.x + 0.5 * (info.length_x - info.resolution)
    top = info.pose.position.y + 0.5 * (info.length_y - info.resolution)
    row, col = np.indices(matrix.shape)
    return (first - info.resolution * row).ravel(), (top - info.resolution * col).ravel(), matrix.ravel()


def sampled(folder, name, band, x, y, datum):
    with rasterio.open(folder / name) as file:
        places = zip((x + datum["x"]).tolist(), (y + datum["y"]).tolist(), strict=True)
        index = file.descriptions.index(band) + 1 if band else 1
        return np.array([value[0] for value in file.sample(places, indexes=index)])


@pytest.mark.parametrize(
    ("resolution", "around"), [("tile", None), ("pixel", (110_010.0 * 3 + 1.0, 680_008.0 * 3 + 2.0))]
)
def test_every_cell_has_the_value_of_the_layers_bit_for_bit(route_map, folder, tmp_path, around, resolution):
    crop = {} if around is None else {"around": around, "radius": 5.0}
    out = tmp_path / "out"
    record = export_map(route_map, out, ExportSettings(to="gridmap", resolution=resolution, **crop)).record
    message = read_bag(out)
    assert message.layers == ["elevation", "c_r", "p_fail", "class", "obstacle"]
    assert message.header.frame_id == "map"
    assert message.info.resolution == pytest.approx(3.0 if resolution == "tile" else 0.2)
    pick = np.random.default_rng(0).permutation(len(cells(message, "c_r")[0]))[:2000]
    for name in ("c_r", "p_fail"):
        x, y, value = (part[pick] for part in cells(message, name))
        expected = sampled(folder, "rasters/roughness.tif", name, x, y, record["datum"])
        np.testing.assert_array_equal(
            value.view(np.uint32)[~np.isnan(expected)], expected.view(np.uint32)[~np.isnan(expected)]
        )
        np.testing.assert_array_equal(np.isnan(value), np.isnan(expected))
    x, y, value = (part[pick] for part in cells(message, "class"))
    classes = sampled(folder, "rasters/class.tif", None, x, y, record["datum"])
    np.testing.assert_array_equal(np.nan_to_num(value, nan=255.0), classes)
    x, y, value = (part[pick] for part in cells(message, "obstacle"))
    if resolution == "tile":
        expected = sampled(folder, "rasters/roughness.tif", "obstacle", x, y, record["datum"])
        np.testing.assert_array_equal(value, expected)
        window, elevation = route_map.window, message.data[message.layers.index("elevation")].data
        heights = route_map.heights(window).reshape(window.rows, 15, window.cols, 15).astype(float)
        with warnings.catch_warnings(action="ignore"):  # tiles without a height
            mean = np.nanmean(heights, axis=(1, 3))[:, ::-1]
        np.testing.assert_allclose(elevation, mean.ravel(), rtol=1e-6)
        return
    state = sampled(folder, "rasters/obstacle.tif", None, x, y, record["datum"])
    np.testing.assert_array_equal(np.nan_to_num(value, nan=3.0), np.minimum(state, 3))
    x, y, value = (part[pick] for part in cells(message, "elevation"))
    np.testing.assert_array_equal(value, sampled(folder, "rasters/heightmap.tif", None, x, y, record["datum"]))


def test_classes_that_were_cut_off(easy_folder, tmp_path):
    shutil.copytree(easy_folder, tmp_path / "site")
    site = open_map(tmp_path / "site")
    whole = (tmp_path / "site" / "rasters/class.tif").read_bytes()
    (tmp_path / "site" / "rasters/class.tif").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BadInputError, match=r"class\.tif is cut off"):
        export_map(site, tmp_path / "out", ExportSettings(to="gridmap"))
    (tmp_path / "site" / "rasters/class.tif").unlink()
    with pytest.raises(BadInputError, match=r"class\.tif"):
        export_map(site, tmp_path / "out", ExportSettings(to="gridmap"))
    assert not (tmp_path / "out").exists()


def test_without_rosbags_the_message_says_what_to_install(route_map, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(UsageError, match=r"bumpymap\[ros\]"):
        export_map(route_map, tmp_path / "out", ExportSettings(to="gridmap"))
    assert not (tmp_path / "out").exists()
