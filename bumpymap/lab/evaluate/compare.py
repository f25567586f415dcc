"""Compare the predictions of each rating with drives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack
from bumpymap.lab.evaluate.agreement import (
    ClassShift,
    Coverage,
    ReliabilityBin,
    class_shift,
    confusion,
    coverage,
    cross_validated_fit,
    driven_class,
    fail_auc,
    median_error,
    median_ratio,
    monotone_fit,
    reliability,
    same_order,
    spearman,
)
from bumpymap.lab.evaluate.drives import DriveStats
from bumpymap.lab.evaluate.subject import Verdict

__all__ = [
    "Agreement",
    "Comparison",
    "FailAgreement",
    "KindRow",
    "VehicleOrder",
    "by_kind",
    "compare",
    "compare_order",
    "plain_predictors",
]

Floats = NDArray[np.float64]
CLASSES = 4


@dataclass(frozen=True, slots=True)
class FailAgreement:
    """Agreement of p_fail with the failed drives; all patches have the same weight."""

    auc: float
    auc_below_limit: float
    """AUC over patches within the vehicle's slope limit; beyond it p_fail is 1 by definition."""
    reliability: list[ReliabilityBin]


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of one predictor with the drives."""

    spearman: float
    median_error: float
    """Median of abs(predicted - driven) / driven."""
    median_ratio: float
    """Median of predicted / driven."""
    steps: ClassShift
    confusion: list[list[int]]
    """``[driven class][predicted class]``, patches within the vehicle's slope limit."""
    coverage: Coverage | None
    """Coverage of the 80 % interval; None without an interval."""
    fail: FailAgreement | None
    """None if the predictor has no p_fail."""
    fitted_error: float = float("nan")
    """Only for plain predictors: median error after the best fit to all compared patches, without cross-validation."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """All predictors on the same driven patches."""

    patches: int
    drives: int
    failed: int
    left_out: int
    """Patches whose C_r is not compared because too many drives failed."""
    beyond_limit: int
    """Patches steeper than the vehicle's limit."""
    label_error: float
    """Median standard error of the driven mean C_r, as a share of it."""
    label_error_over: int
    """Compared patches whose standard error stayed above 5 %."""
    auc_most: float
    """AUC of the driven shares themselves, the upper bound for any p_fail per patch."""
    auc_most_below_limit: float
    """The same within the vehicle's slope limit."""
    agreement: dict[str, Agreement]
    """Name of the predictor -> agreement."""


def plain_predictors(patches: PatchStack) -> dict[str, Floats]:
    """Return measures of roughness that do not depend on a vehicle, (n,) each."""
    return {
        "z_variance": patches.z_variance,
        "ransac_residual": patches.ransac_residual,
        "slope_free_sd": patches.relief_map.std(axis=(1, 2), dtype=np.float64),
    }


def compare(
    verdicts: Mapping[str, Verdict],
    plain: Mapping[str, Floats],
    driven: DriveStats,
    too_steep: NDArray[np.bool_],
    limits: tuple[float, ...],
) -> Comparison:
    """Compare predictors with the drives over n patches.

    Parameters
    ----------
    verdicts : mapping
        Name of the rating -> its results.
    plain : mapping
        Name -> predictor (n,); its C_r is the best monotone function of it, fitted to the other patches.
    driven : DriveStats
    too_steep : array (n,)
        True beyond the vehicle's slope limit; such patches have the last class by definition and are not compared.
    limits : tuple
        C_r limits between the classes, rad/m.
    """
    good, level = driven.comparable, ~too_steep
    class_id = driven_class(driven.c_r, driven.failed_share, limits)[level]
    found = {}
    for name, verdict in verdicts.items():
        table = confusion(class_id, verdict.class_id[level].astype(np.int64), CLASSES)
        held = coverage(verdict.c_r_low[good], verdict.c_r_high[good], driven.c_r[good])
        fail = _fail_agreement(verdict.p_fail, driven, too_steep)
        found[name] = _agreement(verdict.c_r, verdict.c_r, driven, table, held, fail)
    for name, predictor in plain.items() if good.any() else ():
        fitted = monotone_fit(predictor[good], driven.c_r[good], predictor)
        best = median_error(fitted[good], driven.c_r[good])
        fitted[good] = cross_validated_fit(predictor[good], driven.c_r[good])
        table = confusion(class_id, np.searchsorted(np.array(limits), fitted[level], side="right"), CLASSES)
        found[name] = replace(_agreement(predictor, fitted, driven, table, None, None), fitted_error=best)
    relative = driven.error[good] / driven.c_r[good]
    most = _fail_agreement(driven.failed_share, driven, too_steep)
    return Comparison(
        patches=len(good),
        drives=int((driven.completed + driven.failed).sum()),
        failed=int(driven.failed.sum()),
        left_out=int((~good).sum()),
        beyond_limit=int(too_steep.sum()),
        label_error=float(np.nanmedian(relative)) if np.isfinite(relative).any() else float("nan"),
        label_error_over=int((relative > 0.05).sum()),
        auc_most=most.auc,
        auc_most_below_limit=most.auc_below_limit,
        agreement=found,
    )


def _agreement(
    predictor: Floats,
    c_r: Floats,
    driven: DriveStats,
    table: NDArray[np.int64],
    held: Coverage | None,
    fail: FailAgreement | None,
) -> Agreement:
    good = driven.comparable
    return Agreement(
        spearman=spearman(predictor[good], driven.c_r[good]),
        median_error=median_error(c_r[good], driven.c_r[good]),
        median_ratio=median_ratio(c_r[good], driven.c_r[good]),
        steps=class_shift(table),
        confusion=table.tolist(),
        coverage=held,
        fail=fail,
    )


def _fail_agreement(p_fail: Floats, driven: DriveStats, too_steep: NDArray[np.bool_]) -> FailAgreement:
    share, level = driven.failed_share, ~too_steep
    return FailAgreement(
        auc=fail_auc(p_fail, share, 1 - share),
        auc_below_limit=fail_auc(p_fail[level], share[level], 1 - share[level]),
        reliability=reliability(p_fail, share),
    )


@dataclass(frozen=True, slots=True)
class KindRow:
    """Agreement on one kind of ground."""

    kind: str
    patches: int
    compared: int
    """Patches with comparable C_r."""
    failed_share: float
    """Share of failed drives, 0..1."""
    median_error: float
    """Median of abs(predicted - driven) / driven; NaN without compared patches."""
    median_ratio: float
    """Median of predicted / driven."""


def by_kind(kinds: Sequence[str], verdict: Verdict, driven: DriveStats) -> list[KindRow]:
    """Compare predictions and drives for each kind of ground, in order of first appearance; all of length n."""
    rows = []
    names = np.array(kinds)
    for kind in dict.fromkeys(kinds):
        own = names == kind
        good = own & driven.comparable
        rows.append(
            KindRow(
                kind=kind,
                patches=int(own.sum()),
                compared=int(good.sum()),
                failed_share=float(driven.failed[own].sum() / (driven.failed + driven.completed)[own].sum()),
                median_error=median_error(verdict.c_r[good], driven.c_r[good]),
                median_ratio=median_ratio(verdict.c_r[good], driven.c_r[good]),
            )
        )
    return rows


@dataclass(frozen=True, slots=True)
class VehicleOrder:
    """Agreement of the predicted order of vehicles with the driven order."""

    rating: str
    vehicles: tuple[str, ...]
    patches: int
    """Patches on which every vehicle has a comparable C_r."""
    same: float
    """Share of them with the same order; NaN without patches."""
    clear_patches: int
    """Patches on which neighbours in the driven order differ by more than two standard errors."""
    clear_same: float
    """Share of these with the same order; NaN without patches."""


def compare_order(rating: str, verdicts: Mapping[str, Verdict], driven: Mapping[str, DriveStats]) -> VehicleOrder:
    """Compare the order of two or more vehicles' C_r on the same patches; both mappings by name of the vehicle."""
    names = tuple(driven)
    good = np.all([driven[name].comparable for name in names], axis=0)
    truth, error = (np.stack([getattr(driven[name], kind)[good] for name in names]) for kind in ("c_r", "error"))
    same = same_order(np.stack([verdicts[name].c_r[good] for name in names]), truth)
    place = np.argsort(truth, axis=0)
    ranked, spread = np.take_along_axis(truth, place, 0), np.take_along_axis(error, place, 0)
    clear = np.all(np.diff(ranked, axis=0) > 2 * np.hypot(spread[1:], spread[:-1]), axis=0)
    return VehicleOrder(rating, names, int(good.sum()), _share(same), int(clear.sum()), _share(same[clear]))


def _share(right: NDArray[np.bool_]) -> float:
    return float(right.mean()) if len(right) else float("nan")
