# SPDX-License-Identifier: Apache-2.0
"""The node that people write today: rclpy, and OpenCV's ORB, brute force, MAGSAC++ and planar PnP in its callback.

    python benchmarks/orb_node.py poster.png 0.5 --ros-args -r image_raw:=/camera/image_raw

Takes `image_raw` and `camera_info` beside it, as fresh as they come (depth 1), and publishes `orb/pose`. It is what
`live_orb.py` measures beside `imgu node perception`.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image

from imgu_ros.bench.recipes import Recipe, RecipeFeatures
from imgu_ros.config.parameters import TargetsParameters
from imgu_ros.files.target_images import load_target_images
from imgu_ros.messages.frame import decode_frame


class OrbNode(Node):
    """Images in, poses out, all in the callback.

    Parameters
    ----------
    picture : of the target
    width_m : its width
    """

    def __init__(self, picture: Path, width_m: float) -> None:
        super().__init__("orb")
        targets = load_target_images(TargetsParameters(images=(str(picture),), widths_m=(width_m,)))
        self._recipe = Recipe(RecipeFeatures.ORB, targets)
        self._info: CameraInfo | None = None
        self._poses = self.create_publisher(PoseStamped, "orb/pose", 10)
        freshest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        topic = self.resolve_topic_name("image_raw")
        self.create_subscription(Image, topic, self._on_image, freshest)
        self.create_subscription(CameraInfo, topic.rpartition("/")[0] + "/camera_info", self._on_info, freshest)

    def _on_info(self, info: CameraInfo) -> None:
        self._info = info

    def _on_image(self, image: Image) -> None:
        for answer in self._recipe.answer(decode_frame(image, self._info, rectified=False)).answers:
            if answer.pose is None:
                continue
            message = PoseStamped(header=image.header)
            position, orientation = message.pose.position, message.pose.orientation
            position.x, position.y, position.z = answer.pose.t.tolist()
            orientation.x, orientation.y, orientation.z, orientation.w = Rotation.from_matrix(answer.pose.R).as_quat()
            self._poses.publish(message)


def main() -> int:
    """Spin until the process is asked to stop."""
    _, picture, width_m, *_ = remove_ros_args(sys.argv)
    rclpy.init(args=sys.argv)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OrbNode(Path(picture), float(width_m)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
