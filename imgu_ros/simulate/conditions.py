# SPDX-License-Identifier: Apache-2.0
"""What real cameras do to a target, one thing at a time, as named conditions of otherwise the same frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

from imgu_ros.errors import ParameterError, nearest_name
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.path import CameraMotion
from imgu_ros.simulate.placing import Placing
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.formation.transfer import TransferFunction


class SceneContent(StrEnum):
    """What stands before the camera."""

    TARGET = "target"  #: the known target
    REPEATED = "repeated"  #: a known target whose tiles are all alike but a few
    TWO_COPIES = "two_copies"  #: the known target, printed twice: either is an answer
    LOOK_ALIKES = "look_alikes"  #: two known targets with the same header
    ABSENT = "absent"  #: one that looks like the known target, which is not there


@dataclass(frozen=True, slots=True)
class Condition:
    """One thing that makes it harder, and how much of it.

    Attributes
    ----------
    name : words joined by `-`, as on the command line
    description : for people
    show : what stands before the camera
    placing : what is prescribed of the view
    capture : how the camera takes the picture, but for its row time: see `readout`
    occluded : share of the target's area behind something opaque
    specular : share of the target's area that highlights saturate
    blur_px, defocus_px : length of motion blur, diameter of the defocus disc
    exposure_steps : the exposure doubles or halves from frame to frame, every third frame
    flicker : amplitude of the light's waves that run over the rows
    vignetting : share of the light that the corners lose
    snr : mean over standard deviation of a pixel on the target; None: of a good sensor in good light
    lens : distortion model; None: a pinhole
    readout : share of the frame period from the first row's exposure to the last row's
    extreme : harder than what a chain can be asked to bear; told, but no frame of it need be found
    """

    name: str
    description: str
    show: SceneContent = SceneContent.TARGET
    placing: Placing = field(default_factory=Placing)
    capture: Capture = field(default_factory=Capture)
    occluded: float = 0.0
    specular: float = 0.0
    blur_px: float = 0.0
    defocus_px: float = 0.0
    exposure_steps: bool = False
    flicker: float = 0.0
    vignetting: float = 0.0
    snr: float | None = None
    lens: DistortionModel | None = None
    readout: float = 0.0
    extreme: bool = False


PLAIN = Condition("plain", "full roll, tilt to 35 degrees, distance x2.4; nothing else")

CONDITIONS: tuple[Condition, ...] = (
    PLAIN,
    *(Condition(f"occlusion-{p}", f"{p} % of the target hidden", occluded=p / 100) for p in (20, 40, 60)),
    *(
        Condition(f"outside-{p}", f"{p} % of the target outside the frame", placing=Placing(outside=p / 100))
        for p in (30, 50)
    ),
    *(Condition(f"blur-{n}", f"motion blur of {n} px", blur_px=n, extreme=n > 10) for n in (5, 10, 15)),
    Condition("exposure-steps", "exposure x2 or x0.5 from frame to frame", exposure_steps=True),
    Condition("flicker", "light that waves by 30 %, in rows and in time", flicker=0.3),
    Condition("vignetting", "corners lose 70 % of the light", vignetting=0.7),
    Condition("specular", "highlights saturate 20 % of the target", specular=0.2),
    *(Condition(f"defocus-{n}", f"out of focus, a disc of {n} px", defocus_px=n) for n in (4, 8)),
    Condition("noise-snr-10", "signal to noise 10 in every pixel", snr=10.0),
    Condition(
        "no-white-balance",
        "red has 0.5, blue 0.65 of the sensitivity of green",
        capture=Capture(sensitivities=(0.5, 1.0, 0.65)),
    ),
    *(
        Condition(f"transfer-{transfer}", f"values follow the {name} curve", capture=Capture(transfer=transfer))
        for transfer, name in ((TransferFunction.SRGB, "sRGB"), (TransferFunction.FILM, "film"))
    ),
    *(
        Condition(f"saturated-{p}", f"{p} % of the pixels at the white level", capture=Capture(saturated=p / 100))
        for p in (2, 10, 30)
    ),
    Condition("plumb-bob", "lens with plumb_bob distortion", lens=DistortionModel.PLUMB_BOB),
    Condition("equidistant", "lens with equidistant distortion", lens=DistortionModel.EQUIDISTANT),
    Condition("rolling-shutter", "read out during a fifth of the frame period", readout=0.2),
    *(
        Condition(f"size-{p}", f"target {p} % as wide as the frame", placing=Placing(width_share=p / 100))
        for p in (10, 30, 100, 200, 300)
    ),
    *(
        Condition(f"tilt-{a}", f"tilt of {a} degrees", placing=Placing(tilt_rad=math.radians(a)), extreme=a > 60)
        for a in (20, 40, 60, 70)
    ),
    Condition("roll", "three turns in the image plane", placing=Placing(motion=CameraMotion(turns=3.0))),
    Condition("repeated-texture", "16 of 20 tiles of the target are alike", show=SceneContent.REPEATED),
    Condition("two-copies", "the target printed twice", show=SceneContent.TWO_COPIES),
    Condition("look-alikes", "two targets with the same header", show=SceneContent.LOOK_ALIKES),
    Condition("no-target", "only one that looks like the target", show=SceneContent.ABSENT),
)


def condition_named(name: str) -> Condition:
    """Return the condition of that name.

    Raises
    ------
    ParameterError
        If there is none; the message names the nearest known one.
    """
    for condition in CONDITIONS:
        if condition.name == name:
            return condition
    names = [condition.name for condition in CONDITIONS]
    near = nearest_name(name, names)
    hint = f"nearest known: {near}" if near else f"need one of {', '.join(names)}"
    raise ParameterError(f"condition: {name!r}; {hint}")
