# SPDX-License-Identifier: Apache-2.0
"""What is said of a target without homography or pose: each kind as a real frame brings it, wherever it is told."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.bags.messages import make_message
from imgu_ros.cli.match import document
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import (
    DegenerateConfiguration,
    EstimationError,
    NoConsensus,
    NotConfirmed,
    NotConverged,
    TooFewPoints,
)
from imgu_ros.files.frames_csv import COLUMNS, FramesWriter, read_rows
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.messages.results import result_status_message
from imgu_ros.reasons import NO_SIZE, NOT_DUE, NOT_IN_VIEW, UNLIKELY, why_not_found
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.report.overlay import _status_text
from imgu_ros.result import Result
from imgu_ros.shown_text import as_cell, shown
from imgu_ros.simulate.sequence import default_camera
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Image
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

WIDTH, HEIGHT = 640, 480
POSTER, OTHER = (procedural_texture(WIDTH, HEIGHT, seed=seed) for seed in (0, 9))
CAMERA = default_camera(WIDTH, HEIGHT)


def grey(picture: Image) -> Image:
    return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)


def result_of(pixels: Image, camera: Camera | None = None, width_m: float = 0.5, **values: object) -> Result:
    parameters = parameters_from({name.replace("__", "."): value for name, value in values.items()})
    frame = Frame(RawImage(pixels, PixelLayout(ColorModel.MONO)), 0, "camera", camera)
    return Localizer(parameters, prepare_references([TargetImage("poster", POSTER, width_m)], parameters)).process(
        frame
    )


def blank() -> Result:
    return result_of(np.zeros((HEIGHT, WIDTH), np.uint8))


def another_picture() -> Result:
    return result_of(grey(OTHER))


def too_small() -> Result:
    pixels = np.full((HEIGHT, WIDTH), 128, np.uint8)
    pixels[100:112, 100:116] = cv2.resize(grey(POSTER), (16, 12), interpolation=cv2.INTER_AREA)
    return result_of(pixels)


def a_part_of_it_in_another_picture() -> Result:
    pixels = grey(OTHER)
    pixels[:96] = grey(POSTER)[:96]
    return result_of(pixels)


def too_steep() -> Result:
    H = np.array([[1.0, 0, 0], [0, 1, 0], [-0.002, 0, 1]])  # the vanishing line crosses the poster
    return result_of(cv2.warpPerspective(grey(POSTER), H, (1600, HEIGHT), borderValue=128))


def not_developed() -> Result:
    return result_of(grey(POSTER), raw__black_level=300.0)


def no_camera() -> Result:
    return result_of(grey(POSTER))


def no_size() -> Result:
    return result_of(grey(POSTER), CAMERA, width_m=0.0)


def two_poses() -> Result:
    return result_of(grey(POSTER), CAMERA, pose__ambiguity_ratio=1e-6)


NUMBER = r"\d+"
#: Status, pose status and words of each kind, numbers replaced.
KINDS = {
    blank: ("lost", "", f"{NOT_IN_VIEW} (0 matches, 8 needed)"),
    another_picture: ("lost", "", f"{NOT_IN_VIEW} (N of N matches agree, 8 needed)"),
    too_small: ("lost", "", f"{NOT_IN_VIEW} (N matches, 8 needed)"),
    a_part_of_it_in_another_picture: (
        "lost",
        "",
        (
            "something like it is in view, or it is mostly covered "
            "(N% of what is in view looks as it should, 30.5% needed)"
        ),
    ),
    too_steep: (
        "degenerate",
        "",
        "seen too steeply, too small or mirrored (H: a part of the target would lie behind the camera)",
    ),
    not_developed: (
        "rejected",
        "",
        "the frame cannot be used (raw.black_level: 300; need less than the white level, 255)",
    ),
    no_camera: ("detected", "uncalibrated", "no calibration: there is no camera_info"),
    no_size: ("detected", "no_size", NO_SIZE),
    two_poses: (
        "detected",
        "ambiguous",
        (
            "two poses fit alike, need a view from nearer or more from the side "
            "(ratio of their errors N, at most 1e-06 for a pose)"
        ),
    ),
}


def pattern(words: str) -> str:
    return re.escape(words).replace("N%", f"{NUMBER}%").replace(r"errors\ N", r"errors\ 0\.\d\d").replace("N", NUMBER)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_each_kind_is_said_in_the_users_terms_everywhere(kind, tmp_path: Path) -> None:
    status, pose_status, words = KINDS[kind]
    result = kind()
    target = result.first
    assert (target.status.value, target.pose_status.value) == (status, pose_status)
    assert re.fullmatch(pattern(words), target.reason), target.reason
    # frames.csv, the status topic and match's JSON say the same.
    with FramesWriter(tmp_path / "frames.csv") as writer:
        writer.write(result)
    (row,) = read_rows(tmp_path / "frames.csv")
    assert row["reason"] == target.reason
    (entry,) = result_status_message(make_message, result).status
    states = ", ".join(filter(None, (status, pose_status)))
    assert entry.message == f"{states}: {target.reason}"
    assert document(result)["reason"] == target.reason
    assert target.reason in _status_text(target)  # of the debug image


def test_found_with_a_pose_says_nothing() -> None:
    target = result_of(grey(POSTER), CAMERA).first
    assert (target.pose_status.value, target.reason) == ("metric", "")


def test_the_share_that_confirms() -> None:
    """Of a found target nearly all, of a part of it in another picture about that part, of nothing compared none."""
    assert result_of(grey(POSTER), CAMERA).first.confirmed_share == pytest.approx(1.0, abs=0.1)
    assert a_part_of_it_in_another_picture().first.confirmed_share == pytest.approx(0.2, abs=0.1)
    for kind in (blank, another_picture, too_steep, not_developed):
        assert kind().first.confirmed_share is None
    half = grey(POSTER)
    half[:, :256] = grey(OTHER)[:, :256]
    assert result_of(half, CAMERA).first.confirmed_share == pytest.approx(0.6, abs=0.1)


def test_of_a_tracked_target_the_patches_that_agree() -> None:
    parameters = parameters_from({})
    chain = Localizer(parameters, prepare_references([TargetImage("poster", POSTER, 0.5)], parameters))
    covered = grey(POSTER)
    covered[:, :256] = 128
    shares = []
    for stamp, pixels in enumerate((grey(POSTER), grey(POSTER), covered)):
        frame = Frame(RawImage(pixels, PixelLayout(ColorModel.MONO)), stamp * 33_000_000, "camera", CAMERA)
        target = chain.process(frame).first
        shares.append((target.status.value, target.confirmed_share))
    assert [status for status, _ in shares] == ["detected", "tracked", "tracked"]
    assert shares[1][1] == pytest.approx(1.0, abs=0.1)
    assert shares[2][1] == pytest.approx(0.6, abs=0.12)


def test_targets_that_are_not_looked_for() -> None:
    parameters = parameters_from({"tracking.search_every": 100})
    pictures = [POSTER, OTHER, *(procedural_texture(WIDTH, HEIGHT, seed=seed) for seed in range(20, 24))]
    targets = prepare_references([TargetImage(f"t{i}", picture, 0.5) for i, picture in enumerate(pictures)], parameters)
    chain = Localizer(parameters, targets)
    said: set[str] = set()
    for stamp in range(3):
        frame = Frame(RawImage(grey(POSTER), PixelLayout(ColorModel.MONO)), stamp * 33_000_000, "camera", CAMERA)
        result = chain.process(frame)
        assert result.first.status.found
        said |= {target.reason for target in list(result)[1:]}
    assert NOT_DUE in said
    assert said <= {NOT_DUE, UNLIKELY} | {reason for reason in said if reason.startswith(NOT_IN_VIEW)}


@pytest.mark.parametrize(
    ("error", "agreeing", "words"),
    [
        (TooFewPoints("matches: 30; need 4"), 0, f"{NOT_IN_VIEW} (matches: 30; need 4)"),
        (NoConsensus("inliers: 9 of 30; by chance 9 would agree", 9), 9, f"{NOT_IN_VIEW} (inliers: 9 of 30; by chance"),
        (NotConverged("no minimum after 50 steps"), 20, f"{NOT_IN_VIEW} (no minimum after 50 steps)"),
        (NotConfirmed("7% of it, 32% needed", 0.07), 20, "something like it is in view, or it is mostly covered (7%"),
        (
            DegenerateConfiguration("points: on a line"),
            20,
            "seen too steeply, too small or mirrored (points: on a line",
        ),
        (EstimationError("whatever"), 20, f"{NOT_IN_VIEW} (whatever)"),
    ],
)
def test_numbers_are_those_of_the_error_where_counts_do_not_tell(
    error: EstimationError, agreeing: int, words: str
) -> None:
    assert why_not_found(error, 30, agreeing, 8).startswith(words)


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ('a "quoted" name, with commas', 'a "quoted" name, with commas'),
        ("two\nlines", r"two\x0alines"),
        ("carriage\rreturn", r"carriage\x0dreturn"),
        ("Größe 角度 \ud800", r"Größe 角度 \ud800"),
        ("=HYPERLINK(A1)", "'=HYPERLINK(A1)"),
        ("+1", "'+1"),
        ("-1", "'-1"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("\t=1", r"'\x09=1"),
        ("\r=1", r"'\x0d=1"),
        ("'quoted'", "''quoted'"),
        ("\x1b[2J\u202e\0", r"\x1b[2J\u202e\x00"),
        (r"back\slash", r"back\\slash"),
    ],
)
def test_text_in_frames_csv_is_quoted(tmp_path: Path, text: str, cell: str) -> None:
    """Read back by our reader and by csv as spreadsheets do; a name from outside may be anything."""
    result = blank()
    target = replace(result.first, name=text, reason=text)
    result = replace(result, frame=replace(result.frame, frame_id=text), references={"a": target, "b": target})
    with FramesWriter(tmp_path / "frames.csv") as writer:
        writer.write(result)
    data = (tmp_path / "frames.csv").read_bytes()
    assert data.count(b"\n") == 3
    for written, rows in (
        (text, list(read_rows(tmp_path / "frames.csv"))),
        (cell, list(csv.DictReader(io.StringIO(data.decode(), newline=""), strict=True))),
    ):
        assert len(rows) == 2
        for row in rows:
            assert tuple(row) == COLUMNS
            assert row["target"] == row["frame_id"] == written
            assert row["n_matches"] == "0"
        assert rows[0]["reason"] == (shown(text) if written == text else as_cell(shown(text)))
