# SPDX-License-Identifier: Apache-2.0
"""What the commands on the pages read, under the names that the pages use: simulated, small."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from scipy.spatial.transform import Rotation

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.files.camera_info_file import camera_info_text
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.simulate.chessboard import draw_chessboard, random_chessboard_view
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence
from imgu_ros.vision.camera.chessboard import Chessboard
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "pipeline"))
import marker_scenes

WIDTH, HEIGHT, WIDTH_M = 640, 480, 0.594


def make(folder: Path) -> None:
    """Write everything into a folder."""
    for name, seed in {"poster": 0, "label_a": 1, "label_b": 2}.items():
        write_image(folder / f"{name}.png", default_targets(1, seed=seed)[0].pixels)
    command = ["simulate", "--out", str(folder / "BAG"), "--size", f"{WIDTH}x{HEIGHT}", "--frames", "12"]
    assert main([*command, "--template", str(folder / "poster.png"), "--width-m", str(WIDTH_M)]) == 0
    simulation = Simulation(WIDTH, HEIGHT, 12, layout=PixelLayout(ColorModel.RGB))
    targets = default_targets(1, seed=0, width_m=WIDTH_M)
    frames = [simulated.frame for simulated in simulate_sequence(simulation, targets)]
    camera = frames[0].camera
    assert camera is not None
    (folder / "camera.yaml").write_text(camera_info_text(camera))
    video(folder / "poster.mp4", (frame.image.pixels for frame in frames))
    write_image(folder / "photo.jpg", frames[4].image.pixels)
    mosaic = next(iter(simulate_sequence(Simulation(WIDTH, HEIGHT, 1), targets))).frame
    write_image(folder / "raw.pgm", mosaic.image.pixels)
    views = list(chessboards(camera, 12))
    (folder / "pictures").mkdir()
    for index, view in enumerate(views):
        write_image(folder / "pictures" / f"view_{index:02}.png", view)
    video(folder / "chessboard.mp4", (np.repeat(view[..., None], 3, axis=2) for view in views for _ in range(2)))
    with BagWriter(folder / "chessboard", "mcap") as bag:
        for index, view in enumerate(views):
            # A mosaic that its driver calls grey.
            image = image_message(make_message, Header(10**9 + index * 10**8, "camera"), view, "mono8")
            bag.write("/camera/image_raw", image, 10**9 + index * 10**8)
    station(folder / "station", 24)


def video(path: Path, pictures: Iterable[np.ndarray], rate: int = 15) -> None:
    """Write a video of pictures, (H, W, 3) uint8 RGB."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.bit_rate, stream.time_base = 20_000_000, Fraction(1, rate)
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")))
        container.mux(stream.encode())


def chessboards(camera: Camera, count: int) -> Iterable[np.ndarray]:
    """Yield views of a chessboard, (H, W) uint8."""
    board, rng = Chessboard(9, 6, 0.022), np.random.default_rng(5)
    for _ in range(count):
        yield draw_chessboard(board, camera, random_chessboard_view(board, camera, rng).pose, 1.0, rng)


def station(path: Path, count: int) -> None:
    """Write a bag of a box with five tags, seen while a camera goes around it."""
    turns = {0: (0, 0), 1: (90, 0), 2: (-90, 0), 3: (0, 90), 4: (0, -90)}
    places = {}
    for number, (yaw, pitch) in turns.items():
        R = Rotation.from_euler("YX", (yaw, pitch), degrees=True).as_matrix()
        places[number] = RigidTransform(R, R @ np.array((0, 0, 0.06)))
    with BagWriter(path, "mcap") as bag:
        for index in range(count):
            a = 2 * math.pi * index / count
            R = Rotation.from_euler("XY", (180 + 40 * math.sin(a), 42 * math.cos(a)), degrees=True).as_matrix()
            camera = RigidTransform(R, np.array((0.02 * math.sin(a), 0.01, 0.55 + 0.05 * math.cos(2 * a))))
            light = marker_scenes.scene()
            for number, place in places.items():
                at = camera.after(place)
                if at.R[:, 2] @ at.t < 0:
                    sheet = marker_scenes.sheet([PlacedMarker("tag36h11", number, 0.08)])
                    marker_scenes.put_sheet(light, *sheet, at.R, at.t)
            frame = marker_scenes.exposed(light, index, index=index)
            header = Header(frame.stamp_ns, "camera")
            info = camera_info_message(make_message, header, marker_scenes.CAMERA)
            bag.write("/camera/camera_info", info, frame.stamp_ns)
            image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
            bag.write("/camera/image_raw", image, frame.stamp_ns)
