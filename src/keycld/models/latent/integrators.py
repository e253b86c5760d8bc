"""Integrators of the models whose field is not a separable Hamiltonian."""

from keycld.mechanics import AbstractIntegrator, DormandPrince, integrator_named

ADAPTIVE = "adaptive"


def latent_integrator(name: str) -> AbstractIntegrator:
    """Return Dormand–Prince with error control for `adaptive`, else the Runge–Kutta method of that name.

    Raises:
        KeycldError: for an unknown name.
    """
    return DormandPrince() if name == ADAPTIVE else integrator_named(name)
