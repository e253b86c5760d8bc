"""The learned potential energy along paths and over grids of configurations (the paper's Fig. 8 to 12)."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.evaluation.evaluate import Evaluation
from keycld.evaluation.predicting import law_of, observe
from keycld.models import AbstractModel

if TYPE_CHECKING:
    from keycld.data import DataSet


@eqx.filter_jit
def _potential(model: AbstractModel, keypoints: Float[Array, "n K 2"]) -> Float[Array, "n"]:
    law = law_of(model)
    assert law is not None
    return jax.vmap(lambda x: law.potential_energy(x.reshape(-1)))(keypoints)


def evaluate_sweeps(model: AbstractModel, data: "DataSet") -> Evaluation:
    """Keypoints by the encoder and V by the learned law for each path and grid of `sweeps.h5`.

    V is known up to a constant, and with masses and inputs up to one common factor: its shape means
    something, its level does not.

    Returns:
        An `Evaluation`, empty for models without keypoints or energies. Its scores hold the range of V over
        each path. Its arrays: `names`, `vary` (names of the states that change, joined by commas) and
        `units` (theirs, likewise), one a path; and for each NAME of length n: `NAME/values [n, …]` of those
        states, `NAME/shape`, `NAME/potential [n]`, `NAME/keypoints [n, K, 2]`, `NAME/image [n, H, W, 3]`
        and `NAME/heat_maps [n, K, …]`.

    Raises:
        KeycldError: the data set has no pictures along paths.
    """
    if law_of(model) is None:
        return Evaluation({}, {})
    sweeps = data.sweeps()
    if sweeps.image is None or sweeps.state is None:
        raise KeycldError(f"sweeps.h5 of '{data.folder}' needs /image and /state: make the data set again.")
    state_names, units = (list(sweeps.attributes[name]) for name in ("state_names", "units"))
    names, vary = (np.asarray(sweeps.parameters[name], dtype=np.str_) for name in ("name", "vary"))
    columns = [[state_names.index(each) for each in joined.split(",")] for joined in vary]
    arrays: dict[str, np.ndarray] = {
        "names": names,
        "vary": vary,
        "units": np.array([",".join(units[c] for c in picked) for picked in columns]),
    }
    for k, name in enumerate(names):
        length = int(sweeps.parameters["length"][k])
        image = sweeps.image[k, :length]
        seen = observe(model, image, heat_maps=True)
        if seen is None or seen[1] is None:
            return Evaluation({}, {})
        arrays |= {
            f"{name}/values": sweeps.state[k, :length][:, columns[k]],
            f"{name}/shape": np.asarray(sweeps.parameters["shape"][k]),
            f"{name}/potential": np.asarray(_potential(model, jnp.asarray(seen[0]))),
            f"{name}/keypoints": seen[0],
            f"{name}/heat_maps": seen[1],
            f"{name}/image": image,
        }
    ranges = {str(name): float(np.ptp(arrays[f"{name}/potential"])) for name in names}
    return Evaluation({"potential_range": ranges}, arrays)
