"""sectors.parquet against the sectors it was made of."""

import numpy as np
import pyarrow.parquet as pq

from bumpymap.layers import open_table, scan_table as table, sector_rows
from bumpymap.layers.scan_table import COLUMNS


def write(path, *frames):
    with open_table(path) as sectors:
        for name, classed in frames:
            sectors.add_rows(sector_rows(name, classed))
    return pq.read_table(path)


def test_rows_are_the_sectors_of_all_frames_in_order(classed, nothing, tmp_path):
    found = write(tmp_path / "a.parquet", ("one", classed), ("empty", nothing[1]), ("two", classed))
    stack, count = classed.sectors, len(classed.class_id)
    assert found.column_names == [name for name, *_ in COLUMNS]
    assert found["frame"].to_pylist() == ["one"] * count + ["two"] * count
    same = ("zone", "ring", "sector", "traversable", "obstacle", "obstacle_height", "clearance")
    expected = {name: getattr(stack, name) for name in (*same, "variance", "residual", "coverage", "label")}
    expected |= {f"normal_{axis}": stack.normal[:, number] for number, axis in enumerate("xyz")}
    expected |= {"points": stack.count, "ground_points": stack.ground_count, "stripes": classed.stripes}
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name].to_numpy(), np.concatenate([values, values]), err_msg=name)
    class_id = [None if value == 255 else value for value in classed.class_id.tolist()]
    assert found["class"].to_pylist() == class_id + class_id
    assert [value is None for value in class_id] == (~stack.traversable).tolist()


def test_a_point_lies_between_the_bounds_of_its_row(scan, classed, tmp_path):
    found = write(tmp_path / "a.parquet", ("one", classed))
    place = classed.sectors.point_sector
    inside = place >= 0
    x, y = scan.points[inside, :2].T.astype(float)
    near, far, right, left = (found[name].to_numpy()[place[inside]] for name in ("near", "far", "right", "left"))
    assert (right >= 0.0).all()
    distance, turn = np.hypot(x, y), (np.arctan2(y, x) - right) % (2 * np.pi)
    assert ((distance >= near - 1e-4) & (distance <= far + 1e-4)).all()
    assert ((turn <= left - right + 1e-5) | (turn >= 2 * np.pi - 1e-5)).all()


def test_row_groups_keep_memory_bounded(classed, tmp_path, monkeypatch):
    monkeypatch.setattr(table, "ROW_GROUP", 100)
    path = tmp_path / "a.parquet"
    with open_table(path) as sectors:
        for number in range(9):
            sectors.add_rows(sector_rows(str(number), classed))
            assert sum(part.num_rows for part in sectors.waiting) < 100
    file = pq.ParquetFile(path)
    assert file.metadata.num_rows == 9 * len(classed.class_id)
    assert file.metadata.num_row_groups > 1
    assert file.read(["frame"])["frame"].to_pylist() == [str(n) for n in range(9) for _ in classed.class_id]
