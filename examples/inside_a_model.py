"""A walk through a trained model: what it has learned, and what its physics allows.

Run it cell by cell in an editor that knows `# %%`, or as a whole: `python examples/inside_a_model.py`. The notebook
next to it is made from this file: `python scripts/notebook.py examples/inside_a_model.py`.
"""

# %% [markdown]
# # Inside a trained model
#
# KeyCLD learns keypoints, masses, a potential energy and an input matrix from video. This walk-through looks at each of
# them in a model of the acrobot, a double pendulum with a torque at both joints, and then uses the physics for what a
# black box cannot do: run time backward, and change the mechanism after training.

# %%
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image

import keycld
from keycld.data import make_data, open_data
from keycld.drawing import as_uint8, enlarge, overlay_keypoints, sheet
from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance
from keycld.models import Scene, config_for
from keycld.models.base import capabilities

np.set_printoptions(precision=3, suppress=True)

# %% [markdown]
# ## Recordings
#
# MuJoCo simulates and renders a few recordings in some seconds. They are new to the model. The true states in the files
# are for evaluation only; nothing below reads them.

# %%
folder = Path("inside_a_model/data")
counts = {"train": 1, "validation": 1, "test": 2, "test_long": 1}
make_data("acrobot", folder, runs=counts, frames={"test_long": 50})
test = open_data(folder).test()
dt, u = jnp.float32(test.dt), jnp.asarray(test.input[0])
frames = jnp.asarray(test.image[0], jnp.float32) / 255
print(f"{len(frames)} frames of {frames.shape[1]} × {frames.shape[2]} pixels, {test.dt} s apart; torques {u}")

# %% [markdown]
# ## The model
#
# This one comes with the package; `keycld.load("runs/NAME")` loads one of yours. Its training data were pictures and
# torques only. What a model offers is part of its type.

# %%
model = keycld.load("acrobot")
print(", ".join(capabilities(model)))

# %% [markdown]
# ## Keypoints
#
# The keypoint estimator gives their positions in image-plane units: origin at the image centre, x right, y up, ±1 at
# the centres of the outermost pixels.

# %%
observed = jax.jit(jax.vmap(model.observe))(frames).keypoints
print(observed[0])
shown = overlay_keypoints(test.image[0, ::6], np.asarray(observed[::6], np.float64), scale=2)
Image.fromarray(sheet([shown], every=1))

# %% [markdown]
# ## Constraints
#
# The elbow stays at a constant distance from the shoulder, and the tip from the elbow. The model knows that these
# distances are constant; their values follow from the pictures. Mean and scatter over the frames:

# %%
squares = jax.vmap(model.constraint)(observed.reshape(len(frames), -1))
lengths = jnp.sqrt(squares)
print("lengths:", lengths.mean(0), "scatter:", lengths.std(0))

# %% [markdown]
# ## Masses
#
# Multiply masses, potential energy and input matrix by one number, and every motion stays the same. Video can tell
# ratios only. The mass of the second link lies between its two keypoints, which couples them: the off-diagonal entry.

# %%
mass = model.law.mass.matrix
print(mass / mass[0, 0])

# %% [markdown]
# ## Potential energy
#
# V while the stretched arm turns once, from hanging to upright and down again. Gravity gives a cosine.


# %%
def stretched(angle: jax.Array) -> jax.Array:
    """Return the keypoints of the stretched arm at an angle from hanging, [2, 2]."""
    direction = jnp.array([jnp.sin(angle), -jnp.cos(angle)])
    first, second = lengths.mean(0)
    return jnp.stack([first * direction, (first + second) * direction])


angles = jnp.linspace(0.0, 2 * jnp.pi, 9)
energy = jax.vmap(lambda angle: model.potential_energy(model.at_rest(stretched(angle))))(angles)
energy = energy - energy[0]
for angle, value in zip(np.degrees(angles), energy, strict=True):
    print(f"{angle:4.0f}°  V = {value:5.2f}  cosine: {energy[4] * (1 - np.cos(np.radians(angle))) / 2:5.2f}")

# %% [markdown]
# ## Input matrix
#
# What one unit of each torque does to the keypoints of the hanging arm: the accelerations with it, less those without.

# %%
hanging, still = stretched(jnp.array(0.0)).reshape(-1), jnp.zeros(4)
free = model.law.acceleration(hanging, still, jnp.zeros(2))
for name, torque in (("shoulder", jnp.array([1.0, 0.0])), ("elbow", jnp.array([0.0, 1.0]))):
    change = model.law.acceleration(hanging, still, torque) - free
    print(f"{name}: elbow's keypoint {change[:2]}, tip's keypoint {change[2:]}")

# %% [markdown]
# ## Prediction
#
# Two frames decide the state at the first one: `model.initial_state` finds the velocity with which the learned dynamics
# lead from one to the other. All else follows from it and the torques. Every sixth frame, truth above prediction:

# %%
state = model.infer(frames[:2], dt, u)
print(f"velocities by {type(model.initial_state).__name__}:\n{state.coordinates.v.reshape(2, 2)}")
predicted = eqx.filter_jit(model.predict)(frames[:2], dt, u, 50)
Image.fromarray(enlarge(sheet([test.image[0], as_uint8(np.asarray(predicted.frames))]), 2))

# %% [markdown]
# ## Backward
#
# The dynamics are reversible: the state of the last frame, with a negative time step, leads back to the first.

# %%
last = jax.tree.map(lambda leaf: leaf[-1], predicted.states)
back = eqx.filter_jit(model.rollout)(last, -dt, u, 49)
error = float(jnp.abs(back.coordinates.x[-1] - predicted.states.coordinates.x[0]).max())
print(f"there and back: {error:.1e} image-plane units")

# %% [markdown]
# ## Another mechanism
#
# Weld the elbow: the tip's distance from the shoulder now stays constant too. This needs no training and no data. The
# learned energies and masses move a rigid arm, and the renderer shows it.

# %%
rods = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"), DistanceToPoint("tip"))
welded = eqx.tree_at(lambda m: m.dynamics.law.constraint_function, model, Constraints(("elbow", "tip"), rods))
path = eqx.filter_jit(welded.rollout)(welded.at_rest(observed[0]), dt, jnp.zeros(2), 99)
reach = jnp.linalg.norm(path.coordinates.x[:, 2:], axis=1)
variation = float(reach.max() - reach.min())
print(f"the welded arm's reach varies by {variation:.1e}")
Image.fromarray(enlarge(sheet([as_uint8(np.asarray(jax.vmap(welded.render)(path)))], every=12), 2))

# %% [markdown]
# ## Training
#
# A preset is a config with documented fields; names with dots reach into its groups. Its stages follow from the config
# and the sizes of the data:

# %%
config = config_for("keycld", "fast", **{"joint.steps": 3000}).completed(open_data(folder))
scene = Scene(height=64, width=64, inputs=2, frames=50, dt=test.dt, trajectories=500)
for stage in config.stages(scene):
    print(f"{stage.name}: {stage.steps} steps")

# %% [markdown]
# Training takes some ten minutes on two cores. The same call resumes a run that was killed:
#
# ```python
# from keycld.training import train
#
# model = train("data/acrobot", "runs/acrobot", config, seed=0)
# ```
