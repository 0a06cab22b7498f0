# SPDX-License-Identifier: Apache-2.0
"""Where things are in a Rerun recording, and how its viewer shows them."""

from __future__ import annotations

import rerun.blueprint as rrb

from imgu_ros.view.results_folder import ReplayResults

#: Entities: pictures, what is drawn over them, what is in space, curves, and status over time.
IMAGE = "world/camera/image"
OVERLAY = f"{IMAGE}/results"
SPACE = "world/results"
PLOTS = "plots"
STATES = "status"

#: Views of further targets are tabs, at most so many.
_MOST_OTHERS = 8


def blueprint(results: ReplayResults) -> rrb.Blueprint:
    """Return the layout: pictures and space beside each other, below them curves and status over time."""
    others = [
        rrb.Spatial3DView(origin=f"around/{name}", name=f"Camera before {name}")
        for name in results.targets[1 : 1 + _MOST_OTHERS]
    ]
    main = results.targets[0] if results.targets else "target"
    space = rrb.Spatial3DView(origin="world", name=f"Camera before {main}")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin=IMAGE, name="Frames"),
                rrb.Tabs(space, *others) if others else space,
            ),
            rrb.Horizontal(
                rrb.Vertical(
                    rrb.TimeSeriesView(origin=f"{PLOTS}/residual", name="Residual, px rms"),
                    rrb.TimeSeriesView(origin=f"{PLOTS}/confirmed", name="Confirmed share"),
                ),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin=f"{PLOTS}/distance", name="Distance, m"),
                    rrb.Tabs(
                        rrb.StateTimelineView(origin=STATES, name="Status"),
                        rrb.TextLogView(origin="log", name="Reasons"),
                    ),
                ),
            ),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )
