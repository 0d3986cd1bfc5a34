"""Figures of a mobility map: colours over a hillshade, which darkens them.

Colours are multiplied by the brightness of the ground, so that those of level ground are those of
the scale.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from slipfree.atlas.atlas import ALLOWED, LIMIT, STANDING, Atlas, Band
from slipfree.core.records import Array
from slipfree.files.atlas_files import Site
from slipfree.show import style
from slipfree.show.ground_drawing import LEVEL, brightness, extent, map_axes
from slipfree.show.plots import Plot
from slipfree.show.style import MM, PAGE

LEVELS, SHOWN = 9, 98.0  # number of colours of the friction, percentile of the last one
REASONS = ("#0072B2", "#E69F00", "#CC79A7", "#56B4E9", "#F0E442", "#7F4F24", "#000000")
ALLOWED_COLOR = "#FFFFFF"
UNKNOWN = (0.75, 0.75, 0.75)  # where the vehicle stands at no heading
SMALLEST = 0.02  # of the last colour of the friction [1]
SHADE = 0.7  # of the brightness of the hillshade, so that colours are recognised
WRAP = 95  # characters of a line of a legend


class AtlasView(NamedTuple):
    """Contents of the figures of a mobility map."""

    # coordinates of the nodes of ``maps``, which may be fewer than those of the atlas [m]
    x: Array
    y: Array
    maps: Mapping[str, Band]  # maps over the headings, by name
    reasons: tuple[str, ...]  # meanings of the map ``limit``
    headings: int  # number of headings
    site: Site  # conditions


def view_of(poses: Atlas, terrain: Any) -> AtlasView:
    """Return the contents of the figures of a mobility map on a ground."""
    friction = terrain.mu
    if friction is not None and not isinstance(friction, float | int):
        friction = 1.0  # bounds are relative to a coefficient that varies
    site = Site(terrain.elevation(poses.x[:, None], poses.y), friction)
    maps, found = site.summary_of(poses, slice(None), slice(None))
    return AtlasView(poses.x, poses.y, maps, found.reasons, poses.heading.size, site)


def atlas_plots(drawn: AtlasView) -> tuple[Plot, ...]:
    """Return the figures of a mobility map, the most important first."""
    allowed = _share_words(drawn)
    plots = [Plot("headings", f"Share of headings at which {allowed}.", partial(_headings, drawn))]
    if friction_maps(drawn.maps):
        words = "Least coefficient of friction that holds the vehicle, at the best and the worst "
        plots.append(Plot("friction", f"{words}heading.", partial(_friction, drawn)))
    words = "Most frequent reason that excludes headings."
    return (*plots, Plot("limit", words, partial(_limit, drawn)))


def friction_maps(maps: Mapping[str, Band]) -> list[Band]:
    """Return the maps of the least friction at the best and the worst heading, if there are any."""
    bases = "least_friction", "least_utilisation"
    names = [f"{base}_{which}_high" for base in bases for which in ("best", "worst")]
    return [maps[name] for name in names if name in maps]


def _share_words(drawn: AtlasView) -> str:
    site = drawn.site
    words = ["the vehicle stands"]
    words += ["friction holds it"] if site.friction and ALLOWED in drawn.maps else []
    words += [f"{style.words(name)} is within its bounds" for name in site.within]
    return " and ".join([", ".join(words[:-1]), words[-1]] if words[1:] else words)


def shaded(colors: Array, drawn: AtlasView) -> Array:
    """Return colours, shape (n_x, n_y, 3), in the light of a hillshade."""
    z = drawn.maps["elevation"].values.astype(float)
    if min(z.shape) < 2:  # without slopes
        return colors
    light = brightness(drawn.x, drawn.y, z)[..., None] / LEVEL
    light = np.nan_to_num(1.0 + SHADE * (light - 1.0), nan=1.0)  # no shadows in holes
    darker, lighter = np.minimum(light, 1.0), np.maximum(light - 1.0, 0.0)
    return np.asarray(darker * colors + lighter * (1.0 - colors))


def _image(drawn: AtlasView, values: Array, scale: Colormap, norm: Normalize, ax: Axes) -> None:
    """Draw a shaded map of values; those that are NaN are gray."""
    colors = scale(norm(np.nan_to_num(values)))[..., :3]
    colors[np.isnan(values)] = UNKNOWN
    image = np.clip(shaded(colors, drawn), 0, 1).swapaxes(0, 1)
    where = extent(drawn.x, drawn.y) | {"interpolation": "nearest"}
    ax.imshow(image, **where)
    map_axes(drawn.x, drawn.y, ax).axis(where["extent"])


def _headings(drawn: AtlasView) -> Figure:
    """Draw the share of headings at which the vehicle can stand or is allowed."""
    band = drawn.maps[ALLOWED if ALLOWED in drawn.maps else STANDING]
    figure = style.figure(PAGE, PAGE)  # cropped below
    ax = figure.subplots()
    count = drawn.headings
    scale = style.RISK.reversed().resampled(min(count, 24) + 1)
    norm = Normalize(-0.5 / count, 1 + 0.5 / count)  # each number of headings has one colour
    is_hole = np.isnan(drawn.maps["elevation"].values)
    _image(drawn, np.where(is_hole, np.nan, band.values), scale, norm, ax)
    label = f"share of {count} headings [1]{', grey: no heights' * bool(is_hole.any())}"
    bar = style.side_bar(ScalarMappable(norm, scale), ax, label)
    bar.set_ticks(np.linspace(0, 1, 5))
    ax.set_title(textwrap.fill(f"Share of headings at which {_share_words(drawn)}", WRAP))
    return style.cropped(figure, ax)


def _friction(drawn: AtlasView) -> Figure:
    """Draw the least friction coefficient at the best and at the worst heading."""
    figure = style.figure(PAGE, PAGE)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    bands, scale = friction_maps(drawn.maps), style.RISK
    values = np.concatenate([band.values.ravel() for band in bands])
    values = values[np.isfinite(values)]
    largest = float(np.percentile(values, SHOWN)) if values.size else 1.0
    levels = style.ticks(LEVELS).tick_values(0.0, max(largest, SMALLEST))  # round steps from zero
    norm = BoundaryNorm(levels, scale.N, extend="max")
    for name, band, ax in zip(("best", "worst"), bands, axes, strict=True):
        _image(drawn, band.values, scale, norm, ax)
        ax.set_title(f"Least friction, {name} heading (grey: no pose)")
    axes[1].set_ylabel("")
    drawn_scale = ScalarMappable(norm, scale)
    style.side_bar(drawn_scale, axes[1], "least coefficient of friction [1]", "max")
    return style.cropped(figure, axes[0])


def _limit(drawn: AtlasView) -> Figure:
    """Draw the most frequent reason that excludes headings, by node."""
    codes = drawn.maps[LIMIT].values
    present, counts = np.unique(codes[np.isfinite(codes)].astype(int), return_counts=True)
    order = [int(code) for code in present[np.argsort(-counts)] if code]
    colors: Sequence[Any] = [ALLOWED_COLOR, *(REASONS[k % len(REASONS)] for k in range(len(order)))]
    shown = sum(k * (codes == code) for k, code in enumerate(order, 1)) + np.zeros(codes.shape)
    words = {0: "all headings are allowed"} | {code: drawn.reasons[code] for code in order}
    shares = dict(zip(present.tolist(), counts / counts.sum(), strict=True))
    labels = [
        textwrap.fill(f"{words[code]} ({100 * shares.get(code, 0):.3g} %)", WRAP)
        for code in (0, *order)
    ]
    room = 4.2 * sum(label.count("\n") + 1 for label in labels)
    figure = style.figure(PAGE, PAGE + room * MM)
    ax = figure.subplots()
    _image(drawn, shown, ListedColormap(colors), Normalize(-0.5, len(colors) - 0.5), ax)
    handles = [
        Patch(fc=color, ec="0.4", lw=0.4, label=label)
        for color, label in zip(colors, labels, strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=1)
    ax.set_title("Most frequent reason that excludes headings (share of the nodes)")
    return style.cropped(figure, ax)
