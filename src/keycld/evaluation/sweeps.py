"""The learned potential energy along paths and over grids of configurations (the KeyCLD paper's Fig. 8 to 12)."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.evaluation.outcome import Evaluation
from keycld.evaluation.predicting import observe
from keycld.models.base import AbstractModel, HasEnergies, HasKeypoints

if TYPE_CHECKING:
    from keycld.data import DataSet


@eqx.filter_jit
def _potential(model: AbstractModel, keypoints: Float[Array, "n K 2"]) -> Float[Array, "n"]:
    assert isinstance(model, HasKeypoints) and isinstance(model, HasEnergies)
    at_rest, potential = model.at_rest, model.potential_energy
    return jax.vmap(lambda x: potential(at_rest(x)))(keypoints)


def evaluate_sweeps(model: AbstractModel, data: "DataSet") -> Evaluation:
    """Compute V by the learned law at the keypoints that the encoder observes along each path and grid of `sweeps.h5`.

    V is known up to a constant, and with masses and inputs up to one common factor: its shape means something, its
    level does not.

    Returns:
        An `Evaluation`, empty for models without keypoints or energies and for data without sweeps. Its scores hold the
        range of V over each path. Its arrays: `names`, `vary` (names of the states that change, joined by commas) and
        `units` (theirs, likewise), one a path; and for each NAME of length n: `NAME/values [n, …]` of those states,
        `NAME/shape`, `NAME/potential [n]`, `NAME/keypoints [n, K, 2]`, `NAME/image [n, H, W, 3]` and, where the model
        has maps, `NAME/heat_maps [n, K, …]`.
    """
    sweeps = data.sweeps()
    if not sweeps or not isinstance(model, HasKeypoints) or not isinstance(model, HasEnergies):
        return Evaluation({}, {})
    state_names, state_units = (list(data.attributes[name]) for name in ("state_names", "units"))
    columns = [[state_names.index(each) for each in sweep.vary] for sweep in sweeps]
    names = [sweep.name for sweep in sweeps]
    arrays: dict[str, np.ndarray] = {
        "names": np.array(names),
        "vary": np.array([",".join(sweep.vary) for sweep in sweeps]),
        "units": np.array([",".join(state_units[column] for column in picked) for picked in columns]),
    }
    for sweep, picked in zip(sweeps, columns, strict=True):
        keypoints, heat_maps = observe(model, sweep.image, heat_maps=True)
        arrays |= {
            f"{sweep.name}/values": sweep.state[:, picked],
            f"{sweep.name}/shape": np.array(sweep.shape),
            f"{sweep.name}/potential": np.asarray(_potential(model, jnp.asarray(keypoints))),
            f"{sweep.name}/keypoints": keypoints,
            f"{sweep.name}/image": sweep.image,
        }
        if heat_maps is not None:
            arrays[f"{sweep.name}/heat_maps"] = heat_maps
    ranges = {name: float(np.ptp(arrays[f"{name}/potential"])) for name in names}
    return Evaluation({"potential_range": ranges}, arrays)
