"""Every file but surveys that a user gives, and folders of layers that others made: valid ones, and who reads them.

A case is a folder that stays as it is, one file of it that is damaged, and a call that reads it. Damaged layers are
listed in run.json anew, with their checksum, as somebody would who means harm.
"""

import hashlib
import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mutate import Start

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

__all__ = ["Case", "UnreadError", "make_cases", "plant_traps"]

AREA = [(480_010.0, 2_136_005.0), (480_020.0, 2_136_005.0), (480_020.0, 2_136_020.0), (480_010.0, 2_136_005.0)]


class UnreadError(Exception):
    """A command ended with one message."""

    def __init__(self, code: object) -> None:
        if code not in {2, 3}:
            raise AssertionError(f"a command ended with {code!r}")
        super().__init__(code)


@dataclass(frozen=True, slots=True)
class Case:
    """A file that is damaged, and who reads it."""

    start: Start
    folder: Path | None
    """What lies around it; None: nothing."""
    name: str
    """Of the file in its folder."""
    call: object
    """Called with the folder (or the file, where there is no folder) and a folder to write to."""
    writes: bool = False
    """Whether the call writes to the folder itself."""

    def place(self, data: bytes, scratch: Path) -> Path:
        """Put the damaged file in its place; return the folder."""
        place = scratch / "given"
        shutil.copytree(self.folder, place) if self.folder else place.mkdir()
        (place / self.name).write_bytes(data)
        if self.folder:
            _list_anew(place, self.name)
        return place

    def run(self, scratch: Path) -> None:
        """Read it."""
        place = scratch / "given"
        self.call(place if self.folder else place / self.name, scratch / "out")


def _list_anew(place, name):
    for folder in {(place / name).parent, place}:
        for manifest in ("run.json", "change.json"):
            path = folder / manifest
            if path.name != Path(name).name and path.is_file():
                record = json.loads(path.read_text())
                for entry in record["files"]:
                    data = (folder / entry["path"]).read_bytes() if (folder / entry["path"]).is_file() else b""
                    entry |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
                path.write_text(json.dumps(record))


MAGIC = (b"", b"fgb\3", b"fgb\3fgb\1", b"II*\0", b"SQLite format 3\0", b"PAR1", b"\0\0\x27\x0a")
"""Instructions are for GDAL, which may look for them after the first bytes of another format."""


def plant_traps(folder: Path, url: str) -> list[bytes]:
    """Plant a file that nobody may open, and a pipe: who opens it hangs. Return what leads there and to a URL."""
    pipe, secret = folder / "pipe.tif", folder / "secret.tif"
    os.mkfifo(pipe)
    secret.write_bytes(b"II*\0")
    vrt = (
        '<VRTDataset rasterXSize="12" rasterYSize="10"><GeoTransform>480000,3,0,2136030,0,-3</GeoTransform>'
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="0">{}'
        "</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    ogr = '<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>{}</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>'
    aims = (str(pipe), str(secret), f"/vsicurl/{url}/a.tif", f"{url}/a.geojson")
    link = json.dumps(
        {"type": "FeatureCollection", "features": [], "crs": {"type": "link", "properties": {"href": url}}}
    )
    made = [magic + form.format(aim).encode() for form in (vrt, ogr) for aim in aims for magic in MAGIC]
    return [*made, *[link.encode()] * 5, b"\0", b"", *(aim.encode() for aim in aims), b"../../outside", b"[" * 5000]


def make_cases(folder: Path) -> list[Case]:
    """Make valid files and folders, and say who reads each."""
    return [*_layers(folder), *_vectors(folder), *_logs(folder), *_scans(folder), *_settings(folder)]


def _command(*words):
    """Return a call of the command line: {} is what is given, {out} where it may write."""

    def call(place, out):
        from bumpymap.cli import main

        try:
            main([word.format(place, out=out) for word in words])
        except SystemExit as end:
            if end.code not in {0, 4}:
                raise UnreadError(end.code) from None

    call.__name__ = words[0]
    return call


def _of(read):
    """Return a call that reads, and writes nothing."""

    def call(path, out):
        del out
        read(path)

    call.__name__ = read.__name__.strip("_<>")
    return call


def _case(path, call, folder=None, label="", *, writes=False):
    data, name = path.read_bytes(), path.name if folder is None else str(path.relative_to(folder))
    text = path.suffix in {".json", ".geojson", ".csv", ".toml", ".gpx", ".txt", ".vrt", ".yaml"}
    start = Start(f"{label or getattr(call, '__name__', 'read')}:{name}", data, (), len(data) if text else 0)
    return Case(start, folder, name, call, writes)


def _layers(folder):
    # Once, not in each child.
    import geopandas  # noqa: F401
    import rioxarray  # noqa: F401
    from cost_maps import make_field
    from route_maps import write_folder
    from sheet_maps import write_in_sheets
    from survey_pairs import survey

    from bumpymap.api import open_layers
    from bumpymap.change import diff_surveys
    from bumpymap.layers import open_map
    from bumpymap.route import RouteConfig, plan_routes
    from bumpymap.views import ExportSettings, export_map, write_report
    from bumpytiles import Grid

    one = write_folder(folder / "map", make_field(12, 10, grid=Grid(3.0, 5), easy=True))
    _limit_classes(one / "run.json")
    sheets = folder / "sheets_map"
    write_in_sheets(make_field(20, 18, grid=Grid(3.0, 5), easy=True), sheets)
    pair = [write_folder(folder / name, survey(seed, rut=0.1 * seed)) for seed, name in enumerate(("before", "after"))]
    diff_surveys(*pair, folder / "diff")

    def report(place, out):
        out.mkdir()
        write_report(place, out / "page.html")

    def python(place, out):
        del out
        layers = open_layers(place)
        repr(layers)
        layers.dataset().load()
        layers.heights().load()
        layers.tiles()
        layers.regions()

    def export(place, out):
        export_map(open_map([place]), out, ExportSettings("nav2"))

    def route(place, out):
        site = open_map([place])
        bounds = site.grid.window_bounds(site.window)
        ends = [f"crs:{bounds.west + step},{bounds.south + step}" for step in (7.0, 22.0)]
        plan_routes(RouteConfig(layers=(place,), start=ends[0], goal=ends[1], snap=20.0, out=out))

    for name in ("run.json", "class.tif", "heightmap.tif", "roughness.tif", "barred.tif", "obstacle.tif"):
        calls = (report, python, export, route)
        yield from (_case(one / name, call, one) for call in calls)
    for name in ("tiles.parquet", "cost.fgb"):
        yield from (_case(one / name, call, one) for call in (report, python))
    inner = min(path.name for path in (sheets / "sheets").iterdir())
    for name in ("run.json", "class.vrt", "heightmap.vrt", f"sheets/{inner}/run.json", f"sheets/{inner}/class.tif"):
        yield from (_case(sheets / name, call, sheets, f"{call.__name__} of sheets") for call in (report, python))
    for name in ("change.json", "change.tif", "change.geojson"):
        yield _case(folder / "diff" / name, report, folder / "diff", "report of changes")
    yield from _commands(folder, one, *pair)


def _limit_classes(path):
    record = json.loads(path.read_text())
    record["calibration"] |= {"class_limits": [0.05, 0.1, 0.2]}
    path.write_text(json.dumps(record))


def _drive_over(folder):
    """Write the log of a short drive over the map."""
    from made_drives import MadeDrive, log_of, write_table

    log = log_of(MadeDrive(seconds=40.0, noise=0.01))[0]
    return write_table(folder / "over.csv", log, (330_005.0, 2_040_012.0))


def _commands(folder, one, before, after):
    """Yield who reads layers by command, and what other commands left of a map: a route and a check."""
    from bumpymap.check import check_drives
    from bumpymap.layers import open_map
    from bumpymap.route import RouteConfig, plan_routes

    drive = _drive_over(folder)
    check = _command("check", "{}", "--drive", str(drive), "--out", "{out}", "--quiet")
    diff = _command("diff", str(before), "{}", "--out", "{out}", "--quiet")
    for name in ("run.json", "roughness.tif", "passage.tif", "cost.tif"):
        yield _case(one / name, check, one)
        yield _case(after / name, diff, after)
    for to in ("gridmap", "graph"):
        command = _command("export", "{}", "--to", to, "--out", "{out}", "--quiet")
        yield from (_case(one / name, command, one, to) for name in ("run.json", "passage.tif", "obstacle.tif"))
    site = open_map([one])
    bounds = site.grid.window_bounds(site.window)
    ends = [f"crs:{bounds.west + step},{bounds.south + step}" for step in (7.0, 22.0)]
    plan_routes(RouteConfig(layers=(one,), start=ends[0], goal=ends[1], snap=20.0, out=folder / "way"))
    check_drives(one, str(drive), folder / "checked")
    for name, option in (("way/route.geojson", "--route"), ("checked/check.json", "--check")):
        page = _command("report", str(one), option, "{}", "--out", "{out}.html", "--quiet")
        yield _case(folder / name, page, (folder / name).parent, option)
    plan = _command("export", str(one), "--to", "plan", "--route", "{}/route.geojson", "--out", "{out}", "--quiet")
    yield _case(folder / "way/route.geojson", plan, folder / "way", "plan")


def _vectors(folder):
    import shapely
    from pyogrio.raw import write
    from route_maps import bare_map

    from bumpymap.layers import read_areas, read_points
    from bumpymap.views.export.write import read_route_line

    site = bare_map()

    def points(path):
        read_points(path)

    def areas(path):
        read_areas(path, site, allow_outside=True)

    def line(path):
        read_route_line(path)

    degrees = [site.to_lonlat(*corner) for corner in AREA]
    shapes = {
        "points": shapely.MultiPoint(degrees),
        "areas": shapely.Polygon(degrees),
        "line": shapely.LineString(degrees),
    }
    for call in (points, areas, line):
        path = folder / f"{call.__name__}.geojson"
        geometry = shapely.geometry.mapping(shapes[call.__name__])
        feature = {"type": "Feature", "properties": {"name": "a"}, "geometry": geometry}
        path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
        yield _case(path, _of(call))
    (folder / "p.csv").write_text("name,lon,lat\na,-99.19,19.318\nb,-99.18,19.317\n")
    (folder / "p.gpx").write_text(
        '<?xml version="1.0"?><gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">'
        '<wpt lat="19.3" lon="-99.1"><name>a</name></wpt><wpt lat="19.4" lon="-99.1"/></gpx>'
    )
    yield from (_case(folder / name, _of(points)) for name in ("p.csv", "p.gpx"))
    wkb = shapely.to_wkb(np.array([shapely.Polygon(AREA)], object))
    for suffix in (".gpkg", ".fgb", ".shp"):
        path = folder / "areas" / f"a{suffix}"
        path.parent.mkdir(exist_ok=True)
        write(path, wkb, [np.array(["x"], object)], np.array(["name"]), geometry_type="Polygon", crs="EPSG:32614")
        if suffix != ".shp":
            yield _case(path, _of(areas))

    def shapefile(place):
        areas(place / "a.shp")

    yield from (_case(path, _of(shapefile), path.parent) for path in sorted((folder / "areas").glob("a.[sdpc]*")))


def _logs(folder):
    from drive_tables import drive, write as write_table
    from ulogs import ulog

    from bumpymap.readers import read_drive, read_poses, read_scan

    frames = [Path(f"{number:06d}.bin") for number in range(4)]

    def drive_log(path):
        read_drive(str(path))

    def poses(path):
        read_poses(path, frames)

    def timed_poses(path):
        read_poses(path, frames, 0.1 * np.arange(4))

    write_table(folder / "drive.csv", drive(200))
    yield _case(folder / "drive.csv", _of(drive_log))
    rows = [(10_000 * at, 0.01 * at, 0.0, 0.1, 0.0, 0.0, -9.8) for at in range(1, 100)]
    fields = ["uint64_t timestamp", "float[3] gyro_rad", "float[3] accelerometer_m_s2"]
    (folder / "drive.ulg").write_bytes(ulog({"sensor_combined": (fields, rows)}))
    yield _case(folder / "drive.ulg", _of(drive_log))
    rng = np.random.default_rng(1)
    places = rng.normal(0.0, 5.0, (500, 3)).astype(np.float32)
    np.hstack([places, np.ones((500, 1), np.float32)]).tofile(folder / "frame.bin")
    head = b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 500\nHEIGHT 1\n"
    (folder / "frame.pcd").write_bytes(head + b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 500\nDATA binary\n" + places.tobytes())
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 500\n"
    head += b"property float x\nproperty float y\nproperty float z\nend_header\n"
    (folder / "frame.ply").write_bytes(head + places.tobytes())
    yield from (_case(folder / name, _of(read_scan)) for name in ("frame.bin", "frame.pcd", "frame.ply"))
    np.savetxt(folder / "poses.txt", np.tile(np.eye(4)[:3].ravel(), (4, 1)))
    yield _case(folder / "poses.txt", _of(poses))
    rows = [f"{0.1 * at:.1f} {at} 0 0 0 0 0 1" for at in range(4)]
    (folder / "tum.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows) + "\n")
    (folder / "table.csv").write_text("time,x,y,z,qx,qy,qz,qw\n" + "\n".join(rows).replace(" ", ",") + "\n")
    yield from (_case(folder / name, _of(timed_poses)) for name in ("tum.txt", "table.csv"))
    yield from _ros1(folder, _of(drive_log))
    yield from _bags(folder, _of(drive_log))


def _bags(folder, call):
    from bags import imu, odometry, write_bag
    from scipy.spatial.transform import Rotation

    turned = Rotation.identity()
    messages = [("/odom", 10**8 * at, odometry(10**8 * at, (turned, (0.1 * at, 0.0, 0.0)))) for at in range(20)]
    messages += [("/imu", 10**8 * at, imu(10**8 * at, (0.0, 0.01 * at, 0.0))) for at in range(20)]
    for storage in ("mcap", "sqlite3"):
        place = write_bag(folder / f"bag_{storage}", messages, storage)
        for path in sorted(place.iterdir()):
            yield _case(path, call, place, storage)


def _ros1(folder, call):
    from bags import write_ros1

    readings = [(10**8 * at, 10**8 * at, (0.0, 0.01 * at, 0.0)) for at in range(20)]
    yield _case(write_ros1(folder / "drive.bag", readings), call)


def _scans(folder):
    """Yield what `bumpymap scan` reads: bags of clouds, frames with labels and poses, and models."""
    from bags import LIDAR, cloud, write_bag

    import bumpymap
    from bumpymap.readers import label_set
    from bumpymap.scan import ScanModel

    rng = np.random.default_rng(2)
    radius, azimuth = np.sqrt(rng.uniform(1.0, 200.0, 3000)), rng.uniform(-np.pi, np.pi, 3000)
    rows = np.zeros(3000, LIDAR)
    rows["x"], rows["y"], rows["z"] = radius * np.cos(azimuth), radius * np.sin(azimuth), rng.normal(-1.0, 0.05, 3000)
    scan = _command("scan", "{}", "--out", "{out}", "--quiet")
    for storage in ("mcap", "sqlite3"):
        clouds = [("/points", 10**8 * at, cloud(rows[:600], 10**8 * at)) for at in range(2)]
        place = write_bag(folder / f"clouds_{storage}", clouds, storage)
        yield from (_case(path, scan, place, f"scan {storage}") for path in sorted(place.iterdir()))
    drive = folder / "kitti"
    (drive / "velodyne").mkdir(parents=True)
    (drive / "labels").mkdir()
    for number in range(2):
        table = np.column_stack([rows["x"], rows["y"], rows["z"], np.ones(3000)]).astype(np.float32)
        table.tofile(drive / "velodyne" / f"{number:06d}.bin")
        np.full(3000, 40, np.uint32).tofile(drive / "labels" / f"{number:06d}.label")
    np.savetxt(drive / "poses.txt", np.tile(np.eye(4)[:3].ravel(), (2, 1)))
    (drive / "times.txt").write_text("0.0\n0.1\n")
    (drive / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    frames = _command("scan", "{}/velodyne", "--out", "{out}", "--poses", "{}/poses.txt", "--quiet")
    labelled = _command("evaluate", "--scans", "{}/velodyne", "--out", "{out}", "--quiet")
    for name in ("velodyne/000001.bin", "poses.txt", "times.txt", "calib.txt"):
        yield _case(drive / name, frames, drive, "scan kitti")
    yield _case(drive / "labels" / "000001.label", labelled, drive, "evaluate kitti")

    home = Path(bumpymap.__file__).parent / "scan" / "data" / "models"
    yield from (_case(path, _of(ScanModel.load), label="scan model") for path in sorted(home.glob("*.onnx"))[:1])
    (folder / "labels.csv").write_text("id,class,name,kind\n1,0,grass,ground\n2,2,tree,obstacle\n")
    yield _case(folder / "labels.csv", _of(label_set), label="labels")


def _settings(folder):
    import bumpymap
    from bumpymap.core import MapConfig, read_settings_file
    from bumpymap.core.run_folder import RunFolder, work_folder
    from bumpymap.rating import Calibration, TextureModel, Vehicle
    from bumpymap.survey.batch.source import read_table, read_text

    def resume(place, out):
        del out
        spec = {"inputs": {"a.las": {"size": 5}}, "settings": {"tile_size": 3.0}, "made with": {"numpy": "2"}}
        with RunFolder.opened(place, spec, overwrite=True, finished=lambda _: True, advice=""):
            pass

    data = Path(bumpymap.__file__).parent / "rating" / "data"
    profile, calibration = min(data.glob("vehicles/*.toml")), min(data.glob("calibrations/*.json"))
    yield _case(profile, _of(Vehicle.load), label="profile")
    yield _case(calibration, _of(Calibration.load), label="calibration")
    yield from (_case(path, _of(TextureModel.load), label="model") for path in sorted(data.rglob("*texture*.onnx"))[:1])
    (folder / "settings.toml").write_text(
        'tile_size = 3.0\npixels = 15\nvehicle = "husky"\n[features]\nmin_points = 30\n'
    )
    yield _case(folder / "settings.toml", _of(lambda path: read_settings_file(path, MapConfig)), label="settings")
    night = folder / "night"
    night.mkdir()
    (night / "surveys.csv").write_text("survey,name,crs\na.laz,first,EPSG:32614\nb.laz,second,\n")
    for name in ("a.laz", "b.laz"):
        (night / name).touch()
    batch = _of(lambda place: read_table(read_text(place / "surveys.csv"), str(place / "surveys.csv"), place))
    yield _case(night / "surveys.csv", batch, night, "batch")
    spec = work_folder(folder / "begun")
    spec.mkdir(parents=True, mode=0o700)
    inputs = {"a.las": {"size": 5}}
    text = json.dumps({"inputs": inputs, "settings": {"tile_size": 3.0}, "made with": {"numpy": "2"}, "cut": 3})
    (spec / "run_spec.json").write_text(text)
    yield _case(spec / "run_spec.json", resume, folder / "begun", writes=True)
