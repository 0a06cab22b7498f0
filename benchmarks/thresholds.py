# SPDX-License-Identifier: Apache-2.0
"""Measured constants: what other values of each would give. Every constant is varied alone, on the same data.

    python benchmarks/thresholds.py --json benchmarks/figures/thresholds.json      # all studies, a quarter of an hour
    python benchmarks/thresholds.py --quick                                        # a few frames of each, a minute
    python benchmarks/thresholds.py --study tracking blur --json benchmarks/figures/thresholds.json

`CONSTANTS` says where each constant is, and `STUDIES` which values are compared on what (`threshold_trials.py`,
`threshold_prints.py`, `threshold_siblings.py`).
Frames are simulated, with exact truth; `detection` and `consensus` also use the real images and matches of `$IMGU_DATA`
where they are present. A line gives one value's figures; the first line of each study gives those of the values in
the code, with which the others are to be compared. `--json` replaces the studies that were run and keeps the others;
`test/test_measured_constants.py` compares the values stored with those in the code.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import threshold_prints as prints
import threshold_siblings as siblings
import threshold_trials as trials

from imgu_ros.bench.machine import this_machine

#: Where constants are: module in `imgu_ros`, name, and the field where it is a dataclass. Only this table changes when
#: a module or a constant is renamed.
CONSTANTS = {
    # tracking
    "held_share": "track.tracker:_HELD_SHARE",
    "held_rms_px": "track.tracker:_HELD_RMS_PX",
    "min_similarity": "track.patch_alignment:_MIN_SIMILARITY",
    "farthest_share": "track.patch_alignment:_FARTHEST_SHARE",
    "fewest_at_first": "track.patch_alignment:_FEWEST_AT_FIRST",
    "scouts": "track.patch_alignment:_SCOUTS",
    "scouted_px": "track.patch_alignment:_SCOUTED_PX",
    "settled_px": "track.patch_alignment:_SETTLED_PX",
    "enough_for_projective": "track.patch_alignment:_ENOUGH_FOR_PROJECTIVE",
    "coarse_share": "track.patch_alignment:_COARSE_SHARE",
    "fine_steps": "track.patch_alignment:_FINE_STEPS",
    "fine_enough_px": "track.patch_alignment:_FINE_ENOUGH_PX",
    "sheet_room_px": "track.patch_squares:_SHEET_ROOM_PX",
    "sheet_share": "track.patch_squares:_SHEET_SHARE",
    "most_stretched": "track.patch_alignment:_MOST_STRETCHED",
    "corner_quality": "reference.templates:_CORNER_QUALITY",
    "corner_distance_px": "reference.templates:_CORNER_DISTANCE_PX",
    "cauchy_rounds": "vision.projective.plane_motion:_CAUCHY_ROUNDS",
    "tukey_rounds": "vision.projective.plane_motion:_TUKEY_ROUNDS",
    # reach
    "surprise": "track.tracker:_SURPRISE",
    "least_reach_px": "track.tracker:_LEAST_REACH_PX",
    "unknown_reach_px": "track.tracker:_UNKNOWN_REACH_PX",
    "longest_shift": "track.tracker:_LONGEST_SHIFT",
    "reach_px": "track.patch_alignment:_REACH_PX",
    "coarsest_side_px": "track.patch_alignment:_COARSEST_SIDE_PX",
    "stride": "track.patch_alignment:_STRIDE",
    "coarse_patches": "track.patch_alignment:_COARSE_PATCHES",
    "coarse_steps": "track.patch_alignment:_COARSE_STEPS",
    "coarse_enough_px": "track.patch_alignment:_COARSE_ENOUGH_PX",
    "shift_side_px": "track.shift_search:_SIDE_PX",
    "shift_similarity": "track.shift_search:_MIN_SIMILARITY",
    "steady": "track.tracker:_STEADY",
    "same": "track.tracker:_SAME",
    "memory": "track.tracker:_MEMORY",
    # blur
    "coarsest_result": "track.patch_alignment:_COARSEST_RESULT",
    "blurred": "track.patch_alignment:_BLURRED",
    "sharp_similarity": "track.patch_alignment:_SHARP_SIMILARITY",
    "blurred_share": "track.patch_alignment:_BLURRED_SHARE",
    "assumed_px": "vision.projective.plane_motion:_ASSUMED_PX",
    "longest_px": "vision.projective.plane_motion:_LONGEST_PX",
    "shortest_px": "vision.projective.plane_motion:_SHORTEST_PX",
    "weakest": "vision.projective.plane_motion:_WEAKEST",
    "strongest": "vision.projective.plane_motion:_STRONGEST",
    # detection
    "more_samples": "reference.features:_MORE_SAMPLES",
    "detection_reach_px": "detect.robust_fit:_DETECTION_REACH_PX",
    "guided_ratio": "detect.search_passes:_RATIO",
    "largest_view": "reference.features:_LARGEST_VIEW",
    "richness": "reference.features:_RICHNESS",
    "shortening": "reference.features:_SHORTENING",
    "directions": "reference.features:_DIRECTIONS",
    "oblique_richness": "reference.features:_OBLIQUE_RICHNESS",
    "closest_view": "reference.features:_CLOSEST_VIEW",
    "enlarged": "reference.features:_ENLARGED",
    "close_octaves": "reference.features:_CLOSE_OCTAVES",
    "close_richness": "reference.features:_CLOSE_RICHNESS",
    # many
    "failures": "detect.detector:_FAILURES",
    "fewest_votes": "detect.detector:_FEWEST_VOTES",
    "tables": "vision.matching.index:_TABLES",
    "spare_bits": "vision.matching.index:_SPARE_BITS",
    "largest_bucket": "vision.matching.index:_LARGEST_BUCKET",
    "index_alike": "vision.matching.index:_ALIKE",
    "index_ratio": "vision.matching.index:_RATIO",
    # confirmation
    "flat": "reference.template_cells:_FLAT",
    "blurs": "reference.verification:_BLURS",
    "needed": "reference.verification:NEEDED",
    "needed_of_texture": "reference.verification:_NEEDED_OF_TEXTURE",
    "sure": "reference.verification:_SURE",
    "sure_when_blurred": "reference.verification:_SURE_WHEN_BLURRED",
    "scattered_cells": "reference.verification:_SCATTERED",
    "finest_sample_px": "reference.frame_samples:_FINEST_PX",
    "most_samples": "reference.frame_samples:_MOST_SAMPLES",
    "sample_noise": "reference.verification:_NOISE",
    "misplaced": "reference.verification:_MISPLACED",
    "independent": "reference.verification:_INDEPENDENT",
    "contrast": "reference.verification:_CONTRAST",
    "shading": "reference.verification:_SHADING",
    "most_ratio": "reference.verification:_MOST",
    "least_ratio": "reference.verification:_LEAST",
    "alike": "reference.verification:_ALIKE",
    # contradictions
    "another_print": "reference.verification:_ANOTHER_PRINT",
    "few_against": "reference.verification:_FEW_AGAINST",
    "close_blurs": "reference.verification:_CLOSE_BLURS",
    "most_for_blur": "reference.verification:_MOST_FOR_BLUR",
    "finest_close_px": "reference.frame_samples:_FINEST_CLOSE_PX",
    "smoothed": "reference.frame_samples:_SMOOTHED",
    "same_lines": "reference.contradictions:_SAME_LINES",
    "displaced": "reference.contradictions:_DISPLACED",
    "near": "reference.contradictions:_NEAR",
    "same_tone": "reference.contradictions:_SAME_TONE",
    "same_grey": "reference.contradictions:_SAME_GREY",
    "same_contrast": "reference.contradictions:_SAME_CONTRAST",
    "least_variance": "reference.contradictions:_LEAST_VARIANCE",
    "most_of_one": "reference.contradictions:_MOST",
    "odd": "reference.contradictions:_ODD",
    "plain": "reference.contradictions:_PLAIN",
    "plain_share": "reference.contradictions:_PLAIN_SHARE",
    "interior": "reference.contradictions:_INTERIOR",
    "occluding": "reference.contradictions:_OCCLUDING",
    # covered
    "agreeing": "detect.robust_fit:_AGREEING",
    # covariance
    "unseen": "vision.projective.homography:_UNSEEN",
    "outlier_sigmas": "vision.projective.homography:_OUTLIER_SIGMAS",
    "floor_px": "vision.projective.homography:_FLOOR_PX",
    "misfit_cells": "vision.projective.homography:_CELLS",
    "sampled_beyond_px": "vision.matching.patch_bank:_SAMPLED_BEYOND_PX",
    # ambiguity
    "refuted": "vision.camera.pose:_REFUTED",
    # consensus
    "local_steps": "vision.estimation.search:_LOCAL_STEPS",
    "biweight_reach": "vision.estimation.search:_REACH",
    "annealing": "vision.estimation.search:_ANNEALING",
    "promising": "vision.estimation.search:_PROMISING",
    # prosac
    "support": "vision.estimation.ransac:_SUPPORT",
    # lines
    "many_on_line": "vision.projective.estimate:_MANY_ON_LINE",
    "fewest_off_line": "vision.projective.estimate:_FEWEST_OFF_LINE",
    "min_aspect": "vision.projective.fit:_MIN_ASPECT",
    # chance
    "nearby": "vision.estimation.chance:_NEARBY",
    "wider": "vision.estimation.chance:_WIDER",
    # samples
    "motion_settled": "track.patch_equations:_SETTLED",
    "patch_outlier": "track.patch_equations:_OUTLIER",
    "farthest_refined_px": "track.sample_refinement:_FARTHEST_PX",
    "asymmetric": "track.site_alignment:_ASYMMETRIC",
    "unsteady": "track.site_alignment:_UNSTEADY",
    "unseen_sites": "track.site_alignment:_UNSEEN",
    "huber": "track.site_alignment:_HUBER",
    "scout_patches": "track.site_alignment:_SCOUTS",
    "scout_patches_px": "track.site_alignment:_SCOUTED_PX",
    "steps": "track.site_alignment:_ITERATIONS",
    "texels": "image.raw_samples:_TEXELS",
    "spread_texels": "image.raw_samples:_SPREAD_TEXELS",
    "blur_share": "image.raw_samples:_BLUR_SHARE",
    # calibration
    "views": "pose.calibration_check:_VIEWS",
    "moved": "pose.calibration_check:_MOVED",
    "new_share": "pose.calibration_check:_NEW_SHARE",
    "sigmas": "pose.calibration_check:_SIGMAS",
    "for_few": "pose.calibration_check:_FOR_FEW",
    "least": "pose.calibration_check:_LEAST",
    "floor": "pose.calibration_check:_FLOOR",
    "most": "pose.calibration_check:_MOST",
    "most_held": "pose.calibration_check:_MOST_HELD",
    "telling_views": "pose.calibration_check:_TELLING_VIEWS",
    "beyond_doubt": "pose.calibration_check:_BEYOND_DOUBT",
    "scattered": "pose.calibration_check:_SCATTERED",
    "scattered_views": "pose.calibration_check:_SCATTERED_VIEWS",
    "held": "pose.calibration_check:_HELD",
    "evidence_by_chance": "vision.camera.calibration_evidence:_BY_CHANCE",
    "shared": "vision.camera.calibration_evidence:_SHARED",
    "second_order": "vision.camera.calibration_evidence:_SECOND_ORDER",
    # boards
    "outlier_ratio": "vision.camera.calibration:_OUTLIER_RATIO",
    "outlier_px": "vision.camera.calibration:_OUTLIER_PX",
}


#: Figures that differ by a smaller share are printed as the same: what is made once is counted in the first run.
_SAME = 2e-3


@dataclass(frozen=True, slots=True)
class Study:
    """Constants that one trial compares values of.

    Attributes
    ----------
    trial : prepares data, with True few of them, and returns what runs the package on them
    tried : values beside the one in the code, by the constant's key in `CONSTANTS`
    """

    trial: Callable[[bool], trials.Run]
    tried: Mapping[str, tuple[Any, ...]]


STUDIES = {
    "tracking": Study(
        trials.tracking,
        {
            "held_share": (0.05, 0.15, 0.4, 0.6),
            "held_rms_px": (0.25, 1.0),
            "min_similarity": (0.3, 0.7),
            "farthest_share": (0.25, 1.0),
            "fewest_at_first": (4, 15),
            "scouts": (20, 120, 1000),
            "scouted_px": (0.1, 1.0),
            "settled_px": (0.2, 2.0),
            "enough_for_projective": (8, 120),
            "coarse_share": (0.25, 0.75),
            "fine_steps": (5, 20),
            "fine_enough_px": (0.05, 0.5),
            "sheet_room_px": (2, 8),
            "sheet_share": (0.0, 1.0),
            "most_stretched": (1.0, 2.0),
            "corner_quality": (0.001, 0.02),
            "corner_distance_px": (3, 12),
            "cauchy_rounds": (1, 4),
            "tukey_rounds": (1, 4),
        },
    ),
    "reach": Study(
        trials.reach,
        {
            "surprise": (1.0, 3.0),
            "least_reach_px": (0.5, 6.0),
            "unknown_reach_px": (12.0, 48.0),
            "longest_shift": (0.03, 0.3),
            "reach_px": (1.5, 6.0),
            "coarsest_side_px": (30, 120),
            "stride": (1, 3),
            "coarse_patches": (40, 160),
            "coarse_steps": (4, 16),
            "coarse_enough_px": (0.05, 0.5),
            "shift_side_px": (24, 64),
            "shift_similarity": (0.1, 0.6),
            "steady": ((0.5, 2.0), (0.05, 20.0)),
            "same": (0.02, 0.4),
            "memory": (0.0, 0.8),
        },
    ),
    "blur": Study(
        trials.blur,
        {
            "coarsest_result": (1, 3),
            "blurred": (0.0, 0.4, 0.8),
            "sharp_similarity": (0.7, 0.97),
            "blurred_share": (0.05, 1.0),
            "assumed_px": (0.03, 0.3),
            "longest_px": (0.75, 3.0),
            "shortest_px": (0.01, 0.1),
            "weakest": (0.05, 0.5),
            "strongest": (1.1, 3.0),
        },
    ),
    "detection": Study(
        trials.detection,
        {
            "more_samples": (1, 6),
            "detection_reach_px": (3.0, 16.0),
            "guided_ratio": (0.8, 1.0),
            "largest_view": (1, 3),
            "richness": (0.75, 3.0),
            "shortening": (1, 3),
            "directions": (2, 6),
            "oblique_richness": (0.2, 0.8),
            "closest_view": (2, 6),
            "enlarged": (1, 3),
            "close_octaves": (1, 3),
            "close_richness": (3, 12),
        },
    ),
    "many": Study(
        trials.many,
        {
            "failures": (1, 6),
            "fewest_votes": ((1, 3, 3), (6, 10, 10)),
            "tables": (8, 32),
            "spare_bits": (0, 4),
            "largest_bucket": (8, 100),
            "index_alike": (0.15, 0.35),
            "index_ratio": (0.6, 0.95),
        },
    ),
    "confirmation": Study(
        trials.confirmation,
        {
            "flat": (3.0, 10.0),
            "blurs": ((0.0,), (0.0, 1.6)),
            "needed": (0.2, 0.45),
            "needed_of_texture": (0.1, 0.3),
            "sure": (0.7, 0.9),
            "sure_when_blurred": (0.8, 0.95),
            "scattered_cells": (0.3, 0.7),
            "finest_sample_px": (1.0, 3.0),
            "most_samples": (4000, 32000),
            "sample_noise": (2.0, 5.0),
            "misplaced": (0.2, 0.6),
            "independent": (3.0, 10.0),
            "contrast": (1.2, 2.0),
            "shading": (0.06, 0.25),
            "most_ratio": (4.0, 10.0),
            "least_ratio": (1.0, 3.0),
            "alike": (0.4, 0.8),
        },
    ),
    "contradictions": Study(
        siblings.contradictions,
        {
            "another_print": (3.0, 9.0, 12.0),
            "few_against": (0, 4),
            "close_blurs": ((0.0, 0.8, 1.6, 3.2), (0.4, 1.6)),
            "most_for_blur": (1.0, 6.0),
            "finest_close_px": (0.8, 1.5),
            "smoothed": (0.3, 0.7),
            "same_lines": (0.6, 0.8),
            "displaced": (0, 3),
            "near": (2, 5),
            "same_tone": (0.04, 0.16),
            "same_grey": (2.5, 10.0),
            "same_contrast": (0.3, 1.2),
            "least_variance": (10.0, 60.0),
            "most_of_one": (2.0, 5.0),
            "odd": (-2.0, 0.0),
            "plain": (10.0, 40.0),
            "plain_share": (0.05, 0.2),
            "interior": (3, 8),
            "occluding": (2, 8),
        },
    ),
    "covered": Study(siblings.covered, {"agreeing": (0.2, 0.3, 0.42, 0.5)}),
    "covariance": Study(
        trials.covariance,
        {
            "unseen": (0.0, 3.0, 6.0, 15.0, 30.0),
            "outlier_sigmas": (3.0, 5.0),
            "floor_px": (0.0, 0.1),
            "misfit_cells": (2, 4),
            "sampled_beyond_px": (0, 2),
        },
    ),
    "ambiguity": Study(trials.ambiguity, {"refuted": (1.0, 1.5, 2.0, 3.0, 10.0)}),
    "consensus": Study(
        trials.consensus,
        {
            "local_steps": (1, 10),
            "biweight_reach": (1.5, 4.0),
            "annealing": ((1.0, 1.0, 1.0), (3.0, 2.0, 1.4, 1.0, 1.0, 1.0)),
            "promising": (1, 5),
        },
    ),
    "lines": Study(
        trials.lines,
        {"many_on_line": (5, 20), "fewest_off_line": (3, 10), "min_aspect": (0.005, 0.01, 0.05)},
    ),
    "prosac": Study(trials.prosac, {"support": (0, 4, 20)}),
    "chance": Study(trials.chance, {"nearby": (0.1, 1.0, 10.0), "wider": (0.5, 1.0, 4.0)}),
    "samples": Study(
        prints.samples,
        {
            "motion_settled": (0.1, 2.0),
            "patch_outlier": (9.0, 30.0),
            "farthest_refined_px": (1.0, 6.0),
            "asymmetric": (0.0, 0.01, 0.04),
            "unsteady": (0.0, 0.0005, 0.002),
            "unseen_sites": (0.0, 1.0, 4.0),
            "huber": (1.5, 5.0),
            "scout_patches": (16, 1000),
            "scout_patches_px": (0.05, 1.0),
            "steps": (5, 20),
            "texels": (2.4, 9.6),
            "spread_texels": (1.0, 4.0),
            "blur_share": (0.0, 0.4, 0.9),
        },
    ),
    "calibration": Study(
        trials.calibration,
        {
            "views": (16, 100),
            "moved": (0.01, 0.1),
            "new_share": (0.1, 0.5),
            "sigmas": (3.0, 8.0),
            "for_few": (0.0, 5.0),
            "least": (0.001, 0.02),
            "floor": (0.0, 0.003),
            "most": (0.5, 0.97),
            "most_held": (0.5, 0.9),
            "telling_views": (2, 8),
            "beyond_doubt": (10.0, 100.0),
            "scattered": (3.0, 20.0),
            "scattered_views": (4, 16),
            "held": (0.3, 1.0),
            "evidence_by_chance": (10.0, 100.0),
            "shared": (0.0, 5e-3),
            "second_order": (0.0, 16.0),
        },
    ),
    "boards": Study(trials.boards, {"outlier_ratio": (2.0, 5.0), "outlier_px": (0.02, 0.5)}),
}


def current_value(path: str) -> Any:
    """Return the value of the constant at `module:NAME` or `module:NAME.field`, as JSON holds it."""
    holder, name, field = _place(path)
    value = getattr(holder, name)
    value = getattr(value, field) if field else value
    return list(value.values()) if isinstance(value, dict) else list(value) if isinstance(value, tuple) else value


@contextmanager
def changed(path: str, value: Any) -> Iterator[None]:
    """Give a constant another value while the context lasts."""
    holder, name, field = _place(path)
    before = getattr(holder, name)
    if field:
        assert is_dataclass(before)
        value = replace(before, **{field: value})  # type: ignore[type-var]
    elif isinstance(before, dict):
        value = dict(zip(before, value, strict=True))
    setattr(holder, name, value)
    try:
        yield
    finally:
        setattr(holder, name, before)


def _place(path: str) -> tuple[Any, str, str]:
    module, _, name = path.partition(":")
    name, _, field = name.partition(".")
    return importlib.import_module(f"imgu_ros.{module}"), name, field


def studied(name: str, study: Study, quick: bool) -> dict[str, Any]:
    """Run one study, print its figures, and return them."""
    start = time.process_time()
    run = study.trial(quick)
    print(f"\n{name}: {str(study.trial.__doc__).strip()}", flush=True)
    used = {key: current_value(CONSTANTS[key]) for key in study.tried}
    in_code = run()
    _print_line("values in the code", in_code, {})
    tried: dict[str, list[dict[str, Any]]] = {}
    for key, values in study.tried.items():
        tried[key] = []
        for value in values[:1] if quick else values:
            with changed(CONSTANTS[key], value):
                figures = run()
            _print_line(f"{key} {_shown(value)} instead of {_shown(used[key])}", figures, in_code)
            tried[key].append({"value": value, "figures": _rounded(figures)})
    seconds = time.process_time() - start
    print(f"{name}: {seconds:.0f} s of processor time", flush=True)
    return {"quick": quick, "used": used, "in_code": _rounded(in_code), "tried": tried}


def _print_line(name: str, figures: Mapping[str, float], in_code: Mapping[str, float]) -> None:
    """Print one value's figures: all of them, or those that differ from the first line's."""
    told = [
        f"{key} {value:.4g}" + (f" ({in_code[key]:.4g})" if in_code else "")
        for key, value in figures.items()
        if not in_code or (key != "cpu_ms" and not math.isclose(value, in_code[key], rel_tol=_SAME))
    ]
    print(f"  {name}: {', '.join(told) or 'the same'}", flush=True)


def _shown(value: Any) -> str:
    return "/".join(map(_shown, value)) if isinstance(value, list | tuple) else f"{value:g}"


def _rounded(figures: Mapping[str, float]) -> dict[str, float | None]:
    return {key: float(f"{value:.5g}") if math.isfinite(value) else None for key, value in figures.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run studies, print, and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", nargs="+", choices=tuple(STUDIES), default=tuple(STUDIES), help="default: all")
    parser.add_argument("--quick", action="store_true", help="few frames, one value of each constant")
    parser.add_argument("--json", type=Path, help="file for the figures; studies in it that are not run are kept")
    args = parser.parse_args(arguments)
    # Processor time is that of the work, not of threads that wait for each other.
    cv2.setNumThreads(1)
    document: dict[str, Any] = {}
    if args.json and args.json.exists():
        document = json.loads(args.json.read_text())
    for name in args.study:
        document.setdefault("studies", {})[name] = studied(name, STUDIES[name], args.quick)
        document["machine"] = asdict(this_machine())
        if args.json:
            args.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
