# SPDX-License-Identifier: Apache-2.0
"""Calibrations, parameter files and metadata.yaml: seeds, and mutations of lines, tokens and YAML's own means."""

from __future__ import annotations

import re
from functools import cache

from fuzz.mutation import Rng, chance, choice, mangled, text

_TOKEN = re.compile(rb"[^\s:,\[\]{}]+")

_ROS = b"""\
image_width: 640
image_height: 480
camera_name: camera
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0, 320, 0, 500, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0]}
calibration_covariance: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
"""
_OPENCV = b"""\
%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.0e+02, 0., 3.2e+02, 0., 5.0e+02, 2.4e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.0e-01, 0., 0., 0., 0. ]
"""
_ECHO = b"""\
header:
  stamp: {sec: 1, nanosec: 2}
  frame_id: camera
height: 480
width: 640
distortion_model: equidistant
d: [0.1, 0.0, 0.0, 0.0]
k: [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
"""
_KALIBR = b"""\
cam0:
  camera_model: pinhole
  intrinsics: [500.0, 500.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.0, 0.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""
_ORB_SLAM = b"""\
%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 500.0
Camera.fy: 500.0
Camera.cx: 320.0
Camera.cy: 240.0
Camera.k1: 0.1
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0
Camera.width: 640
Camera.height: 480
"""
_INI = b"""\
# a calibration
[image]
width
640
height
480
[camera]
camera matrix
500.0 0.0 320.0
0.0 500.0 240.0
0.0 0.0 1.0
distortion
0.1 0.0 0.0 0.0 0.0
rectification
1 0 0
0 1 0
0 0 1
projection
500.0 0.0 320.0 0.0
0.0 500.0 240.0 0.0
0.0 0.0 1.0 0.0
"""
_PARAMETERS = b"""\
/**:
  ros__parameters:
    targets:
      images: ["a.png", "b.png"]
      widths_m: [0.2, 0.3]
    raw: {significant_bits: 12, black_level: 64.0}
    seed: 7
    image_transport: raw
/cameras/*:
  perception:
    ros__parameters: &anchor
      homography.threshold_px: 2.5
      limits.picture_mb: 100
perception:
  ros__parameters:
    image_topic: "/camera/image_raw"
    publish_tf: yes
"""
_METADATA = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: {storage}
  duration:
    nanoseconds: 3000000000
  starting_time:
    nanoseconds_since_epoch: 100000000005
  message_count: 18
  topics_with_message_count:
    - topic_metadata: {{name: /text, type: std_msgs/msg/String, serialization_format: cdr, offered_qos_profiles: []}}
      message_count: 3
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
{names}
  files:
{files}
"""


def metadata(names: list[str], storage: str) -> bytes:
    """Return the metadata.yaml of files of 18 messages each."""
    times = "      starting_time: {{nanoseconds_since_epoch: 1}}\n      duration: {{nanoseconds: 9}}\n"
    entry = "    - path: {}\n" + times + "      message_count: 18"
    return _METADATA.format(
        storage=storage,
        names="\n".join(f"    - {name}" for name in names),
        files="\n".join(entry.format(name) for name in names),
    ).encode()


def camera_seeds() -> tuple[bytes, ...]:
    """Return calibrations in every format that is read."""
    return (_ROS, _OPENCV, _ECHO, _KALIBR, _ORB_SLAM, _INI)


@cache
def parameter_seeds() -> tuple[bytes, ...]:
    """Return parameter files: one by hand, and one with every parameter."""
    from imgu_ros.config.files import parameter_file_text

    return (_PARAMETERS, parameter_file_text().encode())


_TOKENS = (
    b"1" * 400, b"-" + b"9" * 400, b"1e400", b"-1e400", b"1e-400", b".nan", b".inf", b"-.inf", b"0x" + b"f" * 300,
    b"0o17", b"1_000", b"010", b"1:30:00", b"2001-01-01", b"2001-99-99", b"~", b"null", b"true", b"NO", b"''",
    b'"\\x1b[31m"', b'"\\u0000"', b"!!python/object:os.system [a]", b"!!binary ====", b"!!timestamp x", b"!!float a",
    b"!!int x", b"!!set {a}", b"!!python/tuple [1]", b"*unknown", b"&a [*a]", b"[[[[[[1]]]]]]", b"{}", b"[]",
    b"{? a}", b"-1", b"0", b"4294967296", b"9223372036854775808", b"1.7976931348623159e308", b"5e-324", b"=1+1",
    b"x" * 5000, b"\xff", b"\xed\xa0\x80", b"\xc2\x85", b"...", b"---", b"%TAG ! x", b"<<: {a: 1}", b"|", b">-",
    b"@a", b"`", b"/**", b"../../x", b"1.0.0", b"1e3", b"NaN", b"inf",
)  # fmt: skip


def bomb(levels: int = 9, width: int = 9, name: bytes = b"bomb") -> bytes:
    """Return lists of aliases of lists: width ** levels items from a few lines."""
    lines = [name + b"0: &b0 [x, x]"]
    for i in range(1, levels):
        aliases = b", ".join([b"*b%d" % (i - 1)] * width)
        lines.append(name + b"%d: &b%d [%s]" % (i, i, aliases))
    return b"\n".join(lines) + b"\n"


def mutate(rng: Rng, data: bytes) -> bytes:
    """Return a text with one mutation more."""
    lines = data.split(b"\n")
    i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    roll = int(rng.integers(16))
    if roll <= 5:
        tokens = list(_TOKEN.finditer(data))
        if not tokens:
            return mangled(rng, data)
        old = choice(rng, tokens)
        new = choice(rng, _TOKENS) if chance(rng, 0.85) else text(rng, old.group())
        return data[: old.start()] + new + data[old.end() :]
    if roll == 6:
        lines.insert(i, lines[j])
    elif roll == 7:
        del lines[i]
    elif roll == 8:
        lines[i], lines[j] = lines[j], lines[i]
    elif roll == 9:
        lines[i] = choice(rng, (b"  ", b"\t", b"- ", b"? ", b"# ")) + lines[i]
    elif roll == 10:
        lines[i] = lines[i].lstrip()
    elif roll == 11:
        lines.insert(i, bomb(choice(rng, (3, 9, 30))))
    elif roll == 12:
        depth = choice(rng, (50, 1000, 20_000))
        lines.insert(i, b"deep: " + choice(rng, (b"[", b"{a: ", b"- ")) * depth)
    elif roll == 13:
        lines[i] += b" " + choice(rng, _TOKENS)
    elif roll == 14:
        whole = data.decode("latin-1")
        return choice(
            rng, (b"\xef\xbb\xbf" + data, whole.encode("utf-16"), data.replace(b"\n", b"\r\n"), data * 2, data + b"\0")
        )
    else:
        return mangled(rng, data)
    return b"\n".join(lines)
