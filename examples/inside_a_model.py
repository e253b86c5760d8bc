"""A walk through a trained model: what it has learned, and what one can do with it that a black box does not allow.

Run it cell by cell in an editor that knows `# %%`, or at once: `python examples/inside_a_model.py`. It draws a few
recordings with MuJoCo to have something to look at (seconds). Figures go to `inside_a_model/`.
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import keycld
from keycld.data import make_data, open_data
from keycld.drawing import as_uint8, save_image, sheet
from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance, Motion, State

out = Path("inside_a_model")
make_data(
    "acrobot",
    out / "data",
    runs={"train": 1, "validation": 1, "test": 2, "test_long": 1},
    frames={"test_long": 50},
)
test = open_data(out / "data").test()
dt = jnp.float32(test.dt)

# %% A model that comes with the package. It has only ever seen pictures of the acrobot, and the two torques.
model = keycld.load("acrobot")
law = model.law

# %% Where it sees the two keypoints of a picture, in image-plane units: x right, y up, ±1 at the centres of the
# outermost pixels.
frames = jnp.asarray(test.image[0], jnp.float32) / 255
seen = jax.jit(jax.vmap(model.observe))(frames)
print("keypoints in the first picture:\n", np.round(seen.keypoints[0], 3))

# %% The radii on which they turn were never given, only that they are constant: training penalises how much
# Φ = (|x1|², |x1 − x2|²) varies over the pictures.
values = jax.vmap(model.constraint)(seen.keypoints.reshape(len(frames), -1))
print("radii:", np.sqrt(values.mean(0)).round(3), "scatter:", np.sqrt(values).std(0).round(4))

# %% Masses. They are known up to one factor, so look at ratios. Link two's mass is spread out between its ends, which
# couples the two keypoints: that is the number beside the diagonal.
mass = law.mass.matrix
print("mass matrix by its first entry:\n", np.round(mass / mass[0, 0], 3))


# %% Potential energy while the stretched arm turns once: a sine, highest when it stands up.
def stretched(angle: jax.Array) -> jax.Array:
    """Keypoints of the stretched arm; the angle is from straight down."""
    direction = jnp.array([jnp.sin(angle), -jnp.cos(angle)])
    first, second = jnp.sqrt(values.mean(0))
    return jnp.concatenate([first * direction, (first + second) * direction])


angles = jnp.linspace(-jnp.pi, jnp.pi, 9)
energy = jax.vmap(lambda angle: law.potential_energy(stretched(angle)))(angles)
print("V over a turn:", np.round(energy - energy.min(), 3))

# %% Input matrix: what one unit of each torque does to the two angles' accelerations when the arm hangs.
hanging = stretched(jnp.array(0.0))
nothing = law.acceleration(hanging, jnp.zeros(4), jnp.zeros(2))
for name, u in (("shoulder", jnp.array([1.0, 0.0])), ("elbow", jnp.array([0.0, 1.0]))):
    print(
        f"one unit at the {name} moves the keypoints by",
        np.round(law.acceleration(hanging, jnp.zeros(4), u) - nothing, 2),
    )

# %% Prediction from two pictures; every sixth frame, truth above.
found = eqx.filter_jit(model.predict)(frames[:2], dt, jnp.asarray(test.input[0]), 50)
save_image(out / "prediction.png", sheet([test.image[0], as_uint8(np.asarray(found.frames))]))

# %% Backward, too: the state of the last frame, with time reversed, leads to the first.
last = jax.tree.map(lambda leaf: leaf[-1], found.states)
back = model.rollout(last, -dt, jnp.asarray(test.input[0]), 49)
print("there and back, off by", float(jnp.abs(back.coordinates.x[-1] - found.states.coordinates.x[0]).max()))

# %% Your own constraint. Weld the elbow: the tip's distance to the shoulder stays as it is. No training, no data; the
# learned energies and masses now move a rigid arm, and the renderer draws it.
welded = Constraints(
    ("elbow", "tip"), (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"), DistanceToPoint("tip"))
)
rigid = eqx.tree_at(lambda m: m.dynamics.law.constraint_function, model, welded)
x = found.states.coordinates.x[0]
start = State(Motion(x, jnp.zeros(4)), {"constants": rigid.law.constraint(x)})
path = rigid.rollout(start, dt, jnp.zeros(2), 99)
save_image(out / "welded.png", sheet([as_uint8(np.asarray(jax.vmap(rigid.render)(path)))], every=12))
reach = jnp.linalg.norm(path.coordinates.x[:, 2:], axis=1)
print("the welded arm's reach varies by", float(reach.max() - reach.min()))
