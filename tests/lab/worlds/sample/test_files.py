import hashlib
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from ply_files import read_vertices

from bumpymap.core.errors import OutputError
from bumpymap.lab.worlds.sample import QuarrySite, main, make_quarry_survey, part_bounds, sample_survey

pytestmark = pytest.mark.slow

COMMITTED = Path(__file__).parents[4] / "sample_data"
SITE = QuarrySite(1)


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    make_quarry_survey(folder, seed=3, density=2.0)
    return folder


@pytest.fixture(scope="module")
def truth():
    return sample_survey(SITE)


def test_same_seed_same_bytes_in_another_process(small, tmp_path):
    program = (
        "import sys; from pathlib import Path; from bumpymap.lab.worlds.sample import make_quarry_survey; "
        "make_quarry_survey(Path(sys.argv[1]), seed=3, density=2.0)"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "again")], check=True)
    assert digests(tmp_path / "again") == digests(small)
    assert set(digests(small)) == {"quarry.laz", "quarry_part.ply"}


def test_another_seed_gives_other_bytes(small, tmp_path):
    make_quarry_survey(tmp_path, seed=4, density=2.0)
    assert not set(digests(tmp_path).values()) & set(digests(small).values())


def test_laz_says_what_it_is(small):
    with laspy.open(small / "quarry.laz") as reader:
        header = reader.header
        survey = reader.read()
    assert (str(header.version), header.point_format.id) == ("1.4", 6)
    assert header.global_encoding.wkt
    assert header.parse_crs().to_epsg() == 32632
    assert header.scales.tolist() == [0.001, 0.001, 0.001]
    assert header.mins.tolist() == [np.min(survey.x), np.min(survey.y), np.min(survey.z)]
    assert np.asarray(survey.return_number).min() == 1


def test_laz_reads_back_as_sampled(small):
    survey = laspy.read(small / "quarry.laz")
    points = sample_survey(QuarrySite(3), density=2.0)
    assert np.array_equal(survey.x, points.easting)
    assert np.array_equal(survey.y, points.northing)
    assert np.array_equal(survey.z, points.upward)
    assert np.array_equal(survey.classification, points.classification)
    assert np.array_equal(np.asarray(survey.withheld) == 1, points.withheld)


def test_committed_survey_is_what_the_generator_makes(truth):
    # Sines may differ in the last bit between machines, so a height may round to the next millimetre.
    survey = laspy.read(COMMITTED / "quarry.laz")
    assert survey.header.point_count == truth.easting.size
    assert np.array_equal(survey.classification, truth.classification)
    assert np.array_equal(np.asarray(survey.withheld) == 1, truth.withheld)
    for stored, made in ((survey.x, truth.easting), (survey.y, truth.northing), (survey.z, truth.upward)):
        off = np.abs(np.asarray(stored) - made)
        assert np.mean(off > 1e-6) < 1e-4
        assert np.quantile(off, 0.9999) < 1.1e-3


def test_committed_survey_keeps_its_promises():
    with laspy.open(COMMITTED / "quarry.laz") as reader:
        assert 1_000_000 <= reader.header.point_count <= 2_000_000
        assert reader.header.parse_crs().to_epsg() == 32632
    assert (COMMITTED / "quarry.laz").stat().st_size < 12_000_000
    assert (COMMITTED / "quarry_part.ply").stat().st_size < 1_500_000


def test_committed_ply_is_a_part_of_the_survey(truth):
    box = part_bounds(SITE)
    inside = (truth.easting >= box.west) & (truth.easting < box.east)
    inside &= (truth.northing >= box.south) & (truth.northing < box.north)
    inside &= ~truth.withheld & (truth.classification != 7)
    part = truth.select(inside)
    vertex = read_vertices(COMMITTED / "quarry_part.ply")
    assert vertex.dtype["x"] == np.float64
    assert 30_000 <= vertex.size == part.easting.size <= 60_000
    assert np.mean(np.abs(vertex["x"] - part.easting) > 1e-6) < 1e-4
    assert np.mean(np.abs(vertex["y"] - part.northing) > 1e-6) < 1e-4
    assert np.mean(np.abs(vertex["z"] - part.upward) > 1e-6) < 1e-3
    assert np.array_equal(vertex["classification"], part.classification)


def test_readme_names_every_file():
    text = (COMMITTED / "README.md").read_text(encoding="utf-8")
    for path in COMMITTED.iterdir():
        assert path.name == "README.md" or f"`{path.name}`" in text


def test_unwritable_folder_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(OutputError, match="Choose another folder"):
        make_quarry_survey(tmp_path / "file", density=1.0)


def test_failed_write_leaves_nothing_half_done(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bumpymap.lab.worlds.sample.write_ply", full)
    with pytest.raises(OutputError, match="No space left"):
        make_quarry_survey(tmp_path, density=1.0)
    assert [path.name for path in tmp_path.iterdir()] == ["quarry.laz"]


def test_command_writes_in_silence_and_fails_with_its_code(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "bumpymap.lab.worlds.sample.make_quarry_survey",
        lambda folder, seed: make_quarry_survey(folder, seed, density=1.0),
    )
    main(["--out", str(tmp_path / "out"), "--seed", "2"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["quarry.laz", "quarry_part.ply"]
    assert capsys.readouterr() == ("", "")
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    for arguments, code, words in (
        (["--out", str(tmp_path / "file")], 3, "Error: cannot write"),
        (["--out", str(tmp_path / "o"), "--seed", "-1"], 2, "--seed is -1; it must be 0 or more"),
        (["--seed", "1"], 2, "--out"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == code
        assert words in capsys.readouterr().err
