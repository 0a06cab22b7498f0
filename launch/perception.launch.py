# SPDX-License-Identifier: Apache-2.0
"""Start the perception node beside a camera.

    ros2 launch imgu_ros perception.launch.py image:=/camera/image_raw target:=/path/to/poster.png width_m:=0.42
    ros2 launch imgu_ros perception.launch.py namespace:=camera params_file:=basic.yaml rviz:=true

A parameter file begins as a copy of `share/imgu_ros/config/basic.yaml`, the parameters to start with
(`imgu params --basic --yaml` prints it); `perception.yaml` beside it holds all.
`ros2 launch imgu_ros perception.launch.py --show-args` lists the arguments. The node sets the DDS profile for large
images for itself; the camera's driver needs it too: `imgu node --print-dds-profile` prints the file that its
FASTRTPS_DEFAULT_PROFILES_FILE must name.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

#: Name, default, description.
ARGUMENTS = (
    ("namespace", "", "namespace of the node and of its topics"),
    ("name", "perception", "name of the node"),
    ("image", "image_raw", "image topic; camera_info is in the same namespace"),
    ("camera_info", "", "camera_info topic, if it is not beside the image topic"),
    ("transport", "", "raw, or compressed: then <image>/compressed is read; empty: as params_file says"),
    ("target", "", "image file of the target"),
    ("width_m", "0.0", "printed width of the target, m; 0: unknown, and no metric pose"),
    ("params_file", "", "parameter file; the other arguments come after it"),
    ("publish_tf", "", "true: camera -> target, and map -> root with targets.poses; empty: as params_file says"),
    ("target_prefix", "", "prefix of the targets' frame names; empty: as params_file says"),
    ("use_sim_time", "", "true: time comes from /clock; empty: as params_file says"),
    ("large_images", "true", "false: without the DDS profile for large images, which the node sets for itself"),
    ("log_level", "info", "debug, info, warn, error"),
    ("rviz", "false", "true: start RViz too"),
    ("fixed_frame", "", "RViz's fixed frame; empty: the target's, or the map"),
)  # fmt: skip


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    share = Path(get_package_share_directory("imgu_ros"))
    parameters = {}
    # launch_ros takes texts for YAML (`on`, `007`, `a: b`) unless their type is given.
    if given["transport"]:
        parameters["image_transport"] = ParameterValue(given["transport"], value_type=str)
    for name in ("use_sim_time", "publish_tf"):
        if given[name]:
            parameters[name] = _is_true(given, name)
    if given["target"]:
        parameters["targets.images"] = ParameterValue([given["target"]], value_type=list[str])
        parameters["targets.widths_m"] = [_number(given, "width_m")]
    if given["target_prefix"]:
        parameters["frames.target_prefix"] = ParameterValue(given["target_prefix"], value_type=str)
    remappings = [("image_raw", given["image"])]
    if given["camera_info"]:
        remappings.append(("camera_info", given["camera_info"]))
    perception = Node(
        package="imgu_ros",
        executable="imgu",
        arguments=["node", "perception"],
        name=given["name"],
        namespace=given["namespace"],
        parameters=[*filter(None, [_file(given, "params_file"), parameters])],
        remappings=remappings,
        ros_arguments=["--log-level", given["log_level"]],
        additional_env={} if _is_true(given, "large_images") else {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"},
        output="screen",
    )
    return [perception, *([_rviz(given, share)] if _is_true(given, "rviz") else [])]


def _rviz(given, share):
    frame = given["fixed_frame"] or (given["target_prefix"] + Path(given["target"]).stem if given["target"] else "map")
    # Topics in the file are relative: RViz looks for them in its own namespace.
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=given["namespace"],
        arguments=["-d", str(share / "config" / "perception.rviz"), "-f", frame],
        parameters=[{"use_sim_time": given["use_sim_time"] == "true"}],
    )


def _file(given, name):
    """Return the path of a file; launch_ros would leave out one that is not there, with a warning."""
    path = Path(given[name]).expanduser()
    if given[name] and not path.is_file():
        raise ValueError(f"{name}: {given[name]!r}: no such file; need a parameter file")
    return str(path) if given[name] else ""


def _is_true(given, name):
    text = given[name].lower()
    if text not in ("true", "false"):
        raise ValueError(f"{name}: {given[name]!r}; need true or false")
    return text == "true"


def _number(given, name):
    try:
        return float(given[name])
    except ValueError:
        raise ValueError(f"{name}: {given[name]!r}; need a number") from None
