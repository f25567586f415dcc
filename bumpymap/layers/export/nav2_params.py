"""The parameters of Nav2 that load a map and its masks, as YAML."""

import math

from bumpymap.core import RouteVehicle
from bumpymap.layers.export.area import FRAME
from bumpymap.layers.export.values import DEAREST, LETHAL, CostScale

__all__ = ["params_text", "travel_multiplier"]

_COSTMAP_LETHAL, _SMAC_FULL = 254, 252
"""Cost of a lethal cell of a costmap; the cost by which Smac planners divide."""

_TEXT = """\
# Parameters of Nav2 that load this export. Merge them into those of your robot; the frame is "{frame}".
# yaml_filename: give the full path of each file. Both costmaps want the same settings of costs and filters.
map_server:
  ros__parameters:
    yaml_filename: "map.yaml"
    topic_name: "map"
    frame_id: "{frame}"

keepout_mask_server:
  ros__parameters:
    yaml_filename: "keepout_mask.yaml"
    topic_name: "keepout_mask"
    frame_id: "{frame}"

keepout_info_server:
  ros__parameters:
    type: 0
    filter_info_topic: "keepout_info"
    mask_topic: "keepout_mask"
    base: 0.0
    multiplier: 1.0

speed_mask_server:
  ros__parameters:
    yaml_filename: "speed_mask.yaml"
    topic_name: "speed_mask"
    frame_id: "{frame}"

# Type 1: the mask holds percent of the controller's own top speed. It was made for {speed!r} m/s.
speed_info_server:
  ros__parameters:
    type: 1
    filter_info_topic: "speed_info"
    mask_topic: "speed_mask"
    base: 0.0
    multiplier: 1.0

lifecycle_manager_bumpymap:
  ros__parameters:
    autostart: true
    node_names: ["map_server", "keepout_mask_server", "keepout_info_server", "speed_mask_server", "speed_info_server"]

global_costmap:
  global_costmap:
    ros__parameters:
      global_frame: "{frame}"
      resolution: {resolution!r}
      robot_radius: {radius!r}
      # Without the next four lines all graded cost becomes free, and unknown ground too.
      trinary_costmap: false
      lethal_cost_threshold: {lethal}
      unknown_cost_value: 255
      track_unknown_space: true
      plugins: ["static_layer", "inflation_layer"]
      filters: ["keepout_filter", "speed_filter"]
      static_layer:
        plugin: "nav2_costmap_2d::StaticLayer"
        map_topic: "map"
        map_subscribe_transient_local: true
      # No farther than the robot is wide: a wider slope of inflated cost would hide the cost of the ground.
      inflation_layer:
        plugin: "nav2_costmap_2d::InflationLayer"
        inflation_radius: {radius!r}
        cost_scaling_factor: 10.0
      keepout_filter:
        plugin: "nav2_costmap_2d::KeepoutFilter"
        enabled: true
        filter_info_topic: "keepout_info"
      speed_filter:
        plugin: "nav2_costmap_2d::SpeedFilter"
        enabled: true
        filter_info_topic: "speed_info"
        speed_limit_topic: "speed_limit"

controller_server:
  ros__parameters:
    speed_limit_topic: "speed_limit"

# With this multiplier the planner's cost of a cell is bumpymap's: 1 on smooth, safe ground, {dearest!r} at value {top}.
planner_server:
  ros__parameters:
    planner_plugins: ["GridBased"]
    GridBased:
      plugin: "nav2_smac_planner::SmacPlanner2D"
      allow_unknown: false
      cost_travel_multiplier: {multiplier!r}
"""


def travel_multiplier(scale: CostScale) -> float:
    """Return the ``cost_travel_multiplier`` with which the Smac 2D planner counts cost per metre as the map does.

    The costmap scales 0..100 to 0..254 and drops decimals; the planner's cost of a step is
    ``length * (1 + multiplier * cell / 252)``.
    """
    return (scale.dearest - 1.0) * _SMAC_FULL / math.floor(DEAREST / LETHAL * _COSTMAP_LETHAL)


def params_text(vehicle: RouteVehicle, scale: CostScale, resolution: float) -> str:
    """Return the parameters as YAML."""
    return _TEXT.format(
        frame=FRAME,
        speed=vehicle.speed_mps,
        resolution=resolution,
        radius=round(vehicle.width_m / 2.0, 3),
        lethal=LETHAL,
        dearest=round(scale.dearest, 6),
        top=DEAREST,
        multiplier=round(travel_multiplier(scale), 6),
    )
