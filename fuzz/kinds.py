# SPDX-License-Identifier: Apache-2.0
"""The kinds of input: where a case of each comes from."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fuzz import mcap, mcap_mutation, pictures, rasters, rosbag1, sqlite, texts
from fuzz.mutation import FOLDER, Case, Rng, choice, mangled
from fuzz.zstd import compressed, repeated

RECORDING, PICTURE, CAMERA, PARAMETERS = "recording", "picture", "camera", "parameters"


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of input.

    Attributes
    ----------
    reader : what reads it: RECORDING, PICTURE, CAMERA or PARAMETERS
    seeds : whole cases
    mutate : one mutation
    share : how often it is tried, beside others of the same reader
    """

    reader: str
    seeds: Callable[[], tuple[Case, ...]]
    mutate: Callable[[Rng, Case], Case]
    share: int


def generated(name: str, seed: int, index: int, rounds: int | None = None) -> Case:
    """Return a case, the same for the same arguments: the first ones are the seeds as they are.

    Parameters
    ----------
    name : of the kind
    rounds : stop after as many mutations; None: all
    """
    kind = KINDS[name]
    rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
    seeds = kind.seeds()
    case = seeds[index] if index < len(seeds) else choice(rng, seeds)
    wanted = 0 if index < len(seeds) else min(8, int(rng.geometric(0.5)))
    for _ in range(wanted if rounds is None else min(rounds, wanted)):
        case = kind.mutate(rng, case)
    return case


def in_turn(readers: Sequence[str] | None, first: int, count: int) -> Iterator[tuple[str, int]]:
    """Yield (kind, index) of `count` cases from the case `first` of each kind on, the kinds by their shares.

    Parameters
    ----------
    readers : of the kinds; None: all
    """
    kinds = [(name, kind) for name, kind in KINDS.items() if readers is None or kind.reader in readers]
    cycle = [name for turn in range(max(kind.share for _, kind in kinds)) for name, kind in kinds if turn < kind.share]
    indices = dict.fromkeys(KINDS, first)
    for number in range(count):
        name = cycle[number % len(cycle)]
        yield name, indices[name]
        indices[name] += 1


def write_case(case: Case, folder: Path) -> Path:
    """Write a case's files; return what is to be opened."""
    for name, data in case.items():
        if name != FOLDER:
            (folder / name).write_bytes(data)
    return folder / next(iter(case))


def _single(
    reader: str,
    name: str,
    seeds: Callable[[], tuple[bytes, ...]],
    mutate: Callable[[Rng, bytes], bytes],
    share: int,
) -> Kind:
    """Return a kind whose cases are one file."""
    return Kind(
        reader,
        lambda: tuple({name: data} for data in seeds()),
        lambda rng, case: {name: mutate(rng, case[name])},
        share,
    )


def _zstd_seeds() -> tuple[Case, ...]:
    return (
        {"bag.mcap.zstd": compressed(mcap.seeds()[0])},
        {"bag.db3.zstd": compressed(sqlite.seeds()[0])},
        {"bag.mcap.zstd": compressed(mcap.seeds()[3][:3000]) + compressed(mcap.seeds()[3][3000:])},
    )


def _mutate_zstd(rng: Rng, case: Case) -> Case:
    ((name, data),) = case.items()
    roll = rng.random()
    if roll < 0.3:
        return {name: mangled(rng, data)}
    if roll < 0.4:
        bomb = repeated(choice(rng, (2**20, 2**30, 3 * 2**30)))
        return {name: choice(rng, (data + bomb, bomb + data, data + b"junk", data * 2))}
    inside = choice(rng, mcap.seeds() if ".mcap" in name else sqlite.seeds())
    mutate = mcap_mutation.mutate if ".mcap" in name else sqlite.mutate
    return {name: compressed(mutate(rng, inside))}


def _folder_seeds() -> tuple[Case, ...]:
    one, other, database = mcap.seeds()[0], mcap.seeds()[2], sqlite.seeds()[0]
    return (
        _folder({"bag_0.mcap": one, "bag_1.mcap": other}, "mcap"),
        _folder({"bag_0.db3": database}, "sqlite3"),
        _folder({"bag_0.mcap.zstd": compressed(one)}, "mcap"),
    )


def _folder(files: Case, storage: str) -> Case:
    return {FOLDER: b"", "metadata.yaml": texts.metadata(list(files), storage), **files}


def _mutate_folder(rng: Rng, case: Case) -> Case:
    files = {name: data for name, data in case.items() if name != FOLDER}
    if not files:
        return case
    name = choice(rng, list(files))
    roll = rng.random()
    if roll < 0.1:
        del files[name]
    elif roll < 0.2:
        files[choice(rng, ("bag_0.mcap", "bag_7.mcap", "bag_1.db3", "metadata.yaml", "=1.mcap", "\x1b[31m.mcap"))] = (
            files[name]
        )
    elif roll < 0.65 and "metadata.yaml" in files:
        files["metadata.yaml"] = texts.mutate(rng, files["metadata.yaml"])
    elif name.endswith((".mcap", ".db3")):
        mutate = mcap_mutation.mutate if name.endswith(".mcap") else sqlite.mutate
        files[name] = mutate(rng, files[name])
    else:
        files[name] = mangled(rng, files[name])
    return {FOLDER: b"", **files}


def _wal_seeds() -> tuple[Case, ...]:
    return ({f"bag.db3{end}": data for end, data in sqlite.wal_seed().items()},)


KINDS: dict[str, Kind] = {
    "mcap": _single(RECORDING, "bag.mcap", mcap.seeds, mcap_mutation.mutate, 9),
    "rosbag1": _single(RECORDING, "bag.bag", rosbag1.seeds, rosbag1.mutate, 4),
    "sqlite": _single(RECORDING, "bag.db3", sqlite.seeds, sqlite.mutate, 4),
    "sqlite-wal": Kind(RECORDING, _wal_seeds, sqlite.mutate_wal, 1),
    "zstd": Kind(RECORDING, _zstd_seeds, _mutate_zstd, 1),
    "folder": Kind(RECORDING, _folder_seeds, _mutate_folder, 1),
    "jpeg": _single(PICTURE, "picture.jpg", pictures.jpeg_seeds, pictures.mutate_jpeg, 4),
    "png": _single(PICTURE, "picture.png", pictures.png_seeds, pictures.mutate_png, 4),
    "raster": _single(PICTURE, "picture", rasters.seeds, rasters.mutate, 2),
    "camera": _single(CAMERA, "camera.yaml", texts.camera_seeds, texts.mutate, 1),
    "parameters": _single(PARAMETERS, "parameters.yaml", texts.parameter_seeds, texts.mutate, 1),
}
