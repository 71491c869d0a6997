"""How the viewer opens: mechanism and plate on the left, plots on the right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from twin.hal.interface import SCREEN
from twin.view.signals import ORANGE, PLOTS, WORDS

Words = Mapping[str, str]
"""Entity of a plot to which line of it has which colour."""
Ranges = Mapping[str, tuple[float, float]]
"""Entity of a plot to what its axis shows."""
GROUND, SKY = (16, 18, 22), (30, 33, 38)
"""Colours of the ground of plots and plate and of the mechanism's, whatever theme a viewer has: no
recording and no blueprint can choose it, and lines that are seen on this are not on white."""


def blueprint(
    roots: Sequence[str],
    groups: Words,
    timeline: str,
    *,
    live: bool = False,
    ranges: Ranges | None = None,
) -> rrb.Blueprint:
    """The arrangement for one run, or for several side by side.

    Args:
        roots: Root entities of the runs.
        groups: Entities of the plots there are, below each root, and which line has which colour.
            A legend would cover the lines, so that stands in the titles.
        timeline: Name of the time line.
        live: Whether a run in progress is watched: then dropped rows are plotted, too.
        ranges: Entities of the plots to what their axis shows, where the lines are known.
    """
    worlds = [_world(root, len(roots) > 1) for root in roots]
    left = rrb.Vertical(
        rrb.Horizontal(*worlds) if len(worlds) > 1 else worlds[0],
        rrb.Horizontal(
            _plate(roots, groups),
            rrb.Vertical(_state(roots), _events(roots), row_shares=[1, 2]),
            column_shares=[2, 1],
        ),
        row_shares=[3, 2],
    )
    tabs = {name: _plots(roots, groups, titles, ranges or {}) for name, titles in PLOTS.items()}
    if live:
        missed = rrb.TimeSeriesView(origin="/view", name="rows the view missed [1]")
        tabs["estimates and time"].append(missed)
    right = rrb.Tabs(*(rrb.Vertical(*plots, name=name) for name, plots in tabs.items() if plots))
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline),
    )


def _plots(
    roots: Sequence[str], groups: Words, titles: Mapping[str, str], axes: Ranges
) -> list[rrb.TimeSeriesView]:
    return [
        rrb.TimeSeriesView(
            origin="/" if len(roots) > 1 else f"{roots[0]}/{entity}",
            contents=_lines(roots, entity),
            name=f"{title}: {groups[entity]}",
            background=rrb.archetypes.PlotBackground(color=GROUND),
            plot_legend=rrb.PlotLegend(visible=False),
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
            axis_y=rrb.ScalarAxis(range=axes[entity]) if entity in axes else None,
        )
        for entity, title in titles.items()
        if entity in groups
    ]


def _lines(roots: Sequence[str], group: str) -> list[str]:
    """What a plot contains; of several runs only what tells them apart."""
    wanted = [f"+ {root}/{group}/**" for root in roots]
    if len(roots) == 1:
        return wanted
    for root in roots:
        wanted += [f"- {root}/{group}/{name}" for name in ("estimate", "measured")]
        if group == "error_mm":
            wanted += [f"- {root}/{group}/{name}" for name in "xy"]
    for root in roots[1:]:
        shared = ("reference", "limit_high", "limit_low", "dead_time")
        wanted += [f"- {root}/{group}/{name}" for name in shared]
    return wanted


def _world(root: str, several: bool) -> rrb.Spatial3DView:
    title = (
        root.removeprefix("/").replace("\\", "")
        if several
        else "mechanism (green: forces on wheels and ball)"
    )
    return rrb.Spatial3DView(
        origin=f"{root}/mechanism",
        name=title,
        background=rrb.Background(color=SKY),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=(-0.75, 0.63, 0.32), look_target=(0.0, 0.0, -0.12), eye_up=(0, 0, 1)
        ),
    )


def _plate(roots: Sequence[str], groups: Words) -> rrb.Spatial2DView:
    ball = "ball blue" if len(roots) == 1 else groups["position_x_mm"]
    x, y = (550 * side for side in SCREEN)
    return rrb.Spatial2DView(
        origin=f"{roots[0]}/plate_mm" if len(roots) == 1 else "/",
        contents=[f"+ {root}/plate_mm/**" for root in roots],
        name=f"from above [mm]: {ball}, reference white, estimate {WORDS[ORANGE]}, touch grey",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[-x, x], y_range=[-y, y]),
    )


def _state(roots: Sequence[str]) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(
        origin="/", contents=[f"+ {root}/supervisor" for root in roots], name="supervisor state"
    )


def _events(roots: Sequence[str]) -> rrb.TextLogView:
    kinds = ("EntityPath", "Body") if len(roots) > 1 else ("Body",)
    shown = [rrb.encodings.TextLogColumn(kind) for kind in kinds]
    return rrb.TextLogView(
        origin="/",
        contents=[f"+ {root}/events" for root in roots],
        name="events",
        columns=rrb.archetypes.TextLogColumns(text_log_columns=shown),
    )
