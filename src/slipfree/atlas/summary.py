"""Maps of a single value for each node, from the poses of all headings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from slipfree.atlas.atlas import REASON, Atlas, Band, least_bounds
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Indices, Label
from slipfree.core.trajectory import heading_column

ELEVATION = quantity_label("elevation")
SLIDES = "friction does not hold the vehicle"
UNDECIDED = "the bounds of the least friction do not decide"
OUT_OF_BOUNDS = "{} is not within its bounds"
# beginnings of bands whose smallest values matter
SMALLEST = "tip_over_margin", "clearance", "proved"
SIGNED = "energy_per_metre"  # negative where the vehicle brakes
STANDING, ALLOWED, LIMIT = "share_standing", "share_allowed", "limit"
Bounds = Mapping[str, tuple[float, float]]


class Verdicts(NamedTuple):
    """Why the vehicle may not stay at each pose.

    ``codes``, shape (n_headings, n_x, n_y), are indices of ``reasons``; 0 where it may stay.
    """

    codes: Indices
    reasons: tuple[str, ...]

    @property
    def allowed(self) -> Array:
        """Share of headings at which the vehicle may stay, shape (n_x, n_y)."""
        return np.asarray((self.codes == 0).mean(axis=0))

    @property
    def limit(self) -> Array:
        """Most frequent reason at each node, shape (n_x, n_y); 0 if every heading is allowed."""
        codes = range(1, len(self.reasons))
        counts = np.stack([(self.codes == code).sum(axis=0) for code in codes])
        return np.where(counts.any(axis=0), 1 + counts.argmax(axis=0), 0)


def verdicts(poses: Atlas, *, friction: float | None, within: Bounds) -> Verdicts:
    """Return the reasons for which a vehicle may not stay at the poses of an atlas.

    ``friction`` is the coefficient at the wheel with the best grip, which must hold the vehicle; 1
    with a map of friction, None on a ground without. ``within`` are bounds of bands by name;
    ModelError is raised for an unknown one.
    """
    reasons, codes = list(poses.reasons), poses[REASON.name].astype(int)
    least = least_bounds(poses)
    if friction is not None and least is not None:
        reasons += [SLIDES, UNDECIDED]
        for bound, reason in zip(least, (SLIDES, UNDECIDED), strict=True):
            codes[(codes == 0) & (poses[bound.name] > friction)] = reasons.index(reason)
    for name, (low, high) in within.items():
        values = poses[name]
        reasons.append(OUT_OF_BOUNDS.format(name))
        codes[(codes == 0) & ~((values >= low) & (values <= high))] = len(reasons) - 1
    return Verdicts(codes, tuple(reasons))


def summary(
    poses: Atlas, found: Verdicts, elevation: Array, frame: str = "paper"
) -> dict[str, Band]:
    """Return maps over the headings, by name: bands of shape (n_x, n_y).

    ``elevation`` are the heights of the nodes [m], ``frame`` is that of headings.
    """
    words = "share of headings at which the vehicle stands"
    maps = [Band(Label(STANDING, "1", words), np.asarray(poses.stands.mean(axis=0)))]
    if len(found.reasons) > len(poses.reasons):
        words += f" and none of the reasons of the band '{LIMIT}' applies"
        maps.append(Band(Label(ALLOWED, "1", words), found.allowed))
    maps.append(
        Band(Label(LIMIT, "1", "most frequent reason that excludes headings; 0: none"), found.limit)
    )
    least = least_bounds(poses)
    if least is not None:
        maps += _friction_maps(poses, least, frame)
    for label, values in poses.bands.values():
        if label not in (REASON, *(least or ())):
            maps += _extremes(label, values)
    maps.append(Band(ELEVATION, elevation))
    return {band.label.name: band for band in maps}


def _friction_maps(poses: Atlas, least: tuple[Label, Label], frame: str) -> Sequence[Band]:
    """Return both bounds of the least friction at the best and the worst heading, and these.

    Coefficients without a bound are NaN: then no forces were found that hold the vehicle.
    """
    maps = list[Band]()
    for name, largest in (("best", False), ("worst", True)):
        for label in least:
            values = poses.extreme(label.name, largest=largest)[0]
            base, _, end = label.name.rpartition("_")
            words = f"{name} of the headings at which the vehicle stands: {label.words}"
            renamed = Label(f"{base}_{name}_{end}", label.unit, words)
            maps.append(Band(renamed, np.where(np.isfinite(values), values, np.nan)))
        bound, at = poses.extreme(least[1].name, largest=largest)
        if not largest:  # all headings are equally bad without forces
            at = np.where(np.isfinite(bound), at, np.nan)
        label, turned = heading_column(at, frame)
        words = f"heading with the {'largest' if largest else 'smallest'} {least[1].name}"
        label = Label(f"heading_{name}", "degree", f"{words}; {label.words}")
        maps.append(Band(label, np.mod(np.rad2deg(turned), 360.0)))
    return maps


def _extremes(label: Label, values: Array) -> Iterator[Band]:
    """Yield the smallest value of margins, both of signed quantities, or the largest magnitude."""
    kinds = ["magnitude"]
    if label.name.startswith(SMALLEST):
        kinds = ["smallest"]
    elif label.name == SIGNED:
        kinds = ["smallest", "largest"]
    for kind in kinds:
        if kind == "smallest":
            extreme = np.fmin.reduce(values)
        else:
            extreme = np.fmax.reduce(np.abs(values) if kind == "magnitude" else values)
        words = "largest magnitude" if kind == "magnitude" else f"{kind} value"
        name = f"{label.name}_{'smallest' if kind == 'smallest' else 'largest'}"
        new = Label(name, label.unit, f"{words} over the headings: {label.words}")
        yield Band(new, extreme)
