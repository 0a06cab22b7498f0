"""Plane projective geometry: transformations of the plane, homogeneous points and lines, homographies from points.

A camera's view of a flat thing is a homography: 3x3, regular, of any scale, `x_dst ~ H_dst_src @ x_src`.

| module | holds | use it when |
|---|---|---|
| `transformations` | build, `compose`, `inverse`: translation, rotation, Euclidean, similarity, scaling, shear, affine, projective | a transformation is to be made |
| `hierarchy` | `classify` a 3x3; `Transformation.invariants`: what each class preserves | what does this matrix do? |
| `transform` | `transform` points, the local Jacobian, unit norm and sign, `faces_camera` | H is to be applied |
| `points_and_lines` | `join`, `meet`, points and the line at infinity, lines under H^-T, distances | lines, vanishing points and lines |
| `cross_ratio` | of four points on a line, of four lines through a point | what survives every view |
| `decomposition` | H into similarity, affine and projective parts; A into rotation and two scales | how far is this view from frontal? |
| `dlt`, `minimal` | homographies from correspondences, linearly | four or more true matches |
| `refine` | what a fit may minimise: transfer, symmetric, Sampson and reprojection errors | accuracy |
| `estimate` | `estimate_homography`, `fit_homography`: robust, refined, with a covariance | matches with wrong ones among them |
| `increments` | `PlaneMotion.fit`: the small motion that most displacements agree on | patches were aligned |
| `logarithm` | of a homography: the motion's velocity, any share of it | a motion is to go on |
| `condensed` | `condensed_homography`: H and all that its displacements tell, in two 8x8 matrices | a pose is to be fitted next |

Points are `(N, 2)`, or homogeneous `(N, 3)` where infinity is allowed; lines `(N, 3)`. What is homogeneous is returned
at a fixed scale, so that equal things are equal arrays. Angles turn x towards y: clockwise as seen in an image.

Matrices of affine maps keep the last row (0, 0, 1); estimated homographies have unit Frobenius norm and det H > 0,
since h33 may vanish. Degenerate input (singular, coincident, collinear) raises `DegenerateConfiguration`.

**In the chain** the parameters `homography.*` reach the estimation: `sampler`, `threshold_px`, `confidence`,
`max_iterations`, `error`, `refine`. Lines, cross ratio, hierarchy and decompositions are library alone.

Sources: notes 6.1 to 6.5, 7.2, 7.3; Hartley & Zisserman 2004 ("HZ"), chapters 2 and 4.
"""  # noqa: E501
