"""Start the perception node beside a camera.

    ros2 launch imgu_ros perception.launch.py namespace:=camera target:=/path/to/poster.png width_m:=0.42
    ros2 launch imgu_ros perception.launch.py params_file:=perception.yaml image:=/camera/image_raw

The DDS profile for large images is on for this node; turn it on for the camera's driver too
(FASTRTPS_DEFAULT_PROFILES_FILE).
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    share = Path(get_package_share_directory("imgu_ros"))
    return LaunchDescription([
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
        DeclareLaunchArgument("image", default_value="image_raw", description="image topic"),
        DeclareLaunchArgument("target", default_value="", description="picture file of the target"),
        DeclareLaunchArgument("width_m", default_value="0.0", description="printed width of the target; 0: unknown"),
        DeclareLaunchArgument("params_file", default_value="", description="parameter file"),
        DeclareLaunchArgument("large_images", default_value="true", description="use the DDS profile for large images"),
        SetEnvironmentVariable(
            "FASTRTPS_DEFAULT_PROFILES_FILE",
            str(share / "config" / "fastdds_large_images.xml"),
            condition=IfCondition(LaunchConfiguration("large_images")),
        ),
        OpaqueFunction(function=_node),
    ])  # fmt: skip


def _node(context):
    def given(name):
        return LaunchConfiguration(name).perform(context)

    parameters = [given("params_file")] if given("params_file") else []
    if given("target"):
        parameters.append({"targets.images": [given("target")], "targets.widths_m": [float(given("width_m"))]})
    return [
        Node(
            package="imgu_ros",
            executable="imgu",
            arguments=["node", "perception"],
            namespace=given("namespace"),
            parameters=parameters,
            remappings=[("image_raw", given("image"))],
            output="screen",
        )
    ]
