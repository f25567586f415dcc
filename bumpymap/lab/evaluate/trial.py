"""Rate patches for several vehicles, drive over them and compare."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack, Progress, Steps
from bumpymap.lab.evaluate.compare import compare, compare_order, plain_predictors
from bumpymap.lab.evaluate.drives import DriveStats, journal_settings
from bumpymap.lab.evaluate.findings import ComparedPatches, Findings
from bumpymap.lab.evaluate.settings import EvaluateSettings
from bumpymap.lab.evaluate.subject import MAPPED, Subject
from bumpymap.lab.simulate import DriveConditions, Journal, Key, drive_patches

__all__ = ["PatchTrial", "TrialOptions"]


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """How the drives are run and where they are recorded."""

    out: Path
    """Folder of the report; journals of the drives are written to it and kept."""
    workers: int
    overwrite: bool
    """Discard a journal written with other settings."""
    progress: Progress


@dataclass(frozen=True, slots=True)
class PatchTrial:
    """Patches that can be classified, and the ground to drive over for each."""

    names: list[Key]
    """Names of n patches: tiles ``(col, row)``, or kind and index of terrains."""
    patches: PatchStack
    ground: NDArray[np.float64]
    """(n, pixels, pixels) m."""
    origin: dict[str, Any]
    """Everything that affects the ground, as JSON."""

    def run(
        self, subjects: Sequence[Subject], settings: EvaluateSettings, trial: TrialOptions, findings: Findings
    ) -> None:
        """Drive all vehicles over all patches and add the comparison to the findings."""
        driven: dict[str, DriveStats] = {}
        verdicts = {}
        plain = plain_predictors(self.patches)
        for subject in subjects:
            label = _label(subject, subjects)
            driven[label] = self._drive(subject, settings, trial)
            verdicts[label] = subject.judge(self.patches)
            too_steep = self.patches.slope > subject.profile.slope_limit_deg
            limits = subject.calibration.class_limits
            findings.comparisons[label] = compare(verdicts[label], plain, driven[label], too_steep, limits)
            findings.patches[label] = ComparedPatches(self.names, driven[label], verdicts[label])
        if len(subjects) > 1:
            ratings = [name for name in MAPPED if all(name in subject.ratings for subject in subjects)]
            for name in ratings:
                findings.orders.append(compare_order(name, {v: own[name] for v, own in verdicts.items()}, driven))

    def _drive(self, subject: Subject, settings: EvaluateSettings, trial: TrialOptions) -> DriveStats:
        size, pixels = self.patches.grid.tile_size, self.patches.grid.pixels
        recorded = journal_settings(subject.profile, settings, size, pixels, self.origin)
        trial.progress.start(f"driving {subject.name} over patches", len(self.names))
        results = drive_patches(
            DriveConditions(subject.profile, size, settings.seed, settings.effort, settings.drive),
            dict(zip(self.names, self.ground, strict=True)),
            Steps(trial.progress, settings.min_starts),
            workers=trial.workers,
            journal=Journal(trial.out / f"drives-{subject.key}.jsonl", recorded),
            discard_other=trial.overwrite,
        )
        return DriveStats.of(list(results.values()))


def _label(subject: Subject, subjects: Sequence[Subject]) -> str:
    """Return the name of the vehicle, with the calibration if two subjects share the name."""
    alike = sum(other.name == subject.name for other in subjects)
    return subject.name if alike == 1 else f"{subject.name} {subject.calibration.id}"
