# SPDX-License-Identifier: Apache-2.0
"""Algorithms from arrays to arrays, in ten rooms; they need numpy, scipy and OpenCV, and nothing of ROS.

Each room exports its public functions and classes: `from imgu_ros.vision.projective import estimate_homography`. This
package itself imports nothing; the rooms are `formation`, `processing`, `scale_space`, `keypoints`, `descriptors`,
`matching`, `projective`, `estimation` and `camera`, in the order in which light becomes a pose; and `markers`.

Sources are papers by author and year, HZ (Hartley & Zisserman 2004), and IU, lecture notes whose sections
`docs/references.md` leads to texts with the same content.

What arguments may be, the same in all rooms:

- Images are (H, W) or (H, W, 3) RGB, uint8, uint16 or float32 in [0, 1]. float64, bool and other integers are taken
  too; `imgu_ros.types.as_image` says as what. Views, Fortran order and either byte order are right; masked arrays are
  refused.
- Points are (N, 2), or what OpenCV returns, (N, 1, 2) or a list of cv2.KeyPoint, or lists of pairs; an empty list is no
  points. Lines, matrices and weights may be lists as well.
- Where randomness enters, `rng` is a numpy Generator or a seed.
- What cannot be meant raises `ShapeError`, one line with the argument's name, what was got and what is needed.

A function or method whose name ends in `unchecked` does the same without checking its arguments. The pipeline calls
these with arrays that it made itself, so that a tracked frame is not validated again and again; they are not exported.
"""
