"""Turn one raw or mosaicked image file (PGM, PNG, TIFF, or headerless) into a colour image of the same depth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.errors import FileError, ParameterError

if TYPE_CHECKING:
    from imgu_ros.types import Image

HELP = "turn a raw image file into a colour image"

_DTYPES = {"uint8": "uint8", "uint16": "<u2", "uint16le": "<u2", "uint16be": ">u2"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from imgu_ros.params import declaration

    method = declaration("demosaic.method")
    parser.add_argument(
        "input", type=Path, metavar="IN", help="raw image: PGM, PNG or TIFF, 8 or 16 bit; or headerless"
    )
    parser.add_argument("output", type=Path, metavar="OUT", help="colour image: PPM, PNG or TIFF")
    parser.add_argument("--pattern", choices=("rggb", "bggr", "grbg", "gbrg"), required=True, help="top-left 2x2 quad")
    parser.add_argument("--method", choices=method.choices, default=method.default, help="default: %(default)s")
    levels = parser.add_argument_group("levels, applied to the raw values first")
    levels.add_argument("--black", type=float, default=0.0, metavar="N", help="raw value of no light")
    levels.add_argument(
        "--white", type=float, default=0.0, metavar="N", help="raw value of full scale; default: the type's"
    )
    levels.add_argument("--gains", type=_gains, default=(1.0, 1.0, 1.0), metavar="R,G,B", help="white-balance gains")
    raw = parser.add_argument_group("headerless input, row by row without padding")
    raw.add_argument("--width", type=int, metavar="PX")
    raw.add_argument("--height", type=int, metavar="PX")
    raw.add_argument("--dtype", choices=tuple(_DTYPES), help="uint16 is little-endian")


def run(arguments: argparse.Namespace) -> int:
    """Read, develop, write."""
    _check_levels(arguments)
    raw = _read_raw(arguments)
    if arguments.white > (65535 if raw.dtype.itemsize == 2 else 255):
        raise ParameterError(f"--white: {arguments.white:g}; need at most the largest {raw.dtype} value")
    from imgu_ros.files.images import write_image
    from imgu_ros.vision.formation.cfa import BayerPattern
    from imgu_ros.vision.formation.demosaic import demosaic
    from imgu_ros.vision.formation.levels import with_levels

    pattern = BayerPattern(arguments.pattern)
    leveled = with_levels(raw, pattern, arguments.black, arguments.white, arguments.gains)
    write_image(arguments.output, demosaic(leveled, pattern, arguments.method))
    return 0


def _read_raw(arguments: argparse.Namespace) -> Image:
    headerless = (arguments.width, arguments.height, arguments.dtype)
    if any(value is not None for value in headerless):
        if any(value is None for value in headerless):
            raise ParameterError("headerless input: got only some of --width, --height, --dtype; need all three")
        from imgu_ros.files.images import read_raw_image

        return read_raw_image(arguments.input, arguments.width, arguments.height, _DTYPES[arguments.dtype])
    from imgu_ros.files.images import read_image

    raw = read_image(arguments.input)
    if raw.ndim != 2 or raw.dtype.name not in ("uint8", "uint16"):
        raise FileError(f"{arguments.input}: shape {raw.shape}, {raw.dtype}; need a one-channel 8- or 16-bit image")
    return raw


def _check_levels(arguments: argparse.Namespace) -> None:
    if not (0 <= arguments.black <= 65535 and 0 <= arguments.white <= 65535):
        raise ParameterError(f"--black, --white: {arguments.black:g}, {arguments.white:g}; need 0 to 65535")
    if 0 < arguments.white <= arguments.black:
        raise ParameterError(f"--white: {arguments.white:g}; need more than --black ({arguments.black:g})")


def _gains(text: str) -> tuple[float, ...]:
    try:
        gains = tuple(float(part) for part in text.split(","))
    except ValueError:
        gains = ()
    if len(gains) != 3 or not all(0.01 <= gain <= 100 for gain in gains):
        raise argparse.ArgumentTypeError(f"{text!r}; need three numbers R,G,B from 0.01 to 100")
    return gains
