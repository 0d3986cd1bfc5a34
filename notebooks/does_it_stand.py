# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Does the slip-free vehicle stand?
#
# The three-wheeler of Chakraborty and Ghosal rolls over uneven ground without slip, because its rear
# wheels tilt freely. That is kinematics. The paper offers the tilt instead of an axle of variable
# length, and says of the latter that it slips on steep ground, where gravity pulls at it.
#
# So we give the vehicle its weight and ask what friction its motion takes. Throughout, forces are in
# equilibrium at every instant: inertia is left out. Lengths are in metres, forces in newtons;
# angles are in radians, and in degrees where they are drawn or printed.

# %%
# %matplotlib inline
from pathlib import Path

import numpy as np

import slipfree
from slipfree import (
    Analytic,
    ModelError,
    catalog,
    direct_kinematics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.core.trajectory import joined, path_length
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem
from slipfree.show import style
from slipfree.vehicle.tree import actuated

DEG = np.pi / 180
above = [Path.cwd(), *Path.cwd().parents, *Path(slipfree.__file__).parents]
problems = next(path / "problems" for path in above if (path / "problems").is_dir())

# %% [markdown]
# ## How much friction does standing take?
#
# On an even slope that rises to the north, with the rear wheels braked and the front wheel free to
# turn. Contact forces are in equilibrium with gravity; needed is the tangential over the normal force
# of the wheel where that is largest. If equilibrium leaves the forces open, we take the distribution
# that needs least: no other can do with less, so below this coefficient the vehicle slides.
#
# With the centre of mass at height h above the ground and the wheelbase L, the tilting vehicle on
# upright wheels has closed forms:


# %%
def plane(slope, mu=1.0):
    return Analytic(lambda _x, y: np.tan(slope) * y, mu=mu)


def needed(vehicle, slope, headings, tilts=None):
    """Return the least coefficients of friction on which the vehicle stands."""
    model = direct_kinematics(vehicle, plane(slope))
    leans = [{"tilt_right": d, "tilt_left": d} for d in tilts] if tilts is not None else [{}]
    stands = joined(*(settle(model, heading=each, **lean) for each in headings for lean in leans))
    return best_utilisation(vehicle, plane(slope), stands)["utilisation_best"]


up, across, down = 0.0, 90 * DEG, 180 * DEG  # headings: across has the slope rise to the right
tilting = catalog.three_wheeler(wheel_mass=0.0)
h, L = 0.3, 1.5
print("slope       up          down        across     (found, closed form)")
for degrees in (5, 10, 20):
    s = degrees * DEG
    t = np.tan(s)
    forms = t / (2 / 3 + h / L * t), t / (2 / 3 - h / L * t), 3 * t
    found = needed(tilting, s, (up, down, across))
    pairs = "   ".join(f"{a:.3f} {b:.3f}" for a, b in zip(found, forms, strict=True))
    print(f"{degrees:3} deg  {pairs}")

# %% [markdown]
# Across the slope the front wheel alone carries the vehicle sideways, three times what a vehicle
# would need whose wheels share it. Now in every direction, for four rear axles: both wheels tilt; both
# halves of the axle slide; one half slides, the right one; rigid. Wheels are without mass here, and
# those that slide are nearly discs.

# %%
DISC = {"r1": 0.005, "r2": 0.295}
axles = {
    "both wheels tilt": tilting,
    "both halves slide": catalog.three_wheeler(axle="sliding", wheel_mass=0.0, **DISC),
    "right half slides": catalog.three_wheeler(axle="prismatic", wheel_mass=0.0, **DISC),
    "fixed": catalog.three_wheeler(axle="fixed", wheel_mass=0.0),
}


def on_the_map(angle, slope):
    """Return the heading of a vehicle that points at an angle from uphill in the slope's plane."""
    return np.arctan2(np.sin(angle) * np.cos(slope), np.cos(angle))


angles = np.arange(-180, 181, 10) * DEG
figure = style.figure(7.6, 4.4)
for k, slope in enumerate((10 * DEG, 20 * DEG)):
    ax = figure.add_subplot(1, 2, k + 1, projection="polar", theta_offset=np.pi / 2)
    for n, (name, vehicle) in enumerate(axles.items()):
        dashes = (0, (2, 2)) if name == "both halves slide" else "-"
        mu = needed(vehicle, slope, on_the_map(angles, slope))
        ax.plot(angles, mu, color=style.PALETTE[n], ls=dashes, lw=2 if n < 2 else 1.5, label=name)
    ax.plot(angles, 0 * angles + np.tan(slope), color="black", ls=":", lw=1, label="any vehicle")
    ax.set_title(f"slope of {slope / DEG:.0f} deg", pad=16)
    ax.set_xticks(np.arange(8) * 45 * DEG)
    ax.set_xticklabels(["uphill", "45", "across", "135", "downhill", "135", "across", "45"])
    ax.set_ylim(0, (0.6, 1.2)[k])
    ax.set_yticks(np.arange(2, 4) * (0.2, 0.4)[k])
    ax.set_rlabel_position(-22)
    for label in ax.get_yticklabels():
        label.set_bbox({"fc": "white", "ec": "none", "pad": 0.5})
    ax.tick_params(axis="x", pad=8)
handles, labels = ax.get_legend_handles_labels()
figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, columnspacing=1.2)
figure.suptitle("Friction needed to stand, by the direction ahead [deg from uphill]", fontsize=11)
figure

# %% [markdown]
# The dotted circle, the tangent of the slope, is what every vehicle needs at least. The fixed axle
# reaches it across the slope; up and down it does not, since the front wheel has no brake. Two free
# joints cost the same whether they tilt or slide: the curves coincide.
#
# The same in a table, and a second opinion on some of it: the law of friction, with its own equations,
# must find an equilibrium with 1 % more friction and none with 1 % less.

# %%
places = {"10 across": (10, 90), "20 across": (20, 90), "20 at 45": (20, 45)}
places |= {"20 up": (20, 0), "20 down": (20, 180)}


def is_held(vehicle, slope, heading, mu):
    try:
        settle(quasi_statics(vehicle, plane(slope, mu)), heading=heading)
    except ModelError:
        return False
    return True


print(" " * 18, *(f"{name:>10}" for name in places), "  [deg]")
agreed = []
for name, vehicle in axles.items():
    row = {
        place: needed(vehicle, slope * DEG, (heading * DEG,))[0]
        for place, (slope, heading) in places.items()
    }
    print(f"{name:18}", *(f"{mu:10.3f}" for mu in row.values()))
    for place in ("20 across", "20 at 45"):
        slope, heading = (each * DEG for each in places[place])
        more, less = (is_held(vehicle, slope, heading, f * row[place]) for f in (1.01, 0.99))
        agreed.append(more and not less)
print(f"the law of friction agrees at {sum(agreed)} of {len(agreed)} that were tried")

# %% [markdown]
# Two remarks. The vehicle with one sliding half is not symmetric; the table has it on its better side.
# And a heading is an angle on the map, of the rear axle: in the slope's plane the vehicle then points
# further aside, which changes the third column a little.

# %%
single, rigid = axles["right half slides"], axles["fixed"]
for place in ("10 across", "20 across", "20 at 45"):
    slope, heading = (each * DEG for each in places[place])
    sides = needed(single, slope, (heading, -heading))
    print(f"right half slides, {place}: {sides[0]:.3f}, and {sides[1]:.3f} the other way round")
turned = np.arctan2(np.sin(45 * DEG) / np.cos(20 * DEG), np.cos(45 * DEG)) / DEG
print(f"45 deg on the map are {turned:.1f} deg in a plane of 20 deg;")
mu = needed(rigid, 20 * DEG, (45 * DEG, on_the_map(45 * DEG, 20 * DEG)))
print(f"a fixed axle needs {mu[0]:.4f} at 45 deg on the map, {mu[1]:.4f} at 45 deg in the plane")

# %% [markdown]
# ## What does the paper's own motion take?
#
# Its direct problem on uneven ground, rear wheels at 0.5 and 0.4 rad/s, as `problems/paper_direct.toml`
# has it.

# %%
paper_file = problems / "paper_direct.toml"
outcome = run_problem(load_problem(paper_file))
paper, ground = outcome.trajectory, outcome.setup.terrain


def slipping(motion):
    """Return the size of the slip of every wheel. [m/s]."""
    return np.hypot(motion["slip_along"], motion["slip_across"])


def slid(motion):
    """Return how far every wheel slides in a metre of way. [mm]."""
    return 1000 * np.trapezoid(slipping(motion), motion.t, axis=0) / path_length(motion)


figure = style.figure(7, 3)
left, right = figure.subplots(1, 2)
for k, wheel in enumerate(paper.wheels):
    left.plot(
        paper.t,
        paper["friction_needed", wheel],
        label=wheel,
        **style.look(k) | {"ls": "--" if k == 2 else "-"},
    )
left.set(
    title="Friction needed", xlabel="time [s]", ylabel="tangential / normal force", ylim=(0, 1)
)
for k, side in enumerate(("right", "left")):
    right.plot(paper.t, paper[f"tilt_{side}"] / DEG, label=f"{side} wheel", **style.look(k))
right.set(title="Tilt", xlabel="time [s]", ylabel="[deg]", ylim=(0, 35))
left.legend(frameon=False)
right.legend(frameon=False)
print(f"largest slip {slipping(paper).max():.0e} m/s")
print(f"friction needed at the start {paper['friction_needed'][0].max():.2f}, "
      f"at {paper.t[-1]:g} s {paper['friction_needed'][-1].max():.2f}")  # fmt: skip
figure

# %% [markdown]
# The motion is free of slip, as the paper says, if friction is there to hold it, and at its end that
# is the friction of dry asphalt. The ground is nearly level: the slope has little to do with it.
#
# ## Why?
#
# A free joint transmits no torque. So the force on a tilting wheel passes through its tilt axis, the
# forward axis through its centre. Once the wheel leans, the normal force alone does not: a lateral
# force must help it. With tilt d on level ground its ratio to the normal force is
# `r2 sin d / (r1 + r2 cos d)` at a rear wheel. The front wheel bears the sum of two, twice the ratio.

# %%
r1, r2 = 0.05, 0.25
vehicle = catalog.three_wheeler()
model = direct_kinematics(vehicle, plane(0.0))
tilts = np.linspace(0, 30, 61) * DEG
form = r2 * np.sin(tilts) / (r1 + r2 * np.cos(tilts))
some = slice(0, None, 10)
leaning = joined(*(settle(model, tilt_right=d, tilt_left=d) for d in tilts[some]))
ratio = np.abs(leaning["force_across"] / leaning["force_normal"])
print(f"largest difference to the closed form, rear {np.abs(ratio[:, 0] - form[some]).max():.0e}, "
      f"front {np.abs(ratio[:, 2] - 2 * form[some]).max():.0e}")  # fmt: skip

figure = style.figure(5.2, 3.4)
ax = figure.subplots()
for k, (wheel, factor) in enumerate((("right", 1), ("front", 2))):
    at = leaning.wheels.index(wheel)
    ax.plot(tilts / DEG, factor * form, label=f"{wheel}, closed form", **style.look(2 * k))
    ax.plot(tilts[some] / DEG, ratio[:, at], "o", color=style.PALETTE[2 * k], mfc="white")
mean = (paper["tilt_right"] + paper["tilt_left"]) / 2
share = np.abs(paper["force_across", "front"] / paper["force_normal", "front"])
ax.plot(mean / DEG, share, color="black", lw=1, ls="--", label="front, the paper's run")
ax.set(title="Lateral over normal force of leaning wheels", ylim=(0, 1))
ax.set(xlabel="tilt of the rear wheels [deg]", ylabel="lateral / normal force")
ax.legend(frameon=False)
figure

# %% [markdown]
# Circles are the model on level ground; the dashed line is the paper's run over its hills, which
# keeps beside the same curve. It is the lean that takes the friction.
#
# Worse, the tilt is an inverted pendulum: the load stands on the wheel's rim, and tips it over. A
# wheel that rolls without slip cannot give way to that, but no wheel is quite free of creep. With the
# law of friction, standing on level ground, both wheels three degrees off:

# %%
balance = vehicle.weight / 3 * r2
print(f"load on a wheel times r2: {balance:.1f} N m/rad")
t = np.linspace(0, 1200, 121)
figure = style.figure(5.8, 3.2)
ax = figure.subplots()
for k, stiffness in enumerate((0.0, 20.0, 40.0)):
    sprung = catalog.three_wheeler(stiffness=stiffness)
    model = quasi_statics(sprung, plane(0.0, mu=0.6))
    start = settle(model, tilt_right=3 * DEG, tilt_left=3 * DEG)
    still = model.inputs(right_rate=0.0, left_rate=0.0, steer_rate=0.0)
    motion = simulate(model, start, still, t)
    lean = motion["tilt_right"] / DEG
    ax.plot(motion.t / 60, lean, label=f"{stiffness:.0f} N m/rad", **style.look(k))
    if motion.stop:
        ax.plot(motion.t[-1] / 60, lean[-1], "X", color=style.PALETTE[k])
        words = f"{motion.stop.name} at {lean[-1]:.0f} deg"
        ax.annotate(words, (motion.t[-1] / 60, lean[-1]), (8, -3), textcoords="offset points")
ax.set(title="Tilt of a wheel left to itself on level ground, friction 0.6", ylim=(0, 25))
ax.set(xlabel="time [min]", ylabel="tilt [deg]", xlim=(0, 20))
ax.set_xticks(range(0, 21, 5))
ax.legend(title="spring in the tilt", frameon=False, loc="upper left")
figure

# %% [markdown]
# A spring softer than the load times `r2` only slows the fall; a stiffer one rights the wheel. How
# fast is a matter of the law's creep, 0.1 mm/s here, an assumption; which way is not.
#
# The paper's run by the law of friction, with a coefficient of 0.6, with springs in the tilts, and
# with rates that fit each other, from the driving law `straight`:

# %%
friction = ["model=quasi-static", "terrain.friction=0.6"]
law = ["inputs=", 'driver={name="straight", speed=0.135}']
cases = {
    "the paper's rates": [],
    "the same, spring of 30 N m/rad": ["vehicle.stiffness=30.0"],
    "the same, spring of 60 N m/rad": ["vehicle.stiffness=60.0"],
    "driving law, no spring": law,
}
print(" " * 33, "ended  largest use of friction  largest slip")
for name, settings in cases.items():
    motion = run_problem(load_problem(paper_file, [*friction, *settings])).trajectory
    use, fastest = motion["utilisation"].max(), 1000 * slipping(motion).max()
    why = f"   {motion.stop.name}" if motion.stop else ""
    print(f"{name:33} {motion.t[-1]:.2f} s {use:12.3f} {fastest:21.2f} mm/s{why}")
    if motion.stop:
        print("   ", motion.stop.words)

# %% [markdown]
# "Ended by name" is an answer: there is no equilibrium beyond, the vehicle falls over its own wheels
# (by the last samples one of them slides already). Driven by rates that fit each other the wheels stay
# upright and little friction is needed, even without a spring. At the paper's rates a spring near
# the balance helps a great deal; a stiffer one pushes harder than gravity pulls, and the wheels slide
# instead. It survives, but no longer without slip.
#
# ## What helps?
#
# On the slope, leaning the wheels towards the vertical helps, and so does anything that bears torque
# in the tilt. Across 20 degrees, both wheels at the same tilt, with springs that rest at zero, and
# with locks. (A lock is an actuator at rate zero.)

# %%
slope = 20 * DEG
tilts = np.linspace(-20, 30, 26) * DEG
figure = style.figure(6.8, 3.2)
ax = figure.subplots()
for k, stiffness in enumerate((0.0, 30.0, 60.0)):
    sprung = catalog.three_wheeler(stiffness=stiffness)
    words = f"spring of {stiffness:.0f} N m/rad" if stiffness else "free"
    ax.plot(tilts / DEG, needed(sprung, slope, (across,), tilts), label=words, **style.look(k))
locked = actuated(catalog.three_wheeler(), "tilt_right", "tilt_left")
ax.plot(tilts / DEG, needed(locked, slope, (across,), tilts), label="locked", **style.look(3))
ax.axhline(np.tan(slope), color="black", ls=":", lw=1, label="any vehicle")
ax.set(title="Friction needed to stand across a slope of 20 deg", ylim=(0, 2))
ax.set(xlabel="tilt of both rear wheels, to the uphill side [deg]", ylabel="friction needed")
figure.legend(loc="outside right center", frameon=False, fontsize=8)
figure

# %%
for degrees in (10, 20):
    ground_here = plane(degrees * DEG)
    stand = settle(direct_kinematics(locked, ground_here), heading=across)
    use = best_utilisation(locked, ground_here, stand)["utilisation_best"][0]
    free = needed(vehicle, degrees * DEG, (across,))[0]
    torques = stand["tilt_right_torque"][0], stand["tilt_left_torque"][0]
    print(f"{degrees} deg across: free {free:.2f}, locked {use:.2f}, with torques of "
          f"{torques[0]:.1f} and {torques[1]:.1f} N m in the tilts")  # fmt: skip

# %% [markdown]
# A spring does nothing for an upright wheel. Near the balance it cancels what the lean does, either
# way; a stiffer one helps wheels that lean downhill, and harms those that stand up to the slope.
# A lock brings the vehicle down to what any vehicle needs, for torques that a small motor with a
# gearbox holds.
#
# But a locked tilt is a fixed axle, which slips. The best of both is an actuator that leads the wheel
# through the tilts that it would have taken freely: the kinematics are the paper's, and the torque is
# the actuator's. The paper's run again, with the slip that its motion has at least (that of the led
# wheels is there because we hand over their rates in steps). Forces of locked and led wheels are open;
# friction is that of the best distribution, torques those of the load-weighted one.

# %%
seconds = np.diff(paper.t)
led = {f"tilt_{side}_rate": np.diff(paper[f"tilt_{side}"]) / seconds for side in ("right", "left")}
held = dict.fromkeys(led, 0.0)
model = direct_kinematics(locked, ground)
start = settle(model)
rates = {"right_rate": 0.5, "left_rate": 0.4, "steer_rate": 0.0}
motions = {"free": paper}
for stiffness in (30, 60):
    sprung = load_problem(paper_file, [f"vehicle.stiffness={stiffness}.0"])
    motions[f"spring of {stiffness} N m/rad"] = run_problem(sprung).trajectory
for name, joints in (("locked", held), ("led by actuators", led)):
    motion = simulate(model, start, model.inputs(**rates, **joints), paper.t)
    motions[name] = best_utilisation(locked, ground, motion)

figure = style.figure(7.2, 3.2)
left, right = figure.subplots(1, 2, width_ratios=(1.2, 1))
print(" " * 21, "friction needed  slip per metre  torque in the tilts")
for k, (name, motion) in enumerate(motions.items()):
    best = "utilisation_best" in motion.columns  # on a ground of friction one
    use = motion["utilisation_best"] if best else motion["friction_needed"].max(axis=1)
    dashed = {"ls": "--"} if k == 4 else {}
    left.plot(motion.t, use, label=name, **style.look(k) | dashed)
    both = np.array([motion[f"tilt_{side}_torque"] for side in ("right", "left")]) if best else None
    if best:
        right.plot(motion.t, np.abs(both).max(axis=0), label=name, **style.look(k))
    torque = f"{np.abs(both).max():.1f} N m" if best else "-"
    print(f"{name:21} {use.max():10.2f} {slid(motion).max():14.2f} mm {torque:>18}")
left.set(
    title="Friction needed by the worst wheel", xlabel="time [s]", ylabel="friction", ylim=(0, 1)
)
right.set(title="Torque of the actuators", xlabel="time [s]", ylabel="the larger one [N m]")
left.legend(frameon=False, fontsize=8)
right.legend(frameon=False, fontsize=8)
right.set_ylim(0, 20)
figure

# %% [markdown]
# The led vehicle does what the paper shows, on ground as slippery as ice. The price is an actuator and
# what tells it how to lean; of the actuated axle of variable length the paper says just that, that it
# needs to know the slip. What the led tilts need is the torque of the pendulum.
#
# ## How much does it slide on the way?
#
# `least`, the default law of slip, is a bound: the least that kinematics allows. The law of friction
# is a prediction, as good as its coefficient and its creep. Over hills
# (`problems/traction_hills.toml`), with the driving law, by the creep that is assumed:

# %%
hills = problems / "traction_hills.toml"
rear = {
    "tilting, sprung": [],
    "both halves slide": ["vehicle.axle=sliding", "vehicle.stiffness="],
    "right half slides": ["vehicle.axle=prismatic", "vehicle.stiffness="],
    "fixed": ["vehicle.axle=fixed", "vehicle.stiffness="],
}
creeps = (1e-3, 1e-4, 1e-5)
often = ["time.step=0.1"]
print("mm slid per metre: the worst wheel, the sum of all three")
print(" " * 18, f"{'least':>11}", *(f"{f'{1000 * c:g} mm/s':>11}" for c in creeps))
figure = style.figure(5.2, 3.4)
ax = figure.subplots()
for k, (name, settings) in enumerate(rear.items()):
    bound = slid(
        run_problem(load_problem(hills, ["model=kinematics", "law=", *often, *settings])).trajectory
    )
    found = [
        slid(
            run_problem(
                load_problem(hills, [f"law.coulomb.creep={c}", *often, *settings])
            ).trajectory
        )
        for c in creeps
    ]
    row = " ".join(f"{each.max():5.2f} {each.sum():5.2f}" for each in (bound, *found))
    print(f"{name:18}", row)
    marker = style.look(k) | {"marker": "o", "mfc": "white", "ls": "--" if k % 2 else "-"}
    ax.loglog(np.multiply(1000, creeps), [each.max() for each in found], label=name, **marker)
    if bound.max() > 1e-6:
        ax.axhline(bound.max(), color=style.PALETTE[k], ls=":", lw=1)
ax.set(title="Slid by the worst wheel (dotted: least)", ylim=(2e-3, 10))
ax.set(xlabel="creep of the law of friction [mm/s]", ylabel="per metre of way [mm]")
ax.legend(frameon=False, fontsize=8, loc="lower right")
figure

# %% [markdown]
# Vehicles that can roll without slip slide by creep alone, in proportion to it. The others slide
# however little the creep: by millimetres in a metre, and the worst wheel by more than the bound says.
# That does not contradict the bound, which concerns squares: friction rather lets one wheel slide than
# all of them a little, so that the sum of all three may even be less.
#
# ## What to remember
#
# 1. Rolling without slip is a matter of kinematics; whether friction holds it is another, and all that
#    is said of it here is quasi-static: no inertia.
# 2. A free tilt carries no lateral load. On a slope the front wheel bears it all, and where the wheels
#    lean, they push the vehicle sideways even on level ground.
# 3. The paper's advantage over the axle of variable length under gravity is not reproduced: upright,
#    two free tilts need the friction of two sliding halves, and one sliding half needs less or the same.
# 4. The tilt is an inverted pendulum. Rates that fit each other keep it upright, a spring stiffer than
#    the load times `r2` rights it, and an actuator that leads it keeps the motion of the paper at a
#    small part of the friction.
# 5. Least slip is a bound, `quasi_statics` a prediction that depends on its creep. Where there is no
#    equilibrium the motion ends by that name.
