"""Random grounds, vehicles and inputs, and the possible outcomes of their motions.

A case is drawn from its seed as a few words and numbers, so that it can be printed and changed;
``outcome`` builds it, drives, and lists all violated expectations. It checks the residuals and
limits that a run reports, and facts that follow from the saved poses alone: joints and rotations
are composed here again, with SciPy, and speeds are finite differences.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import remainder
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.vehicles import all_steered, four_wheels, part_frames, skid_steered
from slipfree.catalog import three_wheeler
from slipfree.core.records import leaves
from slipfree.problem.schema import SLIP_LAWS
from slipfree.terrain.rolled import rolled
from slipfree.terrain.synthetic import blank, craters, power_law, ramp, rocks

SIDE = 12.0  # of a map, in the middle of which the vehicles start [m]
UTM = (431_250.0, 5_312_740.0, 812.0)  # where maps with large coordinates lie [m]
STENCIL = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12  # first derivative, fourth order


class Case(NamedTuple):
    """A random problem, in words; the numbers behind each word are drawn from the seed."""

    seed: int
    ground: str
    rolled: bool
    utm: bool
    vehicle: str
    wheels: str
    formulation: str
    slip: str
    start: str
    inputs: str
    tolerance: float

    def rng(self, part: str) -> np.random.Generator:
        """Return the random numbers of one part, whatever the other parts draw."""
        return np.random.default_rng([self.seed, *part.encode()])


@dataclass
class Outcome:
    """What became of a case.

    Attributes
    ----------
    kind : str
        ``refused``, ``complete``, ``stopped`` or ``solver``.
    cause : str
        What refused it or ended it.
    words : str
        The message.
    faults : list of str
        What is not as it must be.
    measures : dict of str to float
        Sizes of errors and costs.
    """

    kind: str
    cause: str = ""
    words: str = ""
    faults: list[str] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)


def draw(seed: int, **changes: Any) -> Case:
    """Return the case of a seed, some of its words changed."""
    rng = np.random.default_rng([seed, 0])

    def one(choices: dict[str, Any]) -> str:
        return str(rng.choice(list(choices), p=_shares(choices)))

    case = Case(
        seed,
        one(GROUND_SHARES),
        bool(rng.random() < 0.3),
        bool(rng.random() < 0.25),
        one(VEHICLE_SHARES),
        one({"torus": 6, "disc": 2, "sphere": 2}),
        one({"closure": 4, "montana": 1}),
        one({"least": 5, "rolling": 5}),
        one(START_SHARES),
        one(INPUT_SHARES),
        float(10 ** -rng.uniform(4, 10)),
    )
    if case.vehicle not in ("tilting", "sliding") and rng.random() < 0.8:
        case = case._replace(slip="least")  # few others can roll
    if case.wheels == "disc" and rng.random() < 0.8:
        case = case._replace(formulation="closure")  # the other refuses discs
    return case._replace(**changes)


def _shares(choices: dict[str, float]) -> np.ndarray:
    shares = np.array(list(choices.values()), dtype=float)
    return shares / shares.sum()


# --- grounds --------------------------------------------------------------------------------------


def _hills(rng: np.random.Generator) -> sf.Analytic:
    """Three waves, from 1 cm to 1 m high."""
    waves = [(*rng.normal(0, rng.uniform(0.3, 2.0), 2), rng.uniform(0, 6)) for _ in range(3)]
    height = 10 ** rng.uniform(-2, 0)
    return sf.Analytic(lambda x, y: height * sum(ca.sin(a * x + b * y + c) for a, b, c in waves))


def _slope(rng: np.random.Generator) -> sf.Analytic:
    """A plane, up to one on which a vehicle counts as overturned."""
    a, b = rng.normal(0, rng.choice([0.1, 0.5, 5.0]), 2)
    return sf.Analytic(lambda x, y: a * x + b * y)


def _bowl(rng: np.random.Generator) -> sf.Analytic:
    """The inside of a sphere: no finite height beyond its rim."""
    radius = rng.uniform(2, 8)
    return sf.Analytic(lambda x, y: radius - ca.sqrt(radius**2 - x**2 - y**2))


def _cliff(rng: np.random.Generator) -> sf.Analytic:
    """A step of up to 2 m within centimetres to metres."""
    rise, width, place = rng.uniform(0.1, 2), 10 ** rng.uniform(-2, 0), rng.uniform(0, 2)
    return sf.Analytic(lambda _, y: rise * ca.tanh((y - place) / width))


def _map(side: float = SIDE, spacing: float = 0.2) -> sf.Grid:
    return blank((-side / 2, side / 2), (-side / 2, side / 2), spacing)


def _rough(rng: np.random.Generator, grid: sf.Grid | None = None) -> sf.Grid:
    """Self-affine roughness, 2 mm to 0.6 m, mild to violent."""
    return power_law(
        grid or _map(),
        rms=10 ** rng.uniform(-2.7, -0.2),
        hurst=rng.uniform(0.4, 1.0),
        longest=rng.uniform(4, 12),
        shortest=rng.uniform(0.5, 3),
        seed=int(rng.integers(1000)),
    )


def _craters(rng: np.random.Generator) -> sf.Grid:
    count = int(rng.integers(1, 60))
    return craters(_map(), count=count, diameters=(0.8, 5.0), seed=int(rng.integers(1000)))


def _rocks(rng: np.random.Generator) -> sf.Grid:
    return rocks(
        _map(spacing=0.1),
        count=int(rng.integers(1, 150)),
        diameters=(0.3, 1.5),
        height_ratio=rng.uniform(0.05, 0.8),
        seed=int(rng.integers(1000)),
    )


def _ramp(rng: np.random.Generator) -> sf.Grid:
    start, rise, smooth = rng.uniform(-2, 2), rng.uniform(-2, 2), bool(rng.random() < 0.7)
    return ramp(_map(), start=start, end=start + rng.uniform(0.5, 4), rise=rise, smooth=smooth)


def _coarse(rng: np.random.Generator) -> sf.Grid:
    """Four nodes a side, the fewest a spline can have."""
    axis = np.linspace(-6, 6, 4)
    return sf.Grid(axis, axis, 0.3 * rng.normal(size=(4, 4)))


GROUNDS: dict[str, Callable[[np.random.Generator], Any]] = {
    **{"hills": _hills, "slope": _slope, "bowl": _bowl, "cliff": _cliff, "rough": _rough},
    **{"craters": _craters, "rocks": _rocks, "ramp": _ramp},
    "small": lambda rng: _rough(rng, _map(float(rng.choice([3.0, 4.0, 5.0])))),
    **{"coarse": _coarse, "flat": lambda _: _map()},
    "plane": lambda _: sf.Analytic(lambda x, _: 0 * x),
}
GROUND_SHARES = dict.fromkeys(GROUNDS, 1.0) | {"rough": 4, "hills": 3, "rocks": 2, "small": 2}


def ground_of(case: Case, radius: float) -> sf.Analytic | sf.Bicubic:
    """Return the ground of a case, for wheels of a radius."""
    made = GROUNDS[case.ground](case.rng("ground"))
    if isinstance(made, sf.Analytic):
        return made
    grid = rolled(made, radius).grid if case.rolled else made
    x, y, z = UTM if case.utm else (0.0, 0.0, 0.0)
    return sf.Bicubic(sf.Grid(grid.x + x, grid.y + y, grid.z + z))


# --- vehicles -------------------------------------------------------------------------------------


def _axles(axle: str) -> Callable[[np.random.Generator, str], sf.Vehicle]:
    def make(rng: np.random.Generator, wheels: str) -> sf.Vehicle:
        radius, share = rng.uniform(0.15, 0.4), rng.uniform(0.05, 0.6)
        r1 = {"torus": share, "disc": 0.0, "sphere": 1.0}[wheels] * radius
        stop = rng.uniform(0.02, 0.6) if rng.random() < 0.4 else np.inf
        return three_wheeler(
            axle=axle,
            half_track=rng.uniform(0.4, 1.2),
            wheelbase=rng.uniform(0.6, 2.0),
            r1=r1,
            r2=radius - r1,
            tilt_stop=stop,
            slide_stop=stop,
        )

    return make


VEHICLES: dict[str, Callable[[np.random.Generator, str], sf.Vehicle]] = {
    **{
        each: _axles(each)
        for each in ("tilting", "sliding", "prismatic", "prismatic_undriven", "actuated", "fixed")
    },
    "four_wheels": lambda *_: four_wheels(rock=True),
    "skid_steered": lambda *_: skid_steered(),
    "all_steered": lambda *_: all_steered(),
}
VEHICLE_SHARES = dict.fromkeys(VEHICLES, 1.0) | {"tilting": 9, "four_wheels": 2, "skid_steered": 2}


# --- starts and inputs ----------------------------------------------------------------------------

START_SHARES = {"level": 6, "posed": 6, "extreme": 1, "outside": 0.5, "poor guess": 1}


def start_of(case: Case, ground: Any, vehicle: sf.Vehicle) -> dict[str, Any]:
    """Return the arguments of ``settle``."""
    rng, (x, y, _) = case.rng("start"), ground.origin
    place = rng.uniform(-0.5, 0.5, 2) if case.ground == "small" else rng.uniform(-2, 2, 2)
    if case.start == "outside":
        place = place + 2 * SIDE
    start: dict[str, Any] = {
        "x": x + place[0],
        "y": y + place[1],
        "heading": remainder(rng.uniform(-9, 9), 2 * np.pi),
    }
    if case.start in ("posed", "extreme"):
        size = 0.15 if case.start == "posed" else 1.5
        names = [c.name for c in vehicle.coordinates if c.kind != "suspension"]
        start |= {name: rng.uniform(-size, size) for name in names}
    if case.start == "poor guess":
        start["guess"] = {"roll": rng.uniform(-2, 2), "pitch": rng.uniform(-2, 2)}
        start["guess"]["z"] = ground.origin[2] + rng.uniform(-2, 2)
    return start


INPUT_SHARES = {"even": 3, "uneven": 3, "zero": 0.7, "huge": 0.7, "reversed": 1, "opposed": 1}
INPUT_SHARES |= {"piecewise": 2, "waves": 2, "straight": 3, "follow": 3}


def inputs_of(case: Case, dae: Any, start: Any, count: int) -> Any:
    """Return the inputs of a case: numbers by name, or the record of a law."""
    rng, names = case.rng("inputs"), [label.full for label in leaves(dae.labels.u)]
    speed = float(rng.choice([-1, 1]) * rng.uniform(0.1, 1.5))
    if case.inputs == "straight":
        return sf.straight(dae, start, speed=speed)
    if case.inputs == "follow":
        at = np.array([start["x"][0], start["y"][0]]) + rng.normal(0, 0.2, 2)
        steps = rng.normal(0, 1.5, (int(rng.integers(2, 6)), 2))
        return sf.follow(dae, sf.Path(at + np.cumsum(steps, axis=0)), speed=speed)
    driven = len(dae.labels.u.wheels)
    sizes = np.append(np.full(driven, 2.0), np.full(len(names) - driven, 0.05))
    base = speed / 0.5 * sizes * np.append(np.ones(driven), rng.normal(size=len(names) - driven))
    waves = rng.uniform(0.2, 4, len(names))
    values: dict[str, Any] = {
        "even": base * np.append(np.ones(driven), np.zeros(len(names) - driven)),
        "uneven": base * rng.uniform(0.8, 1.2, len(names)),
        "zero": np.zeros(len(names)),
        "huge": base * 10 ** rng.uniform(1, 4),
        "reversed": -np.abs(base),
        "opposed": base * rng.choice([-1, 1], len(names)),
        "piecewise": [sizes[k] * rng.normal(size=count) for k in range(len(names))],
        "waves": [a * (1 + ca.sin(w * dae.t)) for a, w in zip(base, waves, strict=True)],
    }
    return dict(zip(names, values[case.inputs], strict=True))


CAUSES = {  # what a refusal says, and what it is counted as
    r"no solution was found at the start: \w+\[\w+\], .* residual of [\d.e+-]+ m": "cannot stand",
    r"(found a violation|residual .*): wheel \w+ leaves the map, .* to its edge\): .* allowed": (
        "off the map"
    ),
    r"found a violation: the ground under wheel \w+ is more concave": "too concave",
    r"found a violation: wheel \w+ touches a second time at \(": "second touch",
    r"found a violation: wheel \w+ lies flat": "wheel flat",
    r"found a violation: wheel \w+ lifts off: equilibrium would need a negative": "lifts off",
    r"found a violation: the platform overturns": "overturned",
    r"found a violation: joint \w+ \(.*\) reaches its stop: .*, allowed": "at a stop",
    r"model is singular here: no equation determines \S+ \(": "singular",
    r"cannot roll without slip: expected \d+ passive .*, found \d": "cannot roll",
    r"Montana's form: wheel '\w+': expected a tread": "no tread radius",
    r"wheel \w+ has drifted from its position on the vehicle": "not assembled",
}


# --- solving --------------------------------------------------------------------------------------


def outcome(case: Case) -> Outcome:
    """Build a case, drive, and check what comes of it."""
    begin, problem = time.process_time(), None
    try:
        problem = build(case)
        run = sf.simulate(*problem[2:5], **problem[5])
        found = Outcome("complete") if run.stop is None else Outcome("stopped", run.stop.name)
        found.words = run.stop.words if run.stop else ""
    except (sf.ModelError, sf.DataError) as error:
        found = refusal(case, str(error))
    except sf.SolverError as error:
        found, run = Outcome("solver", "solver", str(error)), error.trajectory
        if run is None or run.stop is None:
            found.faults.append("the error of the solver carries no trajectory that says why")
            return found
    found.measures["cpu"] = time.process_time() - begin
    if found.kind != "refused" and problem is not None:
        _check(case, problem, run, found)
    return found


def refusal(case: Case, words: str) -> Outcome:
    """Return a refusal, and whether it names its cause."""
    cause = next((name for each, name in CAUSES.items() if re.search(each, words)), "")
    found = Outcome("refused", cause, words)
    if not found.cause:
        found.faults.append(f"the refusal names no known cause: {words}")
    elif re.search(r"\b(nan|inf)\b", words):
        found.faults.append(f"the refusal says nothing but that numbers are not finite: {words}")
    elif found.cause == "off the map" and case.start != "outside" and case.ground != "small":
        found.faults.append(f"refused as off the map, but started inside: {words}")
    return found


def build(case: Case) -> tuple[Any, ...]:
    """Return vehicle, ground, and the arguments of ``simulate``."""
    rng = case.rng("times")
    count = int(rng.choice([10, 50, 100]))
    begin = rng.choice([0.0, 100.0]) if case.inputs not in ("straight", "follow") else 0.0
    t = begin + np.linspace(0, rng.uniform(1, 8), count + 1)
    call = {"t": t, "options": sf.SolverOptions(tolerance=case.tolerance)}
    vehicle = VEHICLES[case.vehicle](case.rng("vehicle"), case.wheels)
    ground = ground_of(case, max(wheel.radius for wheel in vehicle.wheels))
    closure = sf.direct_kinematics(vehicle, ground, slip=SLIP_LAWS[case.slip]())
    dae = closure
    if case.formulation == "montana":
        dae = sf.montana_kinematics(vehicle, ground, slip=SLIP_LAWS[case.slip]())
    start = sf.settle(closure, **start_of(case, ground, vehicle))
    inputs = inputs_of(case, dae, start, count)
    if isinstance(inputs, dict):
        inputs = dae.inputs(**inputs)
    return vehicle, ground, dae, start, inputs, call


# --- checks ---------------------------------------------------------------------------------------


def _check(case: Case, problem: tuple[Any, ...], run: Any, found: Outcome) -> None:
    """Put down everything about a run that is not as it must be."""
    vehicle, ground, _, _, inputs, call = problem
    sizes, faults = found.measures, found.faults
    digits = 1e-9 if ground.origin[0] < 1e5 else 1e-8  # of a length between saved coordinates
    drift = 0.0
    if case.formulation == "montana":
        drift = float(max(run["drift_position"].max(), run["drift_rotation"].max()))
        sizes["drift_over_tolerance"] = drift / case.tolerance
    _own_words(case, run, faults, sizes, found.kind)
    centers, turns = chain(vehicle, run, ground.origin)
    saved = np.stack([run[f"center_{axis}"] for axis in "xyz"], -1) - ground.origin
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], -1)
    over = {
        "contact off the ground": np.abs(
            ground.elevation(contacts[..., 0], contacts[..., 1]) - contacts[..., 2]
        ).max()
        - digits * 10,
        "saved centres are not those of the chain": np.abs(saved - centers).max() - drift - digits,
        "rigid distance changed": _stretch(vehicle, saved) - 2 * drift - digits,
        "centre under the ground": -(
            saved[..., 2] + ground.origin[2] - ground.elevation(run["center_x"], run["center_y"])
        ).min(),
    }
    faults += [f"{name}: {size:.2g} m" for name, size in over.items() if not size <= 0]
    local = contacts - ground.origin
    depth = _depth(vehicle, ground, centers, turns)
    sizes["penetration"] = depth
    if depth > 1e-4 + drift + 1e3 * case.tolerance:
        faults.append(f"a wheel reaches {depth:.2g} m into the ground")
    if local.shape[0] > 3:
        _check_slip(case, problem, run, found)
    if isinstance(inputs, tuple) and case.inputs in ("even", "uneven", "zero", "huge", "reversed"):
        turned = [run["wheel_angle", w.name][-1] for w in vehicle.wheels if w.driven]
        due = np.array(list(inputs.wheels), dtype=float) * (run.t[-1] - call["t"][0])
        if np.abs(turned - due).max() > 1e3 * case.tolerance * (1 + np.abs(due).max()):
            faults.append(f"driven wheels turned {turned} rad, their rates say {due}")


def _own_words(case: Case, run: Any, faults: list[str], sizes: dict[str, float], kind: str) -> None:
    """Check what a run says of itself."""
    endless = ("clearance",)  # infinite where no second point is near the ground
    broken = [
        name
        for name in run
        if not (np.isfinite(run[name]) | ((run[name] == np.inf) & (name in endless))).all()
    ]
    if broken or not np.isfinite(run.t).all():
        faults.append(f"not finite: {', '.join(broken)}")
    if not (np.diff(run.t) > 0).all():
        faults.append("times do not ascend")
    if "closure_residual" in run.columns:
        sizes["closure"] = run["closure_residual"].max()
        sizes["newton_over_tolerance"] = run["newton_step"].max() / case.tolerance
        if not sizes["closure"] < 1e-10:
            faults.append(f"closure residual {sizes['closure']:.2g} m")
        if not sizes["newton_over_tolerance"] < 1000:
            faults.append(f"Newton step {sizes['newton_over_tolerance']:.2g} x the tolerance")
    for name, least in (
        ("clearance", 0.0),
        ("relative_curvature", 0.0),
        ("uprightness", 0.1),
        ("upright", 0.1),
        ("map_margin", 0.0),
    ):
        if name in run.columns and not run[name].min() >= least:
            faults.append(f"{name} is {run[name].min():.3g}, less than {least}")
    if kind != "complete" and not (run.stop.words and run.stop.name and run.t[-1] <= run.stop.t):
        faults.append(f"stopped, but not in words: {run.stop}")


def chain(vehicle: sf.Vehicle, run: Any, origin: Any) -> tuple[np.ndarray, list[Rotation]]:
    """Return wheel centres, shape (n, n_wheels, 3), and carriers' rotations from saved poses."""
    parts = part_frames(vehicle, run, origin)
    wheels = [(*parts[wheel.parent], wheel.at) for wheel in vehicle.wheels]
    centers = np.stack([place + turn.apply(at) for place, turn, at in wheels], 1)
    return centers, [turn for _, turn, _ in wheels]


def _stretch(vehicle: sf.Vehicle, centers: np.ndarray) -> float:
    """Return how much the distances change that no joint changes. [m]."""
    rng, names = np.random.default_rng(0), ["heading", "roll", "pitch", *"xyz"]
    names += [c.name for c in vehicle.coordinates]
    free, _ = chain(vehicle, {name: rng.normal(size=6) for name in names}, np.zeros(3))

    def distances(places: np.ndarray) -> np.ndarray:
        return np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)

    rigid = np.ptp(distances(free), axis=0) < 1e-12
    return float(np.abs(distances(centers) - distances(free)[0])[:, rigid].max())


def _depth(vehicle: sf.Vehicle, ground: Any, centers: np.ndarray, turns: list[Rotation]) -> float:
    """Return how deep the wheels reach into the ground, on a few samples. [m]."""
    deepest, v, u = 0.0, np.linspace(0, 2 * np.pi, 181), np.linspace(0, np.pi, 19)
    for k in np.unique(np.linspace(0, len(centers) - 1, 6).astype(int)):
        for i, wheel in enumerate(vehicle.wheels):
            along, rho = wheel.section.outline(u)
            body = np.stack(
                [
                    np.broadcast_to(along, (181, 19)),
                    np.outer(np.cos(v), rho),
                    np.outer(np.sin(v), rho),
                ],
                -1,
            )
            tread = turns[i][k].apply(body.reshape(-1, 3)) + centers[k, i] + ground.origin
            gap = tread[:, 2] - ground.elevation(tread[:, 0], tread[:, 1])
            deepest = max(deepest, -float(np.nanmin(gap)))
    return deepest


def _check_slip(case: Case, problem: tuple[Any, ...], run: Any, found: Outcome) -> None:
    """Compare slip with that of material points, by finite differences, at a few places."""
    vehicle, ground, dae, _, inputs, call = problem
    errors, slips = [], []
    places = 1 if case.inputs in ("straight", "follow") else 3  # a law is compiled every time
    for k in np.linspace(0, run.t.size - 3, places + 2).astype(int)[1:-1]:
        pace = 1 + max(np.abs(run[name][k]).max() for name in run if name.endswith("rate"))
        interval = np.searchsorted(call["t"], run.t[k], "right") - 1
        now = dae.inputs(**_at(dae, inputs, interval))
        t = run.t[k] + 1e-3 / pace * np.arange(5.0)
        try:
            fine = sf.simulate(
                dae, run.part(slice(k, k + 1)), now, t, options=sf.SolverOptions(tolerance=1e-11)
            )
        except (sf.SolverError, sf.ModelError):
            continue
        if fine.stop is None:
            measured = material_slip(vehicle, ground, fine) / pace
            excess = measured - np.hypot(fine["slip_along"][2], fine["slip_across"][2]) / pace
            errors.append(np.abs(excess).max())
            slips.append(measured.max())
    if errors:
        found.measures["slip_error"] = float(np.median(errors))
        bound = 1e-6 if ground.origin[0] < 1e5 else 1e-4
        if case.formulation == "montana":  # what draws the drift back is slip
            bound += 20 * float(max(run["drift_position"].max(), run["drift_rotation"].max()))
        if not np.median(errors) < bound:
            found.faults.append(f"slip is off by {np.median(errors):.2g} m/s at unit rate")
        if case.slip == "rolling" and not np.median(slips) < bound:
            found.faults.append(f"rolling slips by {np.median(slips):.2g} m/s at unit rate")


def _at(dae: Any, inputs: Any, k: int) -> dict[str, Any]:
    """Return the inputs of one interval by name."""
    names = [label.full for label in leaves(dae.labels.u)]
    return {
        name: value[k] if isinstance(value, np.ndarray) else value
        for name, value in zip(names, leaves(inputs), strict=True)
    }


def material_slip(vehicle: sf.Vehicle, ground: Any, run: Any) -> np.ndarray:
    """Return the speeds of the wheels' material contact points at the middle of five samples."""
    centers, turns = chain(vehicle, run, ground.origin)
    step = run.t[1] - run.t[0]
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], -1) - ground.origin
    speeds = []
    for i, turn in enumerate(turns):
        velocity = STENCIL @ (centers[:, i] - centers[2, i]) / step
        omega = STENCIL @ (turn * turn[2].inv()).as_rotvec() / step
        angle = run["wheel_angle"][:, i]
        omega -= STENCIL @ (angle - angle[2]) / step * turn[2].as_matrix()[:, 0]
        arm = contacts[2, i] - centers[2, i]
        speeds.append(np.linalg.norm(velocity + np.cross(omega, arm)))
    return np.array(speeds)
