# SPDX-License-Identifier: Apache-2.0
"""Several cameras, a perception node for each in the camera's namespace.

    ros2 launch imgu_ros cameras.launch.py cameras:=left,right target:=/path/to/poster.png width_m:=0.42

The node of camera `left` is /left/perception; it reads /left/image_raw and /left/camera_info and publishes /left/pose
and so on. On /tf a target is seen by each camera under a name of its own (left/poster, right/poster), for a frame has
one parent. With `targets.poses` in `params_file` every node places its own camera in the map.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription

#: Handed on to perception.launch.py as they are: name, default, description.
SHARED = (
    ("image", "image_raw", "image topic within each camera's namespace"),
    ("transport", "", "raw, or compressed; empty: as params_file says"),
    ("target", "", "image file of the target"),
    ("width_m", "0.0", "printed width of the target, m"),
    ("params_file", "", "parameter file for all of them"),
    ("publish_tf", "", "true: camera -> target on /tf; empty: as params_file says"),
    ("use_sim_time", "", "true: time comes from /clock; empty: as params_file says"),
    ("large_images", "true", "false: without the DDS profile for large images, which the nodes set for themselves"),
)


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    cameras = DeclareLaunchArgument(
        "cameras", default_value="left,right", description="namespaces, with commas between"
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in SHARED
    ]
    return LaunchDescription([cameras, *declared, OpaqueFunction(function=_nodes)])


def _nodes(context):
    shared = {name: LaunchConfiguration(name).perform(context) for name, _, _ in SHARED}
    file = Path(get_package_share_directory("imgu_ros")) / "launch" / "perception.launch.py"
    names = [name.strip() for name in LaunchConfiguration("cameras").perform(context).split(",")]
    if len(set(names)) != len(names) or not all(names):
        raise ValueError(f"cameras: {','.join(names)!r}; need different names with commas between")
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(file)),
            launch_arguments=[
                *shared.items(), ("namespace", name), ("name", "perception"), ("target_prefix", f"{name}/"),
            ],
        )
        for name in names
    ]  # fmt: skip
