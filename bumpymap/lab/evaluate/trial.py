"""Patches under several vehicles: rated, driven, compared."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack, Progress, Steps
from bumpymap.lab.evaluate.compare import compare, compare_order, plain_predictors
from bumpymap.lab.evaluate.drives import Driven, journal_settings
from bumpymap.lab.evaluate.findings import DrivenPatches, Findings
from bumpymap.lab.evaluate.settings import EvaluateSettings
from bumpymap.lab.evaluate.subject import MAPPED, Subject
from bumpymap.lab.simulate import Journal, Key, drive_patches

__all__ = ["Crew", "Trial"]


@dataclass(frozen=True, slots=True)
class Crew:
    """Who drives, and where the drives are noted."""

    out: Path
    """Folder of the report; journals of the drives lie in it and stay."""
    workers: int
    overwrite: bool
    """Throw away a journal of other settings."""
    progress: Progress


@dataclass(frozen=True, slots=True)
class Trial:
    """Patches that can be judged, and the ground that is driven for each."""

    names: list[Key]
    """Of n patches: tiles ``(col, row)``, or kind and index of a terrain."""
    patches: PatchStack
    ground: NDArray[np.float64]
    """(n, pixels, pixels) m."""
    origin: dict[str, Any]
    """All that decides the ground, as JSON."""

    def run(self, subjects: Sequence[Subject], settings: EvaluateSettings, crew: Crew, findings: Findings) -> None:
        """Drive every vehicle over every patch; note what comes of it."""
        driven: dict[str, Driven] = {}
        verdicts = {}
        plain = plain_predictors(self.patches)
        for subject in subjects:
            label = _label(subject, subjects)
            driven[label] = self._drive(subject, settings, crew)
            verdicts[label] = subject.judge(self.patches)
            too_steep = self.patches.slope > subject.profile.slope_limit_deg
            limits = subject.calibration.class_limits
            findings.comparisons[label] = compare(verdicts[label], plain, driven[label], too_steep, limits)
            findings.patches[label] = DrivenPatches(self.names, driven[label], verdicts[label])
        if len(subjects) > 1:
            ratings = [name for name in MAPPED if all(name in subject.ratings for subject in subjects)]
            for name in ratings:
                findings.orders.append(compare_order(name, {v: own[name] for v, own in verdicts.items()}, driven))

    def _drive(self, subject: Subject, settings: EvaluateSettings, crew: Crew) -> Driven:
        size, pixels = self.patches.grid.tile_size, self.patches.grid.pixels
        recorded = journal_settings(subject.profile, settings, size, pixels, self.origin)
        crew.progress.start(f"driving {subject.name} over patches", len(self.names))
        results = drive_patches(
            subject.profile,
            dict(zip(self.names, self.ground, strict=True)),
            size,
            settings.seed,
            settings.effort,
            settings.drive,
            Steps(crew.progress, settings.min_starts),
            workers=crew.workers,
            journal=Journal(crew.out / f"drives-{subject.key}.jsonl", recorded),
            discard_other=crew.overwrite,
        )
        return Driven.of(list(results.values()))


def _label(subject: Subject, subjects: Sequence[Subject]) -> str:
    """Name of the vehicle; with the calibration where two subjects share it."""
    alike = sum(other.name == subject.name for other in subjects)
    return subject.name if alike == 1 else f"{subject.name} {subject.calibration.id}"
