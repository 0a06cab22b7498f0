# SPDX-License-Identifier: Apache-2.0
"""What `imgu check` promises of printed targets, judged in frames of another renderer with exact truth.

    python benchmarks/target_scores.py --seeds 312 --records scores/     # keeps each print there as soon as it is done
    python benchmarks/target_scores.py --seeds 312 --each 1 --records scores/ --json figures.json --markdown page.md \
        --plot plot.png
    python benchmarks/target_scores.py --seeds 201 202 --records scores/ --slopes

Prints are those of `print_drawing.py`, views those of `print_views.py` (`target_views.py`): nothing of
`imgu_ros.simulate`, with which `imgu check` makes its own views, is in them. The pipeline searches each view by itself.

- found: share of the views with the right homography; longer side of 24 to 384 px, tilt to 60 degrees, any roll.
- score: of `imgu check`, for the same camera (640x480, focal length 600 px).
- smallest: longer side, straight on, from which on four of five views are found: as `imgu check` promises it, and of
  the views, by the same curve fitted to them. promised / measured: 1 is exact. SIFT: the same for SIFT's recipe (1000
  features, ratio test of 0.75, RANSAC at 3 px, at least 10 inliers).
- position, rotation: the median over views in the middle of the frame, tilted by 30 degrees, of three sizes, of the
  error over the promised one at that size: 1 is exact. Of two poses that fit alike the right one counts.

Constants of `imgu_ros/check/` (the slope, and what other renderers' frames make harder or more exact) were measured
with seeds 201 and 202: these are no evidence.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from print_drawing import KINDS, Print, prints
from print_judging import corner_rms, rotation_vector
from print_views import HEIGHT, RAW_PARAMETERS, WIDTH, K, Light, background, placed, rendered
from scipy.stats import spearmanr
from target_score_report import markdown_page, write_plot
from target_views import RIGHT_PX, ViewOutcome, outcomes

from imgu_ros.bench.machine import this_machine
from imgu_ros.check.accuracy import TILT_DEG, ExpectedError
from imgu_ros.check.finding import SearchTrial, fitted_curve
from imgu_ros.check.verdict import TargetCheck, check_targets
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references
from imgu_ros.vision.camera.intrinsics import make_camera

CAMERA = make_camera(K, [], "plumb_bob", WIDTH, HEIGHT)
#: Views of each size in which errors are measured; sizes between the promised smallest one and this, px.
_ERROR_VIEWS, _LARGEST_PX = 24, 300.0
#: Fewer poses tell no median.
_FEWEST = 24
#: A promise that is off by less than this factor holds.
HOLDS = 1.3
_SLOPES = (0.04, 0.06, 0.08, 0.1, 0.12, 0.16)


@dataclass
class Record:
    """What is known of one print: fields are as in the module's docstring; None: there is none.

    Attributes
    ----------
    kind, seed : which print
    found, sift_found : shares of the views
    score, reasons : of `imgu check`, kinds of reasons
    promised_px, measured_px, sift_px : longer sides
    position, rotation : ratios of errors to promised ones
    views : of which the shares are
    """

    kind: str
    seed: int
    found: float = 0.0
    sift_found: float = 0.0
    score: int = 0
    reasons: list[str] = field(default_factory=list)
    promised_px: float | None = None
    measured_px: float | None = None
    sift_px: float | None = None
    position: float | None = None
    rotation: float | None = None
    views: list[dict[str, Any]] = field(default_factory=list)


def measured(kind: str, seed: int, each: int, folder: Path | None) -> Record:
    """Return the record of one print: that of the folder where it is whole, else it is measured."""
    (shown,) = prints(seed, [kind])
    path = None if folder is None else folder / f"{kind}_{seed}.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path is not None and path.exists() else {}
    views = known.get("outcomes")
    if views is None:
        views = [asdict(each) for each in outcomes(shown, seed, parameters_from(RAW_PARAMETERS), each, recipes=True)]
    if "score" not in known:
        check = check_of(shown)
        known = {"outcomes": views, "score": check.score, "reasons": [r.kind.value for r in check.reasons]}
        known["promised_px"] = None if check.curve is None else check.curve.smallest_px()
        known["position"], known["rotation"] = error_ratios(shown, seed, check)
        if path is not None:
            path.write_text(json.dumps(known) + "\n", encoding="utf-8")
    seen = [ViewOutcome(**view) for view in views]
    record = Record(kind, seed, score=known["score"], reasons=known["reasons"], promised_px=known["promised_px"])
    record.position, record.rotation, record.views = known["position"], known["rotation"], views
    record.found = float(np.mean([view.found for view in seen]))
    record.sift_found = float(np.mean([bool(view.sift) for view in seen]))
    record.measured_px = curve_of(seen, "found").smallest_px()
    record.sift_px = curve_of(seen, "sift").smallest_px()
    return record


def curve_of(views: Sequence[ViewOutcome], by: str) -> Any:
    """Return the curve fitted to views, found by the pipeline (`found`) or by SIFT's recipe (`sift`)."""
    return fitted_curve(SearchTrial(v.seen_px, v.tilt_deg, bool(getattr(v, by)), v.wrong) for v in views)


def check_of(shown: Print) -> TargetCheck:
    """Return what `imgu check` says of a print."""
    image = TargetImage(shown.name, shown.pixels, shown.width_m)
    return check_targets([image], [f"{shown.name}.png"], Parameters(), CAMERA)[0]


def error_ratios(shown: Print, seed: int, check: TargetCheck) -> tuple[float | None, float | None]:
    """Return the medians of the errors of position and rotation over the promised ones; None: too few poses."""
    promised = [e for e in check.errors if e.position_m is not None]
    if len(promised) < 2:
        return None, None
    parameters = parameters_from(RAW_PARAMETERS | {"tracking.enabled": False})
    localizer = Localizer(
        parameters, make_references([TargetImage(shown.name, shown.pixels, shown.width_m)], parameters)
    )
    localizer.prepare()
    largest = min(_LARGEST_PX, promised[0].seen_px)
    smallest = max(1.25 * promised[-1].seen_px, 40.0)
    ratios = []
    for index, seen_px in enumerate(np.geomspace(largest, min(smallest, largest), 3)):
        rng = np.random.default_rng([seed, index, len(shown.kind), 0xACC])
        position_m, rotation_deg = at_size(promised, float(seen_px))
        for view_index in range(_ERROR_VIEWS):
            axis, roll = rng.uniform(0, 2 * math.pi, 2)
            middle = np.array((WIDTH - 1, HEIGHT - 1)) / 2
            placement = placed(shown, float(seen_px), math.radians(TILT_DEG), axis, roll, middle)
            view = rendered(shown, placement, background(rng), Light.drawn(rng), rng, 30 * view_index)
            result = localizer.process(view.frame).first
            if result.homography is None or corner_rms(result.homography.H, view.H, shown) > RIGHT_PX:
                continue
            if result.solutions:
                turns = [np.linalg.norm(rotation_vector(view.R @ pose.R.T)) for pose in result.solutions]
                best = int(np.argmin(turns))
                position = float(np.linalg.norm(view.t - result.solutions[best].t))
                ratios.append((position / position_m, math.degrees(float(turns[best])) / rotation_deg))
    if len(ratios) < _FEWEST:
        return None, None
    position, rotation = np.median(np.array(ratios), axis=0).tolist()
    return position, rotation


def at_size(promised: Sequence[ExpectedError], seen_px: float) -> tuple[float, float]:
    """Return the promised errors at a size, m and degrees: between two sizes by the logarithms."""
    sizes = np.log([e.seen_px for e in promised])[::-1]
    values = [np.log([getattr(e, name) for e in promised])[::-1] for name in ("position_m", "rotation_deg")]
    position, rotation = (math.exp(float(np.interp(math.log(seen_px), sizes, v))) for v in values)
    return position, rotation


def summary(records: Sequence[Record]) -> dict[str, Any]:
    """Return the figures over all prints."""
    both = [r for r in records if r.promised_px and r.measured_px]
    ratio = np.array([r.promised_px / r.measured_px for r in both])
    beside = [r for r in records if r.measured_px and r.sift_px]
    figures: dict[str, Any] = {
        "prints": len(records),
        "spearman": float(spearmanr([r.score for r in records], [r.found for r in records])[0]),
        "smallest": _held(ratio),
        "promised_only": sum(bool(r.promised_px) and not r.measured_px for r in records),
        "measured_only": sum(bool(r.measured_px) and not r.promised_px for r in records),
        "sift_times_as_large": float(np.exp(np.mean([math.log(r.sift_px / r.measured_px) for r in beside]))),
        "sift_never": sum(bool(r.measured_px) and not r.sift_px for r in records),
    }
    for name in ("position", "rotation"):
        figures[name] = _held(1 / np.array([getattr(r, name) for r in records if getattr(r, name)]))
    return figures


def _held(ratio: Any) -> dict[str, float]:
    inside = (ratio < HOLDS) & (ratio > 1 / HOLDS)
    p5, p50, p95 = np.percentile(ratio, (5, 50, 95)).tolist()
    return {"targets": len(ratio), "p5": p5, "p50": p50, "p95": p95, "held": int(inside.sum())}


def slopes(records: Sequence[Record]) -> dict[float, float]:
    """Return the log likelihood of the views with each slope of the curve, at each print's best size and ceiling."""
    sizes, ceilings = np.linspace(math.log(16), math.log(900), 130), np.linspace(0, 1, 41)
    likelihoods = {}
    for slope in _SLOPES:
        total = 0.0
        for record in records:
            across = np.array([v["seen_px"] * math.cos(math.radians(v["tilt_deg"])) for v in record.views])
            found = np.array([v["found"] for v in record.views])
            rise = 1 / (1 + np.exp(-(np.log(across) - sizes[:, None]) / slope))
            share = 0.01 + 0.97 * ceilings[:, None, None] * rise
            total += float(np.where(found, np.log(share), np.log1p(-share)).sum(axis=2).max())
        likelihoods[slope] = total
    return likelihoods


def main() -> None:
    """Measure, print, and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of prints and views (default 1)")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, metavar="KIND", help="(default all)")
    parser.add_argument("--each", type=int, default=2, help="views of every size and tilt (default 2: 64 in all)")
    parser.add_argument("--records", type=Path, help="folder: a print that is whole there is not measured again")
    parser.add_argument("--slopes", action="store_true", help="print how likely the views are by the curve's slope")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--markdown", type=Path, help="write a page with the table to this file")
    parser.add_argument("--plot", type=Path, help="draw the figures into this PNG file")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.records:
        arguments.records.mkdir(parents=True, exist_ok=True)
    records = []
    for seed in arguments.seeds:
        for kind in arguments.kinds:
            record = measured(kind, seed, arguments.each, arguments.records)
            records.append(record)
            pairs = {**asdict(record), "views": len(record.views)}
            print("  ".join(f"{key} {_shown(value)}" for key, value in pairs.items()), flush=True)
    if arguments.slopes:
        print(slopes(records))
    rows = [{key: value for key, value in asdict(record).items() if key != "views"} for record in records]
    figures = {"machine": asdict(this_machine()), "seeds": arguments.seeds, "summary": summary(records), "rows": rows}
    print(json.dumps(figures["summary"], indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    if arguments.markdown:
        arguments.markdown.write_text(markdown_page(figures, __doc__ or ""), encoding="utf-8")
    if arguments.plot:
        write_plot(arguments.plot, figures)


def _shown(value: object) -> object:
    return f"{value:.3g}" if isinstance(value, float) else value


if __name__ == "__main__":
    main()
