# SPDX-License-Identifier: Apache-2.0
"""Plane projective geometry: transformations of the plane, homogeneous points and lines, homographies from points.

A camera's view of a flat thing is a homography: 3x3, regular, of any scale, `x_dst ~ H_dst_src @ x_src`.

| module | holds | use it when |
|---|---|---|
| `transformations` | build, `compose`, `inverse`: translation, rotation, Euclidean, similarity, scaling, shear, affine, projective | a transformation is to be made |
| `hierarchy` | `classify` a 3x3; `Transformation.invariants`: what each class preserves | what does this matrix do? |
| `transform` | `transform` points, the local Jacobian, `faces_camera` | H is to be applied |
| `points_and_lines` | `join`, `meet`, points and the line at infinity, lines under H^-T, distances | lines, vanishing points and lines |
| `cross_ratio` | of four points on a line, of four lines through a point | what survives every view |
| `decomposition` | H into similarity, affine and projective parts; A into rotation and two scales | how far is this view from frontal? |
| `dlt`, `minimal` | homographies from correspondences, linearly | four or more true matches |
| `refine` | what a fit may minimise: transfer, symmetric, Sampson and reprojection errors | accuracy |
| `fit` | `fit_homography`: refined, with a covariance | four or more true matches |
| `estimate` | `estimate_homography`: the same by sample consensus | matches with wrong ones among them |
| `robust` | the estimators that the pipeline chooses from: ours, OpenCV's, both | matches with wrong ones among them |
| `plane_motion` | `PlaneMotion.fit`: the small motion that most displacements agree with | patches were aligned |
| `logarithm` | of a homography: the motion's velocity, any share of it | a motion is to go on |
| `homography` | `homography_normal_equations`: H and the normal equations of its displacements, two 8x8 matrices; unit norm and sign | a pose is to be fitted next |

Points are `(N, 2)`, or homogeneous `(N, 3)` where infinity is allowed; lines `(N, 3)`. What is homogeneous is returned
at a fixed scale, so that equal things are equal arrays. Angles turn x towards y: clockwise as seen in an image.

Matrices of affine maps keep the last row (0, 0, 1); estimated homographies have unit Frobenius norm and det H > 0,
since h33 may vanish. Degenerate input (singular, coincident, collinear) raises `DegenerateConfiguration`.

**In the pipeline** the parameters `homography.*` reach the estimation: `sampler`, `threshold_px`, `confidence`,
`max_iterations`, `error`, `refine`. Lines, cross ratio, hierarchy and decompositions are library alone.

Sources: IU 6.1 to 6.5, 7.2, 7.3; Hartley & Zisserman 2004 ("HZ"), chapters 2 and 4.
"""  # noqa: E501

from imgu_ros.vision.projective.checks import Pairs, checked_pairs, finite
from imgu_ros.vision.projective.cross_ratio import cross_ratio, cross_ratio_of_lines
from imgu_ros.vision.projective.decomposition import (
    AffineParts,
    HomographyParts,
    decompose_affine,
    decompose_homography,
)
from imgu_ros.vision.projective.dlt import design_matrix, homography_dlt, normalisation
from imgu_ros.vision.projective.errors import (
    algebraic_error,
    reprojection_error,
    sampson_error,
    symmetric_transfer_error,
    transfer_error,
)
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.fit import fit_homography, require_spread
from imgu_ros.vision.projective.hierarchy import Invariant, Transformation, classify
from imgu_ros.vision.projective.homography import (
    HomographyEstimate,
    HomographyNormalEquations,
    Orientation,
    homography_normal_equations,
    normalised_homography,
    tangent_basis,
)
from imgu_ros.vision.projective.inhomogeneous import homography_inhomogeneous
from imgu_ros.vision.projective.logarithm import exponential, logarithm
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.plane_motion import BlurGain, Motion, PlaneMotion
from imgu_ros.vision.projective.points_and_lines import (
    cartesian,
    homogeneous,
    join,
    line_distances,
    meet,
    normalised_lines,
    normalised_points,
    points_at_infinity,
    transform_lines,
    transform_points,
)
from imgu_ros.vision.projective.refine import (
    HomographyError,
    SampsonProblem,
    SymmetricProblem,
    TransferProblem,
    derivative_by_h,
    stepped,
)
from imgu_ros.vision.projective.reprojection import CorrectedPoints, ReprojectionProblem, corrected_points
from imgu_ros.vision.projective.robust import (
    HomographyEstimator,
    RansacParameters,
    RobustHomography,
    UsacParameters,
    ransac_estimator,
    usac_magsac_estimator,
    usac_then_ransac_estimator,
)
from imgu_ros.vision.projective.transform import area_factor, faces_camera, inverse3, local_jacobian, transform
from imgu_ros.vision.projective.transformations import (
    affine,
    cofactors,
    compose,
    euclidean,
    inverse,
    projective,
    require_regular,
    rotation,
    scaling,
    shear_x,
    shear_y,
    similarity,
    translation,
)

__all__ = [
    "AffineParts",
    "BlurGain",
    "CorrectedPoints",
    "HomographyError",
    "HomographyEstimate",
    "HomographyEstimator",
    "HomographyModel",
    "HomographyNormalEquations",
    "HomographyParts",
    "Invariant",
    "Motion",
    "Orientation",
    "Pairs",
    "PlaneMotion",
    "RansacParameters",
    "ReprojectionProblem",
    "RobustHomography",
    "SampsonProblem",
    "SymmetricProblem",
    "TransferProblem",
    "Transformation",
    "UsacParameters",
    "affine",
    "algebraic_error",
    "area_factor",
    "cartesian",
    "checked_pairs",
    "classify",
    "cofactors",
    "compose",
    "corrected_points",
    "cross_ratio",
    "cross_ratio_of_lines",
    "decompose_affine",
    "decompose_homography",
    "derivative_by_h",
    "design_matrix",
    "estimate_homography",
    "euclidean",
    "exponential",
    "faces_camera",
    "finite",
    "fit_homography",
    "homogeneous",
    "homography_dlt",
    "homography_inhomogeneous",
    "homography_normal_equations",
    "inverse",
    "inverse3",
    "join",
    "line_distances",
    "local_jacobian",
    "logarithm",
    "meet",
    "normalisation",
    "normalised_homography",
    "normalised_lines",
    "normalised_points",
    "points_at_infinity",
    "projective",
    "ransac_estimator",
    "reprojection_error",
    "require_regular",
    "require_spread",
    "rotation",
    "sampson_error",
    "scaling",
    "shear_x",
    "shear_y",
    "similarity",
    "stepped",
    "symmetric_transfer_error",
    "tangent_basis",
    "transfer_error",
    "transform",
    "transform_lines",
    "transform_points",
    "translation",
    "usac_magsac_estimator",
    "usac_then_ransac_estimator",
]
