# SPDX-License-Identifier: Apache-2.0
"""Simulate a calibrated camera that moves before printed pictures, and write what it sees as a bag.

Writes into BAG: a rosbag2 with /camera/image_raw and /camera/camera_info, the template images, truth.csv (the exact
homography and pose of every target in every frame), exposure.csv (how bright every frame is) and params.yaml, so that

    imgu replay BAG --params-file BAG/params.yaml --truth BAG/truth.csv --out DIR

works at once. The same options and seed give the same frames.
"""

from __future__ import annotations

import argparse
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.terminal import say, warn

if TYPE_CHECKING:
    from imgu_ros.reference.templates import TargetImage
    from imgu_ros.replay.recording import BagFormat
    from imgu_ros.simulate.capture import Capture
    from imgu_ros.simulate.sequence import Simulation
    from imgu_ros.vision.camera.intrinsics import Camera

HELP = "write a bag of a simulated camera with exact ground truth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    # fmt: off
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="BAG", help="folder of the bag: new or empty")
    add("--overwrite", action="store_true", help="replace the files of an earlier simulation in BAG, nothing else")
    add("--seed", type=int, default=0, help="of texture, path and noise (default 0)")

    group = parser.add_argument_group("sequence")
    add = group.add_argument
    add("--size", type=_size, default=(1280, 720), metavar="WxH", help="image size (default 1280x720)")
    add("--frames", type=int, default=60, metavar="N", help="frames in the sequence (default 60)")
    add("--rate", type=float, default=15.0, metavar="HZ", help="frames a second (default 15)")
    add("--tilt", type=float, default=35.0, metavar="DEG", help="largest tilt of the camera (default 35)")
    add("--zoom", type=float, default=2.4, metavar="RATIO", help="largest over smallest distance (default 2.4)")
    add("--turns", type=float, default=1.0, metavar="N", help="turns in the image plane (default 1)")
    add("--distortion", default="none",
        choices=("none", "plumb_bob", "rational_polynomial", "equidistant", "thin_prism", "tilted"),
        help="give the camera a typical lens of that model (default none)")

    add("--view-deg", type=float, metavar="DEG",
        help="horizontal angle of view, which sets the focal length (default 61)")

    group = parser.add_argument_group("targets")
    add = group.add_argument
    add("--template", type=Path, action="append", default=[], metavar="FILE",
        help="picture to print; repeat for several targets (default: a procedural one)")
    add("--targets", type=int, metavar="N", help="number of procedural pictures (default 1)")
    add("--width-m", type=float, default=0.5, metavar="M", help="printed width of each (default 0.5)")

    group = parser.add_argument_group("sensor")
    add = group.add_argument
    add("--pattern", metavar="NAME", help="Bayer pattern: rggb (default), bggr, grbg, gbrg")
    add("--bits", type=int, metavar="N",
        help="8 (default), 10, 12, 14, 16; more than 8 are right-aligned in a 16-bit encoding")
    add("--encoding", metavar="NAME", help="bayer_<pattern>{8,16}, mono8, mono16, rgb8, rgb16, bgr8 or bgr16 instead")
    add("--full-well", type=float, default=10_000.0, metavar="E", help="electrons that saturate (default 10000)")
    add("--read-noise", type=float, default=4.0, metavar="E", help="electrons (default 4)")
    add("--black-level", type=float, default=0.0, metavar="DN", help="digital number of no light (default 0)")
    add("--sensitivities", type=_numbers, default=(1.0, 1.0, 1.0), metavar="R,G,B",
        help="of red, green and blue pixels of a Bayer pattern without white balance, as 0.5,1,0.65 (default 1,1,1)")
    add("--transfer", choices=("linear", "srgb", "film"), default="linear",
        help="curve from the signal to the values that are quantised; film: with toe and shoulder (default linear)")

    group = parser.add_argument_group(
        "shutter, lens and exposure",
        "Stamp and truth of a frame are of the middle of the exposure of the middle of the picture.\nA blurred frame "
        "is the mean of many sharp ones: it takes as many times longer.",
    )
    add = group.add_argument
    add("--exposure-ms", type=float, default=0.0, metavar="MS",
        help="time for which each row is exposed while the camera moves on: motion blur (default 0, an instant)")
    add("--row-time-us", type=float, default=0.0, metavar="US",
        help="rolling shutter: from one row to the next; negative from the bottom up (default 0, global shutter)")
    add("--defocus-px", type=float, default=0.0, metavar="PX", help="diameter of the disc that every point becomes")
    add("--f-number", type=float, metavar="N",
        help="thin lens of this aperture, whose blur depends on the depth (default: a pinhole)")
    add("--focus-m", type=float, metavar="M",
        help="depth that the lens is focused at (default: the targets' centre, in every frame)")
    add("--pixel-pitch-um", type=float, metavar="UM",
        help="distance of pixels on the sensor, which makes the f-number an aperture (default 3.45)")
    add("--ev", type=_numbers, default=(0.0,), metavar="EV[,EV...]",
        help="exposure compensation in stops; several, as in --ev=-1,0,1: of successive equal parts of the sequence")
    add("--saturated", type=float, metavar="SHARE",
        help="expose each frame so that this share of its pixels is at the white level, as 0.02 (default: by --ev)")

    group = parser.add_argument_group("bag")
    add = group.add_argument
    add("--row-padding", type=int, default=0, metavar="BYTES", help="added to each row (default 0)")
    add("--big-endian", action="store_true", help="most significant byte first")
    add("--storage", choices=("mcap", "sqlite3"), default="mcap", help="default mcap")
    add("--compression", choices=("none", "zstd"), default="none", help="default none")
    # fmt: on


def run(arguments: argparse.Namespace) -> int:
    """Simulate, and say what to do with the result."""
    from imgu_ros.cli.progress import Progress
    from imgu_ros.replay.recording import PARAMETER_FILE, TRUTH_FILE, record_simulation

    bag_format = _format(arguments)
    simulation = _simulation(arguments, bag_format)
    targets = _targets(arguments)
    with Progress("simulate") as progress:
        truths = record_simulation(
            arguments.out, simulation, bag_format, targets, overwrite=arguments.overwrite, on_progress=progress
        )
    out = arguments.out
    say(
        f"{out}: {simulation.frames} frames of {simulation.width}x{simulation.height}, {bag_format.encoding}; "
        f"{len(targets)} target{'s' * (len(targets) > 1)}, {len(truths)} true poses"
    )
    if simulation.capture.f_number:
        from imgu_ros.simulate.lens import described_lens
        from imgu_ros.simulate.sequence import camera_of

        say(*described_lens(simulation.capture, camera_of(simulation)).split("\n"))
    say(f"imgu replay {out} --params-file {out / PARAMETER_FILE} --truth {out / TRUTH_FILE} --out DIR")
    return 0


def _format(arguments: argparse.Namespace) -> BagFormat:
    """Reconcile --pattern, --bits and --encoding."""
    from imgu_ros.errors import ParameterError
    from imgu_ros.replay.recording import BagFormat
    from imgu_ros.vision.formation.cfa import BayerPattern

    if arguments.pattern is not None and arguments.pattern not in list(BayerPattern):
        raise ParameterError(f"pattern: {arguments.pattern!r}; need one of {', '.join(BayerPattern)}")
    encoding = arguments.encoding
    if encoding is None:
        encoding = f"bayer_{arguments.pattern or 'rggb'}{16 if (arguments.bits or 8) > 8 else 8}"
    elif arguments.pattern is not None and not encoding.startswith(f"bayer_{arguments.pattern}"):
        raise ParameterError(f"pattern: {arguments.pattern!r} with encoding {encoding}; need one of them, or the same")
    return BagFormat(encoding, arguments.row_padding, arguments.big_endian, arguments.storage, arguments.compression)


def _simulation(arguments: argparse.Namespace, bag_format: BagFormat) -> Simulation:
    from imgu_ros.errors import ParameterError
    from imgu_ros.replay.recording import simulated_encoding
    from imgu_ros.simulate.path import CameraMotion
    from imgu_ros.simulate.sequence import Simulation, check_simulation
    from imgu_ros.vision.formation.sensor import Sensor

    encoding = simulated_encoding(bag_format.encoding)
    bits = arguments.bits if arguments.bits is not None else 8 * encoding.dtype.itemsize
    if arguments.seed < 0:
        raise ParameterError(f"seed: {arguments.seed}; need 0 or more")
    simulation = Simulation(
        width=arguments.size[0],
        height=arguments.size[1],
        frames=arguments.frames,
        rate_hz=arguments.rate,
        seed=arguments.seed,
        layout=encoding.layout,
        sensor=Sensor(bits, arguments.full_well, arguments.read_noise, arguments.black_level),
        motion=CameraMotion(turns=arguments.turns, tilt_rad=math.radians(arguments.tilt), zoom=arguments.zoom),
        camera=_camera(arguments),
        capture=_capture(arguments),
    )
    check_simulation(simulation)  # before pictures are made, which takes a while
    return simulation


def _capture(arguments: argparse.Namespace) -> Capture:
    from imgu_ros.errors import ParameterError
    from imgu_ros.simulate.capture import Capture
    from imgu_ros.vision.formation.transfer import TransferFunction

    if arguments.f_number is not None and not arguments.f_number > 0:
        raise ParameterError(f"f-number: {arguments.f_number:g}; need more than 0")
    if arguments.pixel_pitch_um is not None and arguments.f_number is None:
        raise ParameterError(f"pixel pitch: {arguments.pixel_pitch_um:g} um without an f-number; need both")
    return Capture(
        exposure_s=arguments.exposure_ms * 1e-3,
        row_time_s=arguments.row_time_us * 1e-6,
        defocus_px=arguments.defocus_px,
        f_number=arguments.f_number or 0.0,
        focus_m=arguments.focus_m,
        pitch_m=Capture().pitch_m if arguments.pixel_pitch_um is None else arguments.pixel_pitch_um * 1e-6,
        ev=arguments.ev,
        saturated=arguments.saturated,
        sensitivities=arguments.sensitivities,
        transfer=TransferFunction(arguments.transfer),
    )


def _camera(arguments: argparse.Namespace) -> Camera | None:
    from imgu_ros.errors import ParameterError
    from imgu_ros.simulate.sequence import TYPICAL_LENSES, default_camera
    from imgu_ros.vision.camera.intrinsics import DistortionModel

    view = None if arguments.view_deg is None else math.radians(arguments.view_deg)
    if view is not None and not math.radians(1) <= view <= math.radians(150):
        raise ParameterError(f"view: {arguments.view_deg:g} deg; need 1 to 150")
    width, height = arguments.size
    if arguments.distortion == "none":
        return None if view is None else default_camera(width, height, view_rad=view)
    model = DistortionModel(arguments.distortion)
    return default_camera(width, height, model, TYPICAL_LENSES[model], view)


def _targets(arguments: argparse.Namespace) -> tuple[TargetImage, ...]:
    from imgu_ros.errors import ParameterError
    from imgu_ros.simulate.sequence import default_targets

    if not 1e-6 <= arguments.width_m <= 1e4:
        raise ParameterError(f"width: {arguments.width_m:g} m; need more than 0: 0.000001 to 10000")
    if not arguments.template:
        count = 1 if arguments.targets is None else arguments.targets
        if not 1 <= count <= 64:
            raise ParameterError(f"targets: {count}; need 1 to 64")
        return default_targets(count, arguments.seed, arguments.width_m)
    if arguments.targets is not None:
        raise ParameterError(f"targets: {arguments.targets} with --template; need one or the other")
    from imgu_ros.config.parameters import TargetsParameters
    from imgu_ros.files.board_file import BOARD_SUFFIXES
    from imgu_ros.files.target_images import load_target_images
    from imgu_ros.reference.family import FamilyImage

    paths = tuple(str(path) for path in arguments.template)
    for path in paths:
        if Path(path).suffix.lower() in BOARD_SUFFIXES:
            raise ParameterError(f"--template: {path}: a board; need pictures or markers")
    images = load_target_images(TargetsParameters(images=paths, widths_m=(arguments.width_m,) * len(paths)), warn)
    for image in images:
        if isinstance(image, FamilyImage):
            raise ParameterError(f"--template: {image.family}:*: all ids of a family; need one, {image.family}:7")
    return images


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r}; need WIDTHxHEIGHT, such as 1280x720")
    return int(match[1]), int(match[2])


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; need numbers, separated by commas, such as 0,-1,1.5") from None
