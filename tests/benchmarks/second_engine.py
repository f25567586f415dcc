"""Drive a vehicle over fresh terrains in a second physics engine, and hold its ride against what a map predicts.

    python tests/benchmarks/second_engine.py --out DRIVES.jsonl [--vehicle warthog] [--seed 77] [--terrains 8]
        [--starts 8]
    python tests/benchmarks/second_engine.py --report DRIVES.jsonl [--densities 100,50,10] [--noise 0.01]
        [--rating ride|table]

It needs MuJoCo (pip install mujoco), which nothing else uses. Tyres give way, which the first engine leaves out, and
motors are as strong as the grip of the tyres allows. The terrains have a seed that no
calibration has. An interrupted run goes on where it was. The report surveys the terrains, rates them as a map does, and
prints rank, median error, share of the drives inside the 80 % interval by third of C_r, and p_fail by bin.
"""

import argparse
import json
import math
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from bumpymap.core import FeatureSettings, Georeference, Reason
from bumpymap.lab.settings import DriveSettings
from bumpymap.lab.simulate.drive import draw_start, drive_strip, follow
from bumpymap.lab.simulate.model import PatchGround, Pose, standing_pose, wheel_inertia
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.terrains import KINDS, make_terrain
from bumpymap.patches import measure
from bumpymap.rating import Calibration, RideModel, TextureModel, Vehicle, classify, rate

STEP_S, SPACING_M = 0.002, 0.1
TORQUE = 4.0
"""Most torque of a wheel over its load times its radius: more than the grip of tyres allows."""
XML = """<mujoco><option timestep="{step}" gravity="0 0 -9.80665" integrator="implicitfast" cone="elliptic"/>
<asset><hfield name="g" nrow="{rows}" ncol="{cols}" size="{east} {north} {tall} 1"/></asset>
<worldbody><geom type="hfield" hfield="g" pos="{x} {y} {low}" friction="0.9 0.005 0.0001"/>
<body name="chassis" pos="0 0 0"><freejoint/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia}"/>
<geom type="box" size="{belly}" pos="0 0 {belly_z}" friction="0.5 0.005 0.0001" mass="0"/>
{rockers}</body></worldbody><actuator>{motors}</actuator></mujoco>"""
ROCKER = """<body pos="0 {left} {down}"><inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia}"/>
<joint type="hinge" axis="0 1 0" stiffness="{stiffness}" damping="{damping}" range="-{limit} {limit}" limited="true"/>
{wheels}</body>"""
WHEEL = """<body pos="{forward} 0 0"><inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia}"/>
<joint name="{name}" type="hinge" axis="0 1 0"/>
<geom type="cylinder" euler="90 0 0" size="{radius} {half}" mass="0" friction="0.9 0.005 0.0001"
 solref="0.03 0.8" solimp="0.8 0.95 0.02"/></body>"""


class SecondVehicle:
    """The vehicle in the second engine, at the start of a strip of ground."""

    def __init__(self, profile, ground, strip):
        import mujoco

        self._engine, self._radius = mujoco, profile.wheel.radius_m
        ends = np.array([[strip.easting, strip.northing]] * 2)
        ends[1] += strip.length * np.array([math.cos(strip.heading), math.sin(strip.heading)])
        low, high = ends.min(axis=0) - strip.half_width - 1.0, ends.max(axis=0) + strip.half_width + 1.0
        low = np.floor(low / SPACING_M) * SPACING_M  # centres of pixels are vertices
        cols, rows = np.ceil((high - low) / SPACING_M).astype(int) + 1
        east, north = np.meshgrid(low[0] + SPACING_M * np.arange(cols), low[1] + SPACING_M * np.arange(rows))
        heights = ground.height(east, north)
        floor, tall = heights.min(), max(float(np.ptp(heights)), 1e-3)
        half = SPACING_M * np.array([cols - 1, rows - 1]) / 2
        text = self._xml(profile).format(
            step=STEP_S, rows=rows, cols=cols, east=half[0], north=half[1], tall=tall, low=floor,
            x=low[0] + half[0], y=low[1] + half[1],
        )  # fmt: skip
        self._model = mujoco.MjModel.from_xml_string(text)
        self._model.hfield_data[:] = ((heights - floor) / tall).ravel()
        self._data = mujoco.MjData(self._model)
        rotation, place = standing_pose(profile, ground, strip)
        self._data.qpos[:3] = place
        mujoco.mju_mat2Quat(self._data.qpos[3:7], rotation.ravel())
        mujoco.mj_forward(self._model, self._data)

    @staticmethod
    def _xml(profile):
        """Return the model, its ground left to fill in."""

        def words(values):
            return " ".join(f"{value:g}" for value in values)

        across, around, _ = wheel_inertia(profile)
        belly, tall = profile.belly, 0.3 * profile.belly.length_m
        bottom = belly.clearance_m - profile.wheel.radius_m - profile.chassis.com_height_m
        weight = 9.80665 * (profile.chassis.mass_kg + 2 * profile.rocker.mass_kg + 4 * profile.wheel.mass_kg)
        torque = TORQUE * weight / 4 * profile.wheel.radius_m
        rockers, motors = "", ""
        for side, left in (("l", profile.track_m / 2), ("r", -profile.track_m / 2)):
            wheels = ""
            for end, forward in (("f", profile.wheelbase_m / 2), ("b", -profile.wheelbase_m / 2)):
                name = side + end
                wheels += WHEEL.format(
                    forward=forward, name=name, mass=profile.wheel.mass_kg, inertia=words((across, around, across)),
                    radius=profile.wheel.radius_m, half=profile.wheel.width_m / 2,
                )  # fmt: skip
                motors += (
                    f'<velocity joint="{name}" kv="{0.5 * torque:g}" forcerange="-{torque:g} {torque:g}" '
                    'forcelimited="true"/>'
                )
            rockers += ROCKER.format(
                left=left, down=-profile.chassis.com_height_m, mass=profile.rocker.mass_kg,
                inertia=words(profile.rocker.inertia_kgm2), stiffness=profile.rocker.stiffness_nm_per_rad,
                damping=profile.rocker.damping_nms_per_rad, limit=math.degrees(profile.rocker.limit_rad), wheels=wheels,
            )  # fmt: skip
        fixed = {
            "mass": profile.chassis.mass_kg,
            "inertia": words(profile.chassis.inertia_kgm2),
            "belly": words((belly.length_m / 2, belly.width_m / 2, tall / 2)),
            "belly_z": bottom + tall / 2,
            "rockers": rockers,
            "motors": motors,
        }
        text = XML
        for key, value in fixed.items():
            text = text.replace("{" + key + "}", str(value))
        return text

    def command(self, left_mps, right_mps):
        """Set the speed of the tyres on either side."""
        self._data.ctrl[:] = np.array([left_mps, left_mps, right_mps, right_mps]) / self._radius

    def advance(self, steps):
        """Simulate time steps with the last commands."""
        self._engine.mj_step(self._model, self._data, steps)

    def pose(self):
        """Return the present state of the chassis."""
        axes = self._data.xmat[1].reshape(3, 3)
        return Pose(
            easting=float(self._data.qpos[0]),
            northing=float(self._data.qpos[1]),
            heading=float(np.arctan2(axes[1, 0], axes[0, 0])),
            tilt=float(np.arccos(np.clip(axes[2, 2], -1.0, 1.0))),
            pitch_rate=float(self._data.qvel[4]),  # of a free joint, in the body's own frame
        )


def terrain_of(profile, seed, kind, index):
    """Make a terrain as the library of a calibration does."""
    scale = profile.wheel.radius_m / 0.3
    return make_terrain(kind, seed, index, height_scale=scale, slope_limit_deg=profile.slope_limit_deg)


def drive_all(given):
    """Drive over every terrain that the file does not hold yet."""
    profile = Vehicle.from_dict(Calibration.shipped(given.vehicle).vehicle, given.vehicle)
    settings = DriveSettings()
    known = {(r["kind"], r["index"]) for r in map(json.loads, given.out.open())} if given.out.exists() else set()
    wanted = [(kind, index) for index in range(given.terrains) for kind in KINDS]
    for kind, index in (one for one in wanted if one not in known):
        ground = PatchGround.from_heights(terrain_of(profile, given.seed, kind, index).heights, 3.0)
        made = []
        for start in range(given.starts):
            rng = np.random.default_rng([given.seed, KINDS.index(kind), index, start])
            strip = drive_strip(profile, draw_start(ground, rng), settings)
            made.append(follow(SecondVehicle(profile, ground, strip), strip, profile, settings))
        row = {
            "vehicle": given.vehicle, "seed": given.seed, "kind": kind, "index": index,
            "c_r": [d.c_r if d.outcome == "completed" else None for d in made], "outcome": [d.outcome for d in made],
        }  # fmt: skip
        with given.out.open("a") as file:
            file.write(json.dumps(row) + "\n")


def report(given):
    """Print how well a map predicts these drives."""
    rows = [json.loads(line) for line in given.report.open()]
    model = RideModel(given.calibration or Calibration.shipped(rows[0]["vehicle"]))
    rate_tiles = partial(rate, calibration=model.calibration) if given.rating == "table" else model.rate
    profile, textures = Vehicle.from_dict(model.calibration.vehicle, "vehicle"), TextureModel.shipped()
    terrains = [terrain_of(profile, row["seed"], row["kind"], row["index"]) for row in rows]
    driven = [[value for value in row["c_r"] if value is not None] for row in rows]
    failed = np.array([1 - len(own) / len(row["c_r"]) for own, row in zip(driven, rows, strict=True)])
    mean = np.array([np.mean(own) if len(own) > 1 else np.nan for own in driven])
    bins = ((0, 0.05), (0.05, 0.3), (0.3, 0.7), (0.7, 1.01))
    rates = []
    print("| points/m² | terrains | Spearman | median error | driven / predicted | drives inside, by third | all |")
    print("|---|---|---|---|---|---|---|")
    for density in map(float, given.densities.split(",")):
        found = np.full((4, len(rows)), np.nan)
        for block in survey_terrains(terrains, density, given.noise, 91).blocks():
            patches = measure(block, FeatureSettings(), ground_only=False)
            rated = rate_tiles(patches, classify(patches, textures), georeference=Georeference(None))
            ok = patches.reason == Reason.OK
            values = (rated.c_r, rated.c_r_low, rated.c_r_high, rated.p_fail)
            found[:, patches.col[ok]] = [value[ok] for value in values]
        known = np.isfinite(found[0]) & np.isfinite(mean) & (failed <= 0.25)
        c_r, low, high, _ = found[:, known]
        truth = mean[known]
        own = [np.array(driven[at]) for at in np.flatnonzero(known)]
        inside = np.array([np.mean((c >= a) & (c <= b)) for c, a, b in zip(own, low, high, strict=True)])
        third = np.searchsorted(np.quantile(truth, [1 / 3, 2 / 3]), truth)
        cells = [f"{density:g}", known.sum(), f"{spearmanr(c_r, truth).statistic:.3f}"]
        cells += [f"{100 * np.median(np.abs(np.log(c_r / truth))):.0f} %", f"{np.median(truth / c_r):.2f}"]
        cells += [" / ".join(f"{inside[third == k].mean():.2f}" for k in range(3)), f"{inside.mean():.2f}"]
        print("| " + " | ".join(map(str, cells)) + " |")
        own = [(found[3] >= first) & (found[3] < last) for first, last in bins]
        shares = (f"{found[3][o].mean():.2f} / {failed[o].mean():.2f} ({o.sum()})" if o.any() else "" for o in own)
        rates.append(f"| {density:g} | {' | '.join(shares)} |")
    print("\n| points/m² | p_fail under 0.05: predicted / driven (terrains) | to 0.3 | to 0.7 | above |")
    print("|---|---|---|---|---|", *rates, sep="\n")


def main():
    """Drive, or report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--report", type=Path)
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--calibration", type=Calibration.load)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--terrains", type=int, default=8)
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--densities", default="100,50")
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--rating", choices=("ride", "table"), default="ride")
    given = parser.parse_args()
    report(given) if given.report else drive_all(given)


if __name__ == "__main__":
    main()
