"""Reference frames of headings.

Motions are computed and stored in the frame "paper": headings are measured from the y axis. In the
frame "rep103" (ROS convention) they are measured from the x axis. Printed, exported and drawn
headings are in the frame of the problem.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Literal

from slipfree.records import Label
from slipfree.trajectory import Column, Trajectory

Frame = Literal["paper", "rep103"]
STORED = "frame"  # attribute of a motion: frame of its samples
WANTED = "problem_frame"  # attribute of a motion: frame of its problem
OFFSET: dict[str, float] = {"paper": 0.0, "rep103": pi / 2}  # heading minus that from y [rad]
HEADING = Label("heading", "rad", "counter-clockwise angle of the forward axis from the x axis")


def to_problem_frame(run: Trajectory) -> Trajectory:
    """Return a motion with its heading in the frame of its problem.

    Parameters
    ----------
    run : Trajectory
        The motion. It is returned unchanged if it has no heading, if it has no attribute
        ``problem_frame``, or if its heading is already in that frame.
    """
    stored = run.attributes.get(STORED, "paper")
    wanted = run.attributes.get(WANTED, stored)
    if wanted == stored or not {wanted, stored} <= set(OFFSET) or "heading" not in run.columns:
        return run
    heading = run["heading"] + (OFFSET[wanted] - OFFSET[stored])
    columns = {**run.columns, "heading": Column(HEADING, heading)}
    return replace(run, columns=columns, attributes={**run.attributes, STORED: wanted})
