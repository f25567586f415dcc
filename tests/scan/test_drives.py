"""Frames of a drive: what a merge keeps and drops, poses that cannot be right, and motion between the frames."""

import json
import re
from dataclasses import replace

import laspy
import numpy as np
import pytest
from ply_files import write_ply
from scipy.spatial.transform import Rotation

from bumpymap.core import BadInputError
from bumpymap.layers import open_accumulated
from bumpymap.scan.align import MOST_METRES, DriveHeights, GroundHeights, align_frames
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.merge import MOST_GROUND, MOST_OTHERS, open_merge
from bumpymap.scan.pipeline import scan_frames

CAMERA = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
PARKED, TRUCK = (12.07, 8.57, 0.0, 4.0, 1.8, 1.5), (22.0, -1.5, 0.6, 6.0, 2.4, 3.0)
"""Boxes: middle x and y, lower edge, length, width, upper edge, m."""
WALLS = [(x, y, 0.0, 3.0, 0.5, 2.5) for x, y in ((2.0, 11.0), (9.0, -8.0), (17.0, 12.0), (26.0, -9.0), (35.0, 10.0))]
FRAMES = 12


def seen(pose, boxes):
    """Points (n, 3) of a sensor of 48 lines on level ground among boxes, in its frame, and which are ground."""
    up, around = np.radians(np.linspace(-28.0, 12.0, 48))[:, None], np.linspace(-np.pi, np.pi, 720, endpoint=False)
    rays = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), axis=-1)
    rays = rays.reshape(-1, 3)
    way, eye = rays @ pose[:3, :3].T, pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.where(way[:, 2] < 0.0, -eye[2] / way[:, 2], np.inf)
        ground = np.isfinite(away)
        for x, y, low, long, wide, high in boxes:
            near = (np.array([x - long / 2, y - wide / 2, low]) - eye) / way
            far = (np.array([x + long / 2, y + wide / 2, high]) - eye) / way
            enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
            hit = (enter > 0.0) & (enter < leave) & (enter < away)
            away, ground = np.where(hit, enter, away), ground & ~hit
    kept = away < 60.0
    return (rays * away[:, None])[kept].astype(np.float32), ground[kept]


def way_along(count=FRAMES, step=3.0):
    """Poses along a bend."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    turn = 0.3 * np.sin(np.arange(count) / 4.0 + 0.5)
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(turn)
    poses[:, 1, 0] = np.sin(turn)
    poses[:, 0, 1] = -np.sin(turn)
    poses[:, :2, 3] = np.cumsum(step * np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0) - [3.0, 0.0]
    poses[:, 2, 3] = 1.5
    return poses


def car(number):
    """The box of a car that comes towards the sensor."""
    return (38.0 - 4.0 * number, 2.0 - 0.1 * number, 0.2, 4.0, 1.8, 1.5)


@pytest.fixture(name="frames", scope="module")
def frames_fixture():
    """Frames of a drive past standing objects and a moving one."""
    return [seen(pose, [PARKED, TRUCK, *WALLS, car(number)]) for number, pose in enumerate(way_along())]


def merged(folder, frames, poses, is_ground=None):
    """Merge frames; return the points, which are ground, and the record."""
    folder.mkdir(exist_ok=True)
    with open_merge(folder, poses[0]) as drive:
        for number, ((points, ground), pose) in enumerate(zip(frames, poses, strict=True)):
            own = ground if is_ground is None else is_ground(number, points)
            drive.add_points(drive.place_points(str(number), points, pose, own))
        with open_accumulated(folder / "a.laz", poses[0], None) as survey:
            drive.write(survey)
    las = laspy.read(folder / "a.laz")
    return np.asarray(las.xyz), np.asarray(las.classification) == 2, drive.record()


def in_box(xyz, box, margin=0.05):
    x, y, low, long, wide, high = box
    inside = np.abs(xyz - [x, y, 0.5 * (low + high)]) <= np.array([long, wide, high - low]) / 2 + margin
    return inside.all(axis=1)


@pytest.fixture(name="drive", scope="module")
def drive_fixture(frames, tmp_path_factory):
    return merged(tmp_path_factory.mktemp("merge") / "out", frames, way_along())


def test_what_moved_is_gone_and_what_stands_has_stayed(frames, drive):
    xyz, ground, record = drive
    poses = way_along()
    world = [points @ pose[:3, :3].T + pose[:3, 3] for (points, _), pose in zip(frames, poses, strict=True)]
    moving = sum(int(in_box(points, car(number)).sum()) for number, points in enumerate(world))
    assert moving > 1000
    of_cars = np.any([in_box(xyz, car(number)) for number in range(FRAMES)], axis=0) & (xyz[:, 2] > 0.3)
    elsewhere = np.any([in_box(xyz, box, 0.3) for box in (PARKED, TRUCK, *WALLS)], axis=0)
    assert (of_cars & ~elsewhere & ~ground).sum() < 0.02 * moving
    for box in (PARKED, *WALLS):
        voxels = {
            tuple(v) for points in world for v in np.floor(points[in_box(points, box)] / 0.2).astype(int).tolist()
        }
        left = {tuple(v) for v in np.floor(xyz[in_box(xyz, box)] / 0.2).astype(int).tolist()}
        assert len(voxels & left) > 0.97 * len(voxels) > 50
    assert record["seen"] == sum(len(points) for points in world)
    assert (record["points"], record["ground"]) == (len(xyz), ground.sum())
    assert (record["moving"] > 0, record["poses"]["misfits"]) == (True, [])
    # Density is even.
    whole = np.round(1000.0 * xyz).astype(np.int64)
    pixels = np.unique(whole[ground, :2] // 200, axis=0, return_counts=True)[1]
    assert pixels.max() == MOST_GROUND
    assert np.unique(whole[~ground] // 200, axis=0, return_counts=True)[1].max() <= MOST_OTHERS
    assert np.abs(xyz[ground, 2]).max() < 0.01


def test_ground_below_a_truck_is_not_ground_to_drive_on(frames, drive):
    xyz, ground, _ = drive
    x, y, _, long, wide, _ = TRUCK
    below = (x, y, -0.1, long - 0.9, wide - 0.9, 0.0)
    world = [points @ pose[:3, :3].T + pose[:3, 3] for (points, _), pose in zip(frames, way_along(), strict=True)]
    assert in_box(np.concatenate(world), below).sum() > 100
    assert not (in_box(xyz, below) & ground).any()


def test_where_blocks_begin_makes_no_difference(frames, drive, tmp_path):
    poses, by = way_along(), (-100_005.0, 3_999_987.0, 4.0)
    poses[:, :3, 3] += by
    xyz, ground, record = merged(tmp_path / "out", frames, poses)
    rows = [np.column_stack([np.round(1000.0 * p).astype(np.int64), g]) for p, g in ((xyz - by, ground), drive[:2])]
    first, second = (each[np.lexsort(each.T)] for each in rows)
    assert len(first) == len(second)
    assert (np.abs(first - second).max(axis=1) > 0).mean() < 1e-3  # a half millimetre may round to either side
    assert record["moving"] == pytest.approx(drive[2]["moving"], abs=5)


def test_what_most_frames_do_not_take_for_ground_is_no_ground(frames, tmp_path):
    def roofs(number, points):
        high = way_along()[number, 2, 3] + points[:, 2] > 0.3
        return frames[number][1] | (high & (number in {2, 7}))

    xyz, ground, _ = merged(tmp_path / "out", frames, way_along(), roofs)
    high = xyz[:, 2] > 0.3
    assert (high & ground).sum() < 0.1 * high.sum()


def test_poses_with_errors_give_level_ground_again(frames, tmp_path):
    rng = np.random.default_rng(3)
    poses = way_along()
    poses[:, 2, 3] += rng.normal(0.0, 0.05, FRAMES)
    for pose in poses:
        roll, pitch = rng.normal(0.0, np.radians(0.3), 2)
        pose[:3, :3] = np.array([[1, 0, pitch], [0, 1, -roll], [-pitch, roll, 1]]) @ pose[:3, :3]
    xyz, ground, record = merged(tmp_path / "out", frames, poses)
    agree = record["poses"]
    assert 0.02 < agree["before_m"] < 0.2
    assert agree["after_m"] < 0.005
    assert 0.03 < agree["largest_shift_m"] < 0.3
    near = ground & (np.abs(xyz[:, 0] - 15.0) < 10.0) & (np.abs(xyz[:, 1] - 2.0) < 3.0)
    plane = np.column_stack([xyz[near, :2], np.ones(near.sum())])
    rest = xyz[near, 2] - plane @ np.linalg.lstsq(plane, xyz[near, 2], rcond=None)[0]
    assert rest.std() < 0.01


def test_poses_with_errors_in_plan_are_moved_to_where_things_stand(frames, drive, tmp_path):
    rng, given = np.random.default_rng(3), way_along()
    given[:, :2, 3] += rng.normal(0.0, 0.15, (FRAMES, 2))
    given[:, :3, :3] = (
        Rotation.from_euler("z", rng.normal(0.0, 0.4, (FRAMES, 1)), degrees=True).as_matrix() @ given[:, :3, :3]
    )
    kept = given.copy()
    xyz, _, record = merged(tmp_path / "out", frames, given)
    agree = record["poses"]
    np.testing.assert_array_equal(given, kept)
    assert (agree["beside_after_m"] < 0.01, agree["beside_before_m"] > 0.1) == (True, True)
    assert 0.1 < agree["largest_move_m"] < 1.0
    # Seen from above, each wall has the area that it has with true poses; all together may have moved.
    areas = [len(np.unique(np.floor(p[p[:, 2] > 0.5, :2] / 0.1), axis=0)) for p in (xyz, drive[0])]
    assert areas[0] < 1.15 * areas[1]
    assert record["moving"] == pytest.approx(drive[2]["moving"], rel=0.1)
    assert drive[2]["poses"]["largest_move_m"] == 0.0  # good poses stay as they are


def test_frames_between_bare_walls_are_moved_across_and_not_along(tmp_path):
    true = np.tile(np.eye(4), (8, 1, 1))
    true[:, 0, 3], true[:, 2, 3] = 2.0 * np.arange(8), 1.5
    frames, rng = (
        [seen(pose, [(7.0, y, 0.0, 90.0, 0.4, 3.0) for y in (4.0, -4.0)]) for pose in true],
        np.random.default_rng(1),
    )
    given, off = true.copy(), rng.normal(0.0, 0.2, (8, 2))
    given[:, :2, 3] += off
    with open_merge(tmp_path, given[0]) as drive:
        for number, (points, ground) in enumerate(frames):
            noisy = points + rng.normal(0.0, 0.005, points.shape).astype(np.float32)
            drive.add_points(drive.place_points(str(number), noisy, given[number], ground))
        with open_accumulated(tmp_path / "a.laz", given[0], None) as survey:
            drive.write(survey)
        moved = drive.poses[:, :2, 3] - given[:, :2, 3]
    assert np.abs(moved[:, 0]).max() < 0.02
    assert np.ptp(moved[:, 1] + off[:, 1]) < 0.02 < np.ptp(off[:, 1])


@pytest.mark.parametrize(("seed", "most"), [(0, 1 << 30), (1, 1 << 30), (0, 4_000)])
def test_corrections_are_those_that_were_put_in(seed, most):
    """The frames agree with each other; what they have in common cannot be known."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-10.0, 10.0, 0.5), np.arange(-10.0, 10.0, 0.5)))
    surface = rng.normal(0.0, 0.2, (60, 40))
    drive, wrong = DriveHeights(most), np.column_stack([rng.normal(0, 0.05, 8), rng.normal(0, 0.005, (8, 2))])
    for number, (up, east, north) in enumerate(wrong):
        column, row = np.meshgrid(np.arange(40) + 2 * number, np.arange(40))
        z = surface[column.ravel() % 60, row.ravel()] + rng.normal(0, 0.003, x.size) - (up + east * x + north * y)
        square = (column.ravel() << 31) + row.ravel()
        order = np.argsort(square)
        drive.add(GroundHeights(square[order], *(v[order].astype(np.float32) for v in (x, y, z - 1.0)), 1.0))
    kept = [len(frame.square) for frame in drive.frames]
    assert most / 4 < sum(kept) <= most or kept == [1_600] * 8
    found = align_frames(drive.frames)
    assert found.before_m > 0.02
    assert found.after_m == pytest.approx(0.003, abs=0.001)
    off = found.shift - wrong
    assert np.ptp(off[:, 1:], axis=0).max() < 3e-4
    # A tilt that all frames have in common lifts one against the next, which stands 1 m on.
    steps = np.diff(off[:, 0]) - off[1:, 1]
    assert np.abs(steps).max() < 3e-3


def test_corrections_are_bounded_and_frames_apart_have_none():
    x, y = (axis.ravel().astype(np.float32) for axis in np.meshgrid(np.arange(20.0), np.arange(20.0)))
    square = np.arange(400)
    frames = [GroundHeights(square + 1000 * (n == 2), x, y, 0 * x, 5.0 * n) for n in range(3)]
    found = align_frames(frames)
    assert np.abs(found.shift[:, 0]).max() == MOST_METRES
    np.testing.assert_array_equal(found.shift[2], 0.0)
    alone = align_frames(frames[2:])
    assert (alone.squares, np.isnan(alone.before_m)) == (0, True)
    assert alone.record()["before_m"] is None


def off(by=(0.0, 0.0, 0.0), axis="z", degrees=0.0):
    """Poses that are moved in the world, then turned about an axis of the sensor; by the same or each."""
    poses = way_along()
    poses[:, :3, 3] += by
    poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return poses


WAY, FLIP, LATER = way_along(), np.diag([1.0, -1.0, 1.0, 1.0]), np.arange(FRAMES)[:, None] >= 6
PLACE, YAW, NOISE = WAY[:, :3, 3], np.arctan2(WAY[:, 1, 0], WAY[:, 0, 0]), np.random.default_rng(5)
FAULTS = {
    "jump aside": (True, "6 against 5: objects stand 1.5 m beside", off(LATER * [0.0, 1.5, 0.0])),
    "jump up": (False, "6 against .: the same ground is 0.50 m higher", off(LATER * [0.0, 0.0, 0.5])),
    "too long": (False, "as if all ways were 1.10 times as long", off(PLACE * [0.1, 0.1, 0.0])),
    "too short": (False, "as if all ways were 0.90 times as long", off(PLACE * [-0.1, -0.1, 0.0])),
    "leaning": (True, "as if the LiDAR leaned by 4 degrees", off(axis="y", degrees=4.0)),
    "turning": (False, "objects stand turned by 2 degrees", off(degrees=np.arange(FRAMES)[:, None])),
    "degrees": (True, "see through", off(degrees=np.degrees(np.degrees(YAW) - YAW)[:, None])),
    "a frame late": (True, "1 against 0: ", WAY[[0, *range(FRAMES - 1)]]),
    "mirrored": (True, "do not fit", FLIP @ WAY @ FLIP),
    "noisy": (False, "1. of 12 frames do not fit", off(NOISE.normal(0.0, 0.3, (FRAMES, 3)))),
    "x for y": (True, "do not fit", off(PLACE[:, [1, 0, 2]] - PLACE)),
    "exchanged": (True, "5 against 4: ", WAY[[0, 1, 2, 3, 4, 6, 5, 7, 8, 9, 10, 11]]),
    "repeated": (True, "6 against 5: it holds the same points", WAY),
    "inverted": (True, "see through", np.linalg.inv(WAY)),
    "of a camera": (True, "same ground differs", CAMERA @ WAY @ np.linalg.inv(CAMERA)),
    "far apart": (True, "so far apart", way_along(step=300.0)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_poses_are_named_with_what_contradicts_them(frames, tmp_path, caplog, fault):
    refused, words, poses = FAULTS[fault]
    own = [frames[5 if fault == "repeated" and number == 6 else number] for number in range(FRAMES)]
    if refused:
        with pytest.raises(BadInputError, match=f"according to the poses, .*{words}.*`trust_poses=True`"):
            merged(tmp_path / "out", own, poses)
    else:
        assert merged(tmp_path / "out", own, poses)[2]["poses"]["misfits"]
        assert re.search(words, caplog.text)


START = 1_700_000_000.0
SPEED_MPS, TURN_RADPS = 9.0, 1.0
POSTS = np.random.default_rng(1).uniform(-20.0, 20.0, (40, 2))


def motion(times):
    """Rotations and places of a LiDAR 1.5 m above the ground, on a circle."""
    angle = TURN_RADPS * (np.asarray(times) - START)
    radius = SPEED_MPS / TURN_RADPS
    places = np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), np.full(len(angle), 1.5)])
    return Rotation.from_euler("z", angle[:, None]), places


def sweep(time, seed):
    """World points of posts and flat ground that one turn of 0.1 s sees, and the time of each after ``time``."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-25.0, 25.0, (6_000, 2)), np.zeros(6_000)])
    posts = np.column_stack([np.repeat(POSTS, 100, axis=0), np.tile(np.linspace(0.1, 2.0, 100), len(POSTS))])
    world = np.concatenate([ground, posts])
    _, place = motion([time])
    azimuth = np.arctan2(*(world - place)[:, 1::-1].T)
    offset = (azimuth + np.pi) * 0.1 / (2 * np.pi)
    order = np.argsort(offset)
    return world[order], offset[order]


@pytest.fixture(name="driven", scope="module")
def driven_fixture(tmp_path_factory):
    """Five frames with the time of each point in nanoseconds, and poses at 50 Hz."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "frames").mkdir()
    for number in range(5):
        time = START + 0.1 * number
        world, offset = sweep(time, number)
        turns, places = motion(time + offset)
        rows = np.zeros(len(world), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
        for axis, values in zip("xyz", turns.inv().apply(world - places).T, strict=True):
            rows[axis] = values
        rows["t"] = np.rint(offset * 1e9)
        write_ply(folder / "frames" / f"{time:.3f}.ply", rows)
    times = START + np.arange(-5, 40) / 50.0
    turns, places = motion(times)
    np.savetxt(folder / "tum.txt", np.column_stack([times, places, turns.as_quat()]), fmt="%.9f")
    return folder


def settings(driven, out, **more):
    how = {"poses": driven / "tum.txt", "method": "filter", "products": ("table",)}
    return ScanConfig((driven / "frames",), out, **how | more)


def off_posts(out):
    """Distance of the points above the ground to the nearest post, m."""
    points = laspy.read(out / "gathered.laz").xyz
    high = points[points[:, 2] > 0.3, :2]
    return np.linalg.norm(high[:, None] - POSTS[None], axis=2).min(axis=1)


def test_a_drive_is_deskewed_by_the_poses_between_its_frames(driven, tmp_path):
    config = settings(driven, tmp_path / "out")
    scan_frames(config)
    assert off_posts(config.out).max() < 0.01
    raw = settings(driven, tmp_path / "raw", deskew=False)
    scan_frames(raw)
    assert off_posts(raw.out).max() > 0.5
    assert not json.loads((raw.out / "scan.json").read_text(encoding="utf-8"))["poses"]["deskew"]


def test_wrong_poses_leave_nothing_in_the_way_of_right_ones(driven, tmp_path):
    """The frames of a refused run are of no use: with the same poses it would be refused again."""
    table = np.loadtxt(driven / "tum.txt")
    right = table[:, 3].copy()
    table[:, 3] += 7.0 * (table[:, 0] - START)
    np.savetxt(tmp_path / "tum.txt", table, fmt="%.9f")
    config = settings(driven, tmp_path / "out", poses=tmp_path / "tum.txt", deskew=False)
    with pytest.raises(BadInputError, match="height of the same ground differs") as refused:
        scan_frames(config)
    assert not hasattr(refused.value, "__notes__")
    assert not config.out.exists()
    trusted = scan_frames(replace(config, out=tmp_path / "trusted", trust_poses=True))
    assert trusted.merged["poses"]["misfits"]
    table[:, 3] = right
    np.savetxt(tmp_path / "tum.txt", table, fmt="%.9f")
    assert not scan_frames(config).already_done
