"""The report of a tiny evaluation."""

import json

import numpy as np
import pytest

from bumpymap.lab.evaluate.agreement import DriveStats, class_table, compare
from bumpymap.lab.evaluate.report import write_report
from bumpymap.lab.evaluate.survey_trial import ComparedPatches, Findings

pytestmark = pytest.mark.slow

FACTS = {
    "files": ["site.laz"],
    "points": 1234567,
    "ground_only": False,
    "judged_tiles": 6,
    "unknown_tiles": {"too few points": 2},
    "density": 97.3,
}
VEHICLE = {"vehicle": "rover", "calibration": "abc", "class_limits": (0.1, 0.3, 0.5), "ratings": ["ride", "table"]}


@pytest.fixture
def findings(verdict_of):
    rng = np.random.default_rng(2)
    truth = np.geomspace(0.02, 0.9, 30)
    class_id = np.searchsorted([0.1, 0.3, 0.5], truth, side="right")
    failed = np.where(np.arange(30) > 26, 9, 0)
    driven = DriveStats(truth, 0.03 * truth, 16 - failed, failed)
    verdicts = {
        name: verdict_of(truth * np.exp(spread * rng.normal(size=30)), class_id, failed / 16)
        for name, spread in (("ride", 0.05), ("table", 0.4))
    }
    plain = {"z_variance": truth**2 * rng.random(30), "slope_free_sd": truth * rng.uniform(0.9, 1.1, 30)}
    classes = {"ride": class_table(verdicts["ride"], truth**2, truth / 5)}
    comparison = compare(verdicts, plain, driven, np.zeros(30, bool), (0.1, 0.3, 0.5))
    patches = ComparedPatches([(i, -i) for i in range(30)], driven, verdicts)
    return Findings("survey", FACTS, VEHICLE, {"seed": 7}, classes, comparison, patches)


def test_page_and_json_hold_every_number_and_none_for_the_unknown(findings, tmp_path):
    files = write_report(findings, tmp_path)
    assert sorted(path.name for path in files) == sorted(path.name for path in tmp_path.iterdir())
    text = (tmp_path / "report.md").read_text()
    for words in (
        "site.laz: 1,234,567 points",
        "6 tiles classified, 2 unknown (too few points: 2), 97 points per m2",
        "**rover, `ride`**: C_r is off by",
        "`ride`: variance, residual and C_r rise from class to class",
        "30 patches, 480 drives, 27 of them failed. On 3 patches",
        "1 - Spearman relative to that of the best plain predictor, `slope_free_sd`",
    ):
        assert words in text
    assert "nan" not in text
    record = json.loads((tmp_path / "report.json").read_text())
    assert record["format"] == "bumpymap-evaluation"
    assert record["comparison"]["agreement"]["z_variance"]["coverage"] is None
    assert len(record["patches"]["driven"]["c_r"]) == 30
    assert record["patches"]["names"][2] == [2, -2]
    own = record["comparison"]["agreement"]["ride"]
    assert own["spearman"] == pytest.approx(findings.comparison.agreement["ride"].spearman, rel=1e-5)
