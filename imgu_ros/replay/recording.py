# SPDX-License-Identifier: Apache-2.0
"""Record a simulated sequence as a bag, with the files to replay it and to evaluate the replay."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import yaml

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter, bag_files, unfinished_bag_files
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.file_access.text_files import write_text
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.encodings import Encoding, encoding_named
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.output_folder import OutputFiles, check_output_folder, output_folder
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.exposure import ExposureTruth, saturated_share, write_exposures
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence
from imgu_ros.simulate.truth import Truth, write_truth
from imgu_ros.stop_signals import HeldExitStack, held
from imgu_ros.vision.formation.layout import ColorModel
from imgu_ros.vision.formation.sensor import Sensor
from imgu_ros.vision.formation.transfer import TransferFunction, encode_light

IMAGE_TOPIC = "/camera/image_raw"
CAMERA_INFO_TOPIC = "/camera/camera_info"
TRUTH_FILE = "truth.csv"
EXPOSURE_FILE = "exposure.csv"
PARAMETER_FILE = "params.yaml"

#: The value of `raw.transfer` for each transfer function: the nearest one.
_PARAMETER_OF_TRANSFER = {
    TransferFunction.LINEAR: "linear",
    TransferFunction.SRGB: "srgb",
    TransferFunction.FILM: "srgb",
}
#: Where the bag is written, in a folder of its name.
_UNFINISHED = "bag.part"


@dataclass(frozen=True, slots=True)
class BagFormat:
    """How the frames are written.

    Attributes
    ----------
    encoding : bayer_{rggb,bggr,grbg,gbrg}{8,16}, mono8, mono16, rgb8, rgb16, bgr8 or bgr16; samples of fewer bits than
        the encoding has are right-aligned
    row_padding : bytes added to each row, >= 0
    big_endian : byte order of 16-bit samples
    storage : mcap or sqlite3
    compression : none or zstd
    """

    encoding: str = "bayer_rggb8"
    row_padding: int = 0
    big_endian: bool = False
    storage: Literal["mcap", "sqlite3"] = "mcap"
    compression: Literal["none", "zstd"] = "none"


def record_simulation(
    out: Path,
    simulation: Simulation,
    bag_format: BagFormat | None = None,
    targets: Sequence[TargetImage] | None = None,
    *,
    overwrite: bool = False,
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> tuple[Truth, ...]:
    """Simulate a sequence into the folder `out`: a rosbag2, template images, truth.csv, exposure.csv and params.yaml.

    Parameters
    ----------
    out : the folder; new or empty, unless `overwrite`
    simulation : its layout is taken from the format's encoding
    bag_format : 8-bit Bayer RGGB in MCAP when None
    targets : target images in the scene; one procedural image when None
    overwrite : replace the files of an earlier simulation; nothing else is ever removed
    on_progress : called with (frames done, frames in all)

    Returns
    -------
    what truth.csv holds

    Raises
    ------
    ParameterError, ShapeError
        If the simulation is impossible, or the sensor's bits do not fit the encoding.
    FileError, BagError
        If the folder holds something else, or cannot be written.
    """
    bag_format = bag_format or BagFormat()
    encoding = simulated_encoding(bag_format.encoding)
    simulation = replace(simulation, layout=encoding.layout)
    _check_format(bag_format, encoding, simulation.sensor)
    _check_path(out)
    targets = tuple(targets) if targets is not None else default_targets(1, simulation.seed)
    contents, name = simulation_files(out, targets, bag_format.storage), _bag_name(out)
    check_output_folder(out, contents, overwrite=overwrite)
    # The first frame is made before the folder is touched: it raises what is wrong with the simulation.
    frames = simulate_sequence(simulation, targets, workers=min(4, os.cpu_count() or 1))
    pending = next(frames, None)
    truths: list[Truth] = []
    exposures: list[ExposureTruth] = []
    with HeldExitStack() as stack:
        folder = stack.enter_context(output_folder(out, contents, overwrite=overwrite))
        _write_side_files(out, targets, simulation)
        unfinished = f"{_UNFINISHED}/{name}"
        place = folder.make(_UNFINISHED) / name
        bag = stack.enter_context(BagWriter(place, bag_format.storage, bag_format.compression))
        done = 0
        while pending is not None:
            frame = pending.frame
            header = Header(frame.stamp_ns, frame.frame_id)
            pixels = frame.image.pixels.astype(encoding.dtype, copy=False)
            image = image_message(
                make_message, header, pixels, encoding.name,
                row_padding=bag_format.row_padding, big_endian=bag_format.big_endian,
            )  # fmt: skip
            if frame.camera is not None:
                info = camera_info_message(make_message, header, frame.camera)
                bag.write(CAMERA_INFO_TOPIC, info, frame.stamp_ns)
            with folder.writing():
                bag.write(IMAGE_TOPIC, image, frame.stamp_ns)
            truths += pending.truths
            saturated = saturated_share(frame.image.pixels, simulation.sensor)
            exposures.append(ExposureTruth(frame.stamp_ns, pending.exposure, saturated))
            done += 1
            on_progress(done, simulation.frames)
            pending = next(frames, None)
        with held():
            bag.close()
            write_truth(out / TRUTH_FILE, truths)
            write_exposures(out / EXPOSURE_FILE, exposures, simulation.capture, simulation.sensor)
            folder.publish(*((f"{unfinished}/{file}", file) for file in bag_files(name, bag_format.storage)))
    return tuple(truths)


def simulated_encoding(name: str) -> Encoding:
    """Return the encoding `name`, if frames can be simulated in it.

    Raises
    ------
    EncodingError, ParameterError
        If there is no such encoding, or it is not Bayer, mono, RGB or BGR of 8 or 16 bits.
    """
    encoding = encoding_named(name)
    colors = (ColorModel.BAYER, ColorModel.MONO, ColorModel.RGB, ColorModel.BGR)
    if encoding.layout.color not in colors or encoding.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise ParameterError(f"encoding: {name!r}; need bayer_*8, bayer_*16, mono8, mono16, rgb8, rgb16, bgr8 or bgr16")
    return encoding


def simulation_files(out: Path, targets: Sequence[TargetImage], storage: str) -> OutputFiles:
    """Return the files of a simulation; those of the bag come last, so that part of a bag is not taken for a bag."""
    name = _bag_name(out)
    unfinished = (f"{_UNFINISHED}/{name}/{file}" for file in unfinished_bag_files(name))
    side_files = (*(f"{target.name}.png" for target in targets), PARAMETER_FILE, TRUTH_FILE, EXPOSURE_FILE)
    bag = bag_files(name, storage)
    return OutputFiles("simulation", (*unfinished, *side_files, *bag), bag[-1])


def raw_parameters(sensor: Sensor | None, capture: Capture) -> dict[str, object]:
    """Return the parameters of the group `raw` that undo what a sensor and a capture do, where the defaults do not."""
    # Said of colours too, which otherwise count as sRGB.
    raw: dict[str, object] = {"transfer": _PARAMETER_OF_TRANSFER[capture.transfer]}
    if sensor is None or sensor.bits > 8:
        raw["significant_bits"] = 16 if sensor is None else sensor.bits
    if sensor is not None and sensor.black_level_dn:
        raw["black_level"] = float(sensor.black_level_dn)
    if capture.sensitivities != (1.0, 1.0, 1.0):
        # They act on values, after the transfer function: at full scale they are right for every one.
        raw["gains"] = np.round(1 / encode_light(capture.sensitivities, capture.transfer), 6).tolist()
    return raw


def _check_path(out: Path) -> None:
    try:
        os.path.realpath(out).encode()
    except UnicodeEncodeError:
        raise FileError(f"{out}: a path that is not UTF-8; need one: params.yaml and metadata.yaml name it") from None


def _check_format(bag_format: BagFormat, encoding: Encoding, sensor: Sensor | None) -> None:
    bits = 16 if sensor is None else sensor.bits
    if bits > 8 * encoding.dtype.itemsize:
        raise ParameterError(f"bits: {bits}; need {8 * encoding.dtype.itemsize} or fewer for {encoding.name}")
    if not 0 <= bag_format.row_padding <= 65536:
        raise ParameterError(f"row padding: {bag_format.row_padding} bytes; need 0 to 65536")


def _bag_name(out: Path) -> str:
    return Path(os.path.abspath(out)).name or "bag"


def _write_side_files(out: Path, targets: Sequence[TargetImage], simulation: Simulation) -> None:
    paths = [Path(os.path.realpath(out)) / f"{target.name}.png" for target in targets]
    for path, target in zip(paths, targets, strict=True):
        write_image(path, target.pixels)
    values: dict[str, object] = {
        "targets": {
            "images": [target.entry or str(path) for path, target in zip(paths, targets, strict=True)],
            "widths_m": [float(target.width_m) for target in targets],
            "names": [target.name for target in targets],
        }
    }
    values["raw"] = raw_parameters(simulation.sensor, simulation.capture)
    text = yaml.safe_dump({"/**": {"ros__parameters": values}}, sort_keys=False, allow_unicode=True)
    write_text(out / PARAMETER_FILE, text)
