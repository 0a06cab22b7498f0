# SPDX-License-Identifier: Apache-2.0
"""Play a bag through the perception node, by the bag's own time.

    ros2 launch imgu_ros replay.launch.py bag:=/path/to/bag image:=/camera/image_raw target:=poster.png width_m:=0.42

The bag starts when the node has subscribed to the images, which it does when one of its outputs has a subscriber: RViz
(`rviz:=true`), Foxglove, `ros2 topic echo /pose`, or `publish_tf:=true`. For numbers, pictures and a report without any
of this: `imgu replay BAG --out DIR`.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

#: Handed on to perception.launch.py as they are: name, default, description.
SHARED = (
    ("image", "image_raw", "image topic in the bag"),
    ("camera_info", "", "camera_info topic in the bag, if it is not beside the image topic"),
    ("transport", "", "raw, or compressed; empty: as params_file says"),
    ("target", "", "image file of the target"),
    ("width_m", "0.0", "printed width of the target, m"),
    ("params_file", "", "parameter file"),
    ("publish_tf", "", "true: camera -> target on /tf; empty: as params_file says"),
    ("rviz", "false", "true: start RViz, too"),
    ("fixed_frame", "", "RViz's fixed frame; empty: the target's, or the map"),
)


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    own = [
        DeclareLaunchArgument("bag", description="the bag: its folder, or its file"),
        DeclareLaunchArgument("rate", default_value="1.0", description="times the recorded speed"),
        DeclareLaunchArgument("loop", default_value="false", description="true: start over at the end"),
    ]
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in SHARED
    ]
    return LaunchDescription([*own, *declared, OpaqueFunction(function=_processes)])


def _processes(context):
    shared = {name: LaunchConfiguration(name).perform(context) for name, _, _ in SHARED}
    share = Path(get_package_share_directory("imgu_ros"))
    loop = LaunchConfiguration("loop").perform(context).lower() == "true"
    # The recording's own topics, by their recorded names: only the node is remapped.
    player = Node(
        package="imgu_ros",
        executable="imgu",
        arguments=[
            "play",
            LaunchConfiguration("bag").perform(context),
            "--wait-for",
            "1",
            "--rate",
            LaunchConfiguration("rate").perform(context),
            *(["--loop"] if loop else []),
        ],
        output="screen",
    )
    perception = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(share / "launch" / "perception.launch.py")),
        launch_arguments=[*shared.items(), ("use_sim_time", "true")],
    )
    return [perception, player]
