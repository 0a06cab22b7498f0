# SPDX-License-Identifier: Apache-2.0
"""A launch file of a user, with parameters written in it in every way that launch_ros offers."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, SetParameter
from launch_ros.descriptions import Parameter
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

from launch import LaunchDescription


def generate_launch_description():
    """Return two nodes: one with a name, one without."""
    named = Node(
        package="imgu_ros",
        executable="imgu",
        name="perception",
        namespace="robot/left",
        arguments=["node", "perception"],
        parameters=[
            # Strings, doubles, integers, booleans; one and several; lists within groups.
            {
                "targets.images": [
                    "poster.png",
                    f"a long name of a picture, {'with commas and spaces, ' * 3}: folded.png",
                ]
            },
            {"targets": {"widths_m": [0.594, 1e-05], "names": ("poster", "second")}, "raw": {"bands": [0, 2, 1]}},
            {"seed": 7, "publish_tf": False, "pose": {"ambiguity_ratio": 1e-3}, "raw.black_level": 64.0},
            {"frames.map": "mäp", "frames.camera": "", "frames.target_prefix": "on_"},
            {"homography.threshold_px": LaunchConfiguration("threshold"), "compressed": {"jpeg_quality": 80}},
            {"targets.poses": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, -2.5, 0.0, 0.0, 0.0, 0.0, 1.0]},
            Parameter("tracking.search_every", 3),
            Parameter("raw.gains", [1.5, 1.0, 2.0]),
            ParameterFile(PathJoinSubstitution([LaunchConfiguration("folder"), "perception.yaml"]), allow_substs=True),
        ],
        remappings=[("image_raw", "/camera/image_raw")],
        ros_arguments=["--log-level", "info"],
    )
    nameless = Node(
        package="imgu_ros",
        executable="imgu",
        arguments=["node", "perception"],
        parameters=[
            # One value where a list is declared: launch_ros joins the parts of the text.
            {"targets.images": [LaunchConfiguration("folder"), "/poster.png"], "targets.widths_m": 1.0},
            {"frames.map": ParameterValue(LaunchConfiguration("threshold"), value_type=str)},
        ],
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("threshold", default_value="2"),
            DeclareLaunchArgument("folder", default_value="."),
            SetParameter("use_sim_time", True),
            named,
            nameless,
        ]
    )
