"""Quantities of a drive, their units and names; from samples of them, as any format gives them, to one record of it."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, DriveLog, Floats, ImuTrack, PlaceKind, PlaceTrack, UsageError, WheelTrack

RATES = ("rate_x", "rate_y", "rate_z")
ACCELERATIONS = ("acc_x", "acc_y", "acc_z")
ANGLES = ("roll", "pitch", "yaw")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")
LONLAT = ("longitude", "latitude")
EASTING_NORTHING = ("easting", "northing")
LOCAL = ("x", "y")
SIDES = ("speed_left", "speed_right")
DOWN = frozenset({"rate_y", "rate_z", "acc_y", "acc_z", "pitch", "yaw", "q_y", "q_z"})
"""Quantities whose sign differs between x forward, y right, z down and x forward, y left, z up."""
DIMENSIONS: Mapping[str, str] = {
    "time": "time",
    **dict.fromkeys(RATES, "rate"),
    **dict.fromkeys(ACCELERATIONS, "acceleration"),
    **dict.fromkeys(ANGLES, "angle"),
    **dict.fromkeys(QUATERNION, "number"),
    **dict.fromkeys(LONLAT, "degree"),
    **dict.fromkeys((*EASTING_NORTHING, *LOCAL, "error"), "length"),
    "fix": "number",
    **dict.fromkeys(("speed", *SIDES), "speed"),
}
"""Quantity -> what its unit is a unit of."""
QUANTITIES = tuple(DIMENSIONS)
NAMES: Mapping[str, str] = {
    **dict(zip(QUANTITIES, QUANTITIES, strict=True)),
    **{f"{name}{axis}": f"rate_{axis}" for name in ("gyro_", "w") for axis in "xyz"},
    **{f"a{axis}": f"acc_{axis}" for axis in "xyz"},
    **{f"q{axis}": f"q_{axis}" for axis in "xyzw"},
    "lon": "longitude",
    "lat": "latitude",
    "horizontal_error": "error",
    "vell": "speed_left",
    "velr": "speed_right",
}
"""Name of a column in lower case, without its unit -> quantity."""
_G = 9.80665
"""Standard gravity, m/s2 (ISO 80000-3)."""
_DEGREE = pi / 180.0
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "mdeg/s": 1e-3 * _DEGREE},
    "acceleration": {"m/s2": 1.0, "g": _G, "mg": 1e-3 * _G},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "degree": {"deg": 1.0, "rad": 1.0 / _DEGREE, "dege7": 1e-7},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704},
    "number": {"": 1.0},
}
"""Dimension -> unit -> factor to the unit of `DriveLog`, which is the first."""


class DriveColumn(NamedTuple):
    """A column of a file and what it holds."""

    name: str
    unit: str | None = None
    """Key of `UNITS`; None: its name does not say, and it is the first."""
    sign: float = 1.0


_IN_BRACKETS = re.compile(r"([^\[(]+?)\s*[\[(]([^\[\]()]+)[\])]")


def named_columns(source: str, names: Sequence[str], skip: Collection[str] = ()) -> dict[str, DriveColumn]:
    """Return the columns that have the name of a quantity but those to ``skip``, perhaps with its unit in brackets.

    Raises BadInputError: two columns have names of one quantity, or a unit is unknown.
    """
    found: dict[str, DriveColumn] = {}
    for name in names:
        with_unit = _IN_BRACKETS.fullmatch(name)
        bare, unit = with_unit.groups() if with_unit else (name, None)
        quantity = NAMES.get(bare.strip().lower())
        if quantity is None or quantity in skip:
            continue
        if quantity in found:
            raise BadInputError(
                f"{source} has two columns of {quantity}: {found[quantity].name}, {name}. Name one: "
                f"`columns='{quantity}={name}'`"
            )
        unit = None if unit is None else unit.strip()
        units = UNITS[DIMENSIONS[quantity]]
        if unit is not None and unit not in units:
            raise BadInputError(
                f"the column {name} of {source} has the unit '{unit}', which is none of {', '.join(units)}. State it: "
                f"`columns='{quantity}={name}[{next(iter(units))}]'`"
            )
        found[quantity] = DriveColumn(name, unit)
    return found


TOPICS = ("imu", "gnss", "odometry", "twist")
"""Quantities of bags: the topics that they are read from."""
_EXPLAINED = (
    f"Quantities are {', '.join(QUANTITIES)}; in bags {', '.join(TOPICS)}. For example "
    "`columns='rate_y=GyrY[deg/s],time=t[ms]'`"
)
_STATED = re.compile(r"(.+?)\s*(?:\[([^\[\]]+)\]|:([^:]+))")


def parse_columns(text: str) -> dict[str, str]:
    """Return what was named for each quantity: ``rate_y=GyrY[deg/s],time=t`` is {"rate_y": "GyrY[deg/s]", "time": "t"}.

    Raises UsageError: the text is not of this form, or names something that is no quantity.
    """
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        quantity, equals, name = part.partition("=")
        if not equals:
            raise UsageError(f"`columns` is QUANTITY=COLUMN,..., not '{part}'. {_EXPLAINED}")
        if quantity.strip() in found:
            raise UsageError(f"`columns` names {quantity.strip()} twice. Name it once")
        found[quantity.strip()] = name.strip()
    unknown_quantities(found)
    return found


def unknown_quantities(columns: Mapping[str, str]) -> None:
    """Raise UsageError if columns are named for something that is no quantity."""
    unknown = sorted(set(columns) - {*QUANTITIES, *TOPICS})
    if unknown:
        raise UsageError(f"`columns` names {', '.join(unknown)}, which is no quantity. {_EXPLAINED}")


def chosen_columns(columns: Mapping[str, str], names: Sequence[str]) -> dict[str, DriveColumn]:
    """Return the named columns that a file has, by quantity.

    ``columns``: quantity -> name of a column, perhaps with a sign before it, and a unit behind it
    in square brackets or after a colon. An empty name: nothing is read for this quantity;
    ``names``: columns of the file. Raises UsageError: a unit is unknown.
    """
    found: dict[str, DriveColumn] = {}
    for quantity, text in columns.items():
        units = UNITS[DIMENSIONS[quantity]]
        sign, bare = (-1.0, text[1:]) if text.startswith("-") and _named(text, names) is None else (1.0, text)
        name, stated = _named(bare, names), None
        if name is None and (match := _STATED.fullmatch(bare)) is not None:
            name, stated = _named(match.group(1), names), match.group(2) or match.group(3)
        if name is None:
            continue
        if stated is not None and stated not in units:
            allowed = ", ".join(filter(None, units)) or "none"
            raise UsageError(f"'{stated}' is no unit of {quantity} in `columns`. Units of it are: {allowed}")
        own = _IN_BRACKETS.fullmatch(name)
        found[quantity] = DriveColumn(name, stated or (own[2] if own and own[2] in units else None), sign)
    return found


def _named(text: str, names: Sequence[str]) -> str | None:
    """Return the name of the column that is meant; capital letters count only where they tell columns apart."""
    if text in names:
        return text
    same = [name for name in names if name.lower() == text.strip().lower()]
    return same[0] if len(same) == 1 else None


Track = TypeVar("Track", "Signal", PlaceTrack, WheelTrack)


@dataclass(frozen=True, slots=True)
class Samples:
    """Quantities of one file, or of one topic of a recording."""

    source: str
    """Name of the file or topic, for messages."""
    values: Mapping[str, Floats] = field(default_factory=dict)
    """Quantity -> (n,) in the unit of `DriveLog`, NaN where missing. With any, ``time`` in s is there. ``fix`` is
    negative where a position was not measured."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> column, or purpose of a topic -> topic."""
    notes: list[str] = field(default_factory=list)
    listing: str = ""
    """Content of the file, for the message that something is missing."""


@dataclass(frozen=True, slots=True)
class Signal:
    """Samples of one sensor."""

    time: Floats
    """(n,) s, increasing."""
    values: Floats
    """(n, k), finite."""


_MOST_RATE, _MOST_PEAK = 3.0, 20.0
"""Median and 99th percentile of angular rates, rad/s: no ground vehicle turns that fast for half of a drive."""
_GRAVITY = (7.0, 13.0)
"""Size of the median acceleration of a sensor that reads gravity, m/s2."""
_MOST_REPEATED = 0.5
"""Share of times that may repeat the one before, and of places that may differ from it, for a position to count as held
until the next one."""
_ROUNDING = 0.1
"""Tolerance of the lengths of quaternions."""
_LONGEST_STEP_S = 0.5
"""Between attitudes further apart, nothing is known about the rate."""
_LARGE_M = 1e5
"""No odometry reaches so far, m; eastings and northings do."""


def _rows(samples: Samples, group: tuple[str, ...], what: str, good: NDArray[np.bool_] | None = None) -> Signal | None:
    """Return the samples that have all quantities of a group, of equal times the first; None without any.

    Raises BadInputError: times run backwards, or most of them repeat.
    """
    if not set(group) <= set(samples.values):
        return None
    time, values = samples.values["time"], np.stack([samples.values[quantity] for quantity in group], axis=1)
    rows = np.flatnonzero(np.isfinite(time) & np.isfinite(values).all(axis=1) & (True if good is None else good))
    if not len(rows):
        return None
    time, values, what = time[rows], values[rows], f"the {what} of {samples.source}"
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        place = int(back[0])
        raise BadInputError(
            f"the times of {what} run backwards {len(back):,} times, first from {time[place]:.3f} s to "
            f"{time[place + 1]:.3f} s at sample {place + 2:,}. If these are several drives, give each as its own file; "
            "if the clock was set while recording, use a time that runs on, such as the time since the start"
        )
    keep = np.append(True, steps > 0.0)
    repeated = int((~keep).sum())
    if repeated > _MOST_REPEATED * len(time):
        raise BadInputError(
            f"{repeated:,} of the {len(time):,} times of {what} repeat the one before: the column of times is too "
            "coarse (whole seconds?). Name a finer one: `columns='time=NAME[unit]'`"
        )
    if repeated:
        samples.notes.append(f"{repeated:,} samples of {what} repeat the time before them and are left out")
    return Signal(time[keep], values[keep])


def _rate(samples: Samples) -> Signal | None:
    """Return angular rates about x, y, z, rad/s.

    Raises BadInputError: they are too large, or all of them are zero.
    """
    found = _rows(samples, RATES, "angular rates")
    if found is None:
        return None
    with np.errstate(over="ignore"):
        size = np.linalg.norm(found.values, axis=1)
    middle, peak = (float(value) for value in np.percentile(size, (50, 99)))
    names = [samples.columns.get(quantity, quantity) for quantity in RATES]
    if not size.any():
        raise BadInputError(
            f"the angular rates of {samples.source} ({', '.join(names)}) are all zero: these columns hold no "
            "gyroscope. Name those that do: `columns='rate_x=NAME,rate_y=NAME,rate_z=NAME'`"
        )
    if middle > _MOST_RATE or peak > _MOST_PEAK:
        stated = ",".join(f"{rate}={name}[deg/s]" for rate, name in zip(RATES, names, strict=True))
        raise BadInputError(
            f"the angular rates of {samples.source} ({', '.join(names)}) are too large for rad/s: half of them are "
            f"above {middle:.3g}, one in a hundred above {peak:.3g}. State their unit: `columns='{stated}'` (rad/s, "
            "deg/s, mrad/s or mdeg/s)"
        )
    return found


def _acceleration(samples: Samples) -> Signal | None:
    """Return the specific force along x, y, z, m/s2; None if it holds no gravity."""
    found = _rows(samples, ACCELERATIONS, "accelerations")
    if found is None:
        return None
    middle = float(np.linalg.norm(np.median(found.values, axis=0)))  # of noise alone it would be small
    if _GRAVITY[0] < middle < _GRAVITY[1]:
        return found
    samples.notes.append(
        f"accelerations of {samples.source} are not used: their median is {middle:.3g} m/s2, and with gravity it would "
        "be about 9.8. If they are in another unit, state it: `columns='acc_x=NAME[g],acc_y=NAME[g],acc_z=NAME[g]'`"
    )
    return None


def _attitude(samples: Samples) -> Signal | None:
    """Return quaternions x, y, z, w that turn vectors of the sensor's axes into those of a fixed frame.

    Those that are no rotation are left out; None if they are fewer than two, or all the same.
    """
    found = _rows(samples, QUATERNION, "attitudes")
    if found is None and {"roll", "pitch"} <= set(samples.values):
        if "yaw" not in samples.values:
            samples.notes.append(f"{samples.source} has roll and pitch, but no yaw: turning is left out of its rates")
        values = {"yaw": np.zeros_like(samples.values["roll"]), **samples.values}
        angles = _rows(Samples(samples.source, values, notes=samples.notes), ANGLES, "attitudes")
        if angles is not None:
            if (most := float(np.abs(angles.values).max())) > 2 * np.pi + 0.01:
                names = {each: samples.columns.get(each, each) for each in ANGLES if each in samples.values}
                raise BadInputError(
                    f"roll, pitch and yaw of {samples.source} reach {most:.3g}, which is too large for rad. State "
                    f"their unit: `columns='{','.join(f'{each}={name}[deg]' for each, name in names.items())}'`"
                )
            from scipy.spatial.transform import Rotation

            # They turn by yaw about z, then by pitch about the new y, then by roll about the new x.
            found = Signal(angles.time, Rotation.from_euler("ZYX", angles.values[:, ::-1]).as_quat())
    if found is None:
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        good = np.abs(np.linalg.norm(found.values, axis=1) - 1.0) < _ROUNDING
    known = good.sum() > 1 and np.ptp(found.values[good], axis=0).any()
    return Signal(found.time[good], found.values[good]) if known else None


def body_rates(attitude: Signal) -> Signal:
    """Return the angular rates about the sensor's own axes between each two attitudes that follow each other.

    ``attitude``: quaternions (n, 4), x, y, z, w, of any length but 0. Returns rates (m, 3), rad/s,
    constant rotation being assumed from one attitude to the next, in the middle of both. None
    across gaps of more than half a second.
    """
    from scipy.spatial.transform import Rotation

    turns, step = Rotation.from_quat(attitude.values), np.diff(attitude.time)
    rates = (turns[:-1].inv() * turns[1:]).as_rotvec() / step[:, None]
    near = step <= _LONGEST_STEP_S
    return Signal((attitude.time[:-1] + 0.5 * step)[near], rates[near])


def _places(samples: Samples) -> PlaceTrack | None:
    """Return longitude and latitude before eastings and northings, these before odometry."""
    groups: dict[tuple[str, str], PlaceKind] = {LONLAT: "lonlat", EASTING_NORTHING: "projected", LOCAL: "local"}
    for group, kind in groups.items():
        if set(group) <= set(samples.values) and (track := _track(samples, group, kind)) is not None:
            return track
    return None


def _track(samples: Samples, group: tuple[str, str], kind: PlaceKind) -> PlaceTrack | None:
    source, values, notes = samples.source, samples.values, samples.notes
    unknown = np.full(len(values["time"]), np.nan)
    bad = values.get("fix", unknown) < 0.0
    if kind == "lonlat":
        bad |= (values[group[0]] == 0.0) & (values[group[1]] == 0.0)
    known = np.isfinite(values[group[0]] + values[group[1]])
    if lost := int((bad & known).sum()):
        notes.append(f"{lost:,} of {known.sum():,} positions of {source} were taken without a fix and are left out")
    error = np.nan_to_num(values.get("error", unknown), nan=-1.0)
    found = _rows(Samples(source, {**values, "error": error}, notes=notes), (*group, "error"), "positions", ~bad)
    if found is None:
        return None
    x, y, error = found.values.T
    if kind == "lonlat":
        x, y = _degrees(samples, x, y)
    elif kind == "local" and max(float(np.median(np.abs(x))), float(np.median(np.abs(y)))) > _LARGE_M:
        kind = "projected"
        notes.append(f"x and y of {source} are as large as eastings and northings, and are taken for those")
    elif kind == "local":
        notes.append(f"x and y of {source} are taken for odometry: they say how far it drove, but not where")
    # A table may repeat the last position in each row until the next one.
    fresh = np.append(True, np.hypot(np.diff(x), np.diff(y)) > 0.0)
    if kind == "local" or fresh.sum() < 3 or fresh.mean() >= _MOST_REPEATED:
        fresh[:] = True
    if lost := int((~fresh).sum()):
        notes.append(f"{lost:,} positions of {source} only repeat the one before and are left out")
    return PlaceTrack(found.time[fresh], x[fresh], y[fresh], np.where(error[fresh] > 0.0, error[fresh], np.nan), kind)


def _degrees(samples: Samples, lon: Floats, lat: Floats) -> tuple[Floats, Floats]:
    """Return longitude and latitude. Raises BadInputError: they are out of range."""
    far_lon, far_lat = float(np.abs(lon).max()), float(np.abs(lat).max())
    if far_lat <= 90.0 and far_lon <= 360.0:
        return lon, lat
    names = [samples.columns.get(quantity, quantity) for quantity in LONLAT]
    raise BadInputError(
        f"the positions of {samples.source} ({', '.join(names)}) reach longitude {far_lon:.6g}, latitude "
        f"{far_lat:.6g}. Longitudes are -180 to 180 degrees, latitudes -90 to 90, without minutes; the unit of "
        f"1e-7 degrees is dege7. Are they swapped? `columns='longitude={names[1]},latitude={names[0]}'`. Metres are "
        "named so: `columns='easting=NAME,northing=NAME'`"
    )


def _wheels(samples: Samples) -> WheelTrack | None:
    sides = _rows(samples, SIDES, "wheel speeds")
    if sides is not None:
        return WheelTrack(sides.time, sides.values.mean(axis=1), sides.values[:, 1] - sides.values[:, 0])
    one = _rows(samples, ("speed",), "speeds")
    return None if one is None else WheelTrack(one.time, one.values[:, 0], np.full(len(one.time), np.nan))


_FEWEST = 20
"""Samples of angular rates."""
_SLOWEST_S = 1.0
"""Median time between two angular rates."""
_KINDS = ("lonlat", "projected", "local")
_GAP = 5.0
"""A gap is this multiple of the median time between two samples, and at least `_LEAST_GAP_S`."""
_LEAST_GAP_S = {"angular rates": 0.1, "positions": 2.0, "wheel speeds": 1.0}
_BRIDGED_S = 0.25
"""Accelerations are interpolated over at most so much time."""
_COLUMNS = {
    "angular rates": {*RATES, "imu"},
    "attitudes": {*ANGLES, *QUATERNION, "imu", "odometry", "attitude"},
    "accelerations": {*ACCELERATIONS, "imu"},
    "positions": {*LONLAT, *EASTING_NORTHING, *LOCAL, "error", "fix", "gnss", "odometry"},
    "wheel speeds": {"speed", *SIDES, "odometry", "twist"},
}
"""Signal -> quantities and purposes of topics that it is read from."""


class _Joined:
    """The signals of all sources, and what is said about the choice between them."""

    def __init__(self, sources: Sequence[Samples]) -> None:
        self.sources = sources
        self.columns: dict[str, str] = {}
        self.notes: list[str] = []

    def first(
        self, what: str, read: Callable[[Samples], Track | None], rank: Callable[[Samples, Track], tuple[float, ...]]
    ) -> tuple[Samples, Track] | None:
        """Return the signal of the source that ranks lowest; say which others have one."""
        found = [(source, track) for source in self.sources if (track := read(source)) is not None]
        found.sort(key=lambda each: rank(*each))
        if not found:
            return None
        source, track = found[0]
        if len(found) > 1 and what in _LEAST_GAP_S:
            others = ", ".join(other.source for other, _ in found[1:])
            self.notes.append(f"{what} are read from {source.source}; {others} has some too")
        several = sum(bool(each.columns) for each in self.sources) > 1
        for key, text in source.columns.items():
            if key in _COLUMNS[what] or key == "time":
                self.columns.setdefault(key, f"{source.source}: {text}" if several and text != source.source else text)
        return source, track


def assemble(name: str, paths: Sequence[Path], sources: Sequence[Samples]) -> DriveLog:
    """Join samples to a drive.

    Raises BadInputError: no source has angular rates or attitudes, they are too few, values cannot
    be meant, or the clocks of the sources have nothing in common.
    """
    joined = _Joined(sources)
    imu = _imu(name, joined)
    place = joined.first("positions", _places, lambda _, track: (_KINDS.index(track.kind),))
    roll = joined.first("wheel speeds", _wheels, lambda _, track: (bool(np.isnan(track.difference).all()),))
    places, wheels = place[1] if place else None, roll[1] if roll else None
    notes = [*(note for source in sources for note in source.notes), *joined.notes]
    for what, track in (("angular rates", imu), ("positions", places), ("wheel speeds", wheels)):
        if track is None:
            continue
        if track.time[-1] < imu.time[0] or track.time[0] > imu.time[-1]:
            raise BadInputError(
                f"the {what} of {name} have no time in common with its angular rates: {track.time[0]:.3f} to "
                f"{track.time[-1]:.3f} s against {imu.time[0]:.3f} to {imu.time[-1]:.3f} s. Write both with times of "
                "the same clock and time zone"
            )
        steps = np.diff(track.time)
        gaps = steps[steps > max(_GAP * float(np.median(steps)), _LEAST_GAP_S[what])] if len(steps) else steps
        if len(gaps):
            notes.append(f"{what} have {len(gaps):,} gap{'s' * (len(gaps) > 1)}, the longest of {gaps.max():.2f} s")
    return DriveLog(name, tuple(paths), imu, places, wheels, joined.columns, tuple(notes))


def _imu(name: str, joined: _Joined) -> ImuTrack:
    forces = {id(source): force for source in joined.sources if (force := _acceleration(source)) is not None}
    found = joined.first("angular rates", _rate, lambda source, rate: (id(source) not in forces, -len(rate.time)))
    if found is None:
        found = joined.first("attitudes", _attitude, lambda _, attitude: (-len(attitude.time),))
        if found is None:
            held = "; ".join(source.listing for source in joined.sources if source.listing)
            raise BadInputError(
                f"{name} has neither angular rates nor attitudes that are known by their names. It holds {held}. Name "
                "the columns: `columns='rate_x=NAME[deg/s],rate_y=NAME[deg/s],rate_z=NAME[deg/s]'`"
            )
        found = found[0], body_rates(found[1])
        joined.notes.append(f"{found[0].source} has no angular rates: they are differences of its attitudes")
    source, rate = found
    if len(rate.time) < _FEWEST:
        raise BadInputError(
            f"{name} has {len(rate.time)} samples of angular rates; at least {_FEWEST} are required, and a drive has "
            "thousands. Was the recording cut off?"
        )
    step = float(np.median(np.diff(rate.time)))
    if step > _SLOWEST_S:
        raise BadInputError(
            f"the angular rates of {name} are {step:.3g} s apart, which is no recording of an IMU. If times are in "
            "another unit, state it: `columns='time=NAME[ms]'`"
        )
    felt = joined.first("accelerations", lambda each: forces.get(id(each)), lambda each, _: (each is not source,))
    unknown = np.full(rate.values.shape, np.nan)
    return ImuTrack(rate.time, rate.values, unknown if felt is None else _at(rate.time, felt[1]))


def _at(times: Floats, signal: Signal) -> Floats:
    """Interpolate a signal at times; NaN where its samples are too far away."""
    if np.array_equal(times, signal.time):
        return signal.values
    values = np.stack([np.interp(times, signal.time, column) for column in signal.values.T], axis=1)
    after = np.clip(np.searchsorted(signal.time, times), 1, max(len(signal.time) - 1, 1))
    last = signal.time[np.minimum(after, len(signal.time) - 1)]
    far = np.maximum(last - times, times - signal.time[after - 1]) > _BRIDGED_S
    exact = np.isin(times, signal.time)
    return np.where((far & ~exact)[:, None], np.nan, values)
