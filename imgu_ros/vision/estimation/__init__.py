# SPDX-License-Identifier: Apache-2.0
"""From measurements with errors, some of them wrong, to a model and its covariance.

| what is given | use |
|---|---|
| equations linear in the unknowns | `least_squares`, with a covariance of the noise where it is known |
| linear, with errors on both sides | `total_least_squares`; `homogeneous_least_squares` for A x = 0 |
| points near a line, at any angle | `fit_line` |
| pairs of directions, one set turned | `align_directions` |
| residuals and their derivative | `minimise`: Levenberg-Marquardt, Gauss-Newton or steepest descent |
| measurements of which some are wrong | `ransac` with a model; then `minimise`, perhaps with a robust loss |

**Minimising.** A problem gives its residuals, their derivative and what a step does (`LeastSquaresProblem`), so that
rotations and homographies step on their own surfaces. Levenberg-Marquardt is the choice for nearly all; Gauss-Newton
saves nothing but the damping; steepest descent needs tens of times as many steps and is here to be compared.
Every `Minimum` tells its iterations, and `propagated_covariance` turns it into a covariance of the parameters.

**Consensus.** A model draws hypotheses from samples, tells errors, and refits (`RobustModel`): `LineModel`,
`DirectionsModel`, `HomographyModel` of the projective chapter, `ProjectionModel` of the camera's. Two scores:
`truncated` (MSAC) is fast and right where a third or more of the points agree; `biweight` looks 8/3 thresholds far,
fits the most promising hypotheses of each batch by weight, draws again where a sample gives no hypothesis, and so
finds few inliers among many wrong matches, at several times the cost. It depends less on the threshold.

**Chance.** Wrong data agree with some hypothesis, too. A model that can tell how likely they do (`ChanceModel`: all of
this package) lets `ransac` refuse what they explain; that depends on how many there are, how near each other they lie,
the threshold, and how many hypotheses were tried, none of which a fixed number of inliers knows.

**PROSAC** (`sampler="prosac"`) takes points sorted best first, samples the best before the others, and stops by the
share of inliers among the best: often within its first 16 samples where uniform sampling takes thousands.

Robust losses: `huber` (convex), `cauchy`, `tukey` (an outlier loses all weight; needs a good start).

In the pipeline: `homography.sampler`, `homography.score`, `homography.threshold_px`, `homography.confidence`,
`homography.max_iterations`, `homography.min_inliers`, `homography.error`, `homography.refine`.
Sources: IU 7.1 to 7.3, 7.5, 7.6; Hartley & Zisserman 2004, chapters 4 and 5, appendices 5 and 6.
"""

from imgu_ros.vision.estimation.chance import Agreement, ChanceModel, binomial_tail, pair_probability, shares_of_places
from imgu_ros.vision.estimation.covariance import propagated_covariance, selection_efficiency, window_correlation
from imgu_ros.vision.estimation.directions import DirectionsModel, align_directions
from imgu_ros.vision.estimation.line import LineEstimate, LineModel, fit_line
from imgu_ros.vision.estimation.linear import (
    LinearEstimate,
    homogeneous_least_squares,
    least_squares,
    shape_of,
    total_least_squares,
)
from imgu_ros.vision.estimation.losses import cauchy, huber, tukey
from imgu_ros.vision.estimation.nonlinear import LeastSquaresProblem, Linearisation, Minimiser, Minimum, minimise
from imgu_ros.vision.estimation.ransac import Proposal, accepted, iterations_needed, ransac
from imgu_ros.vision.estimation.sampling import Sampler, draw_samples
from imgu_ros.vision.estimation.search import Consensus, RobustModel, Score, WeightedModel
from imgu_ros.vision.estimation.settling import InlierFit, SettledFit

__all__ = [
    "Agreement",
    "ChanceModel",
    "Consensus",
    "DirectionsModel",
    "InlierFit",
    "LeastSquaresProblem",
    "LineEstimate",
    "LineModel",
    "LinearEstimate",
    "Linearisation",
    "Minimiser",
    "Minimum",
    "Proposal",
    "RobustModel",
    "Sampler",
    "Score",
    "SettledFit",
    "WeightedModel",
    "accepted",
    "align_directions",
    "binomial_tail",
    "cauchy",
    "draw_samples",
    "fit_line",
    "homogeneous_least_squares",
    "huber",
    "iterations_needed",
    "least_squares",
    "minimise",
    "pair_probability",
    "propagated_covariance",
    "ransac",
    "selection_efficiency",
    "shape_of",
    "shares_of_places",
    "total_least_squares",
    "tukey",
    "window_correlation",
]
