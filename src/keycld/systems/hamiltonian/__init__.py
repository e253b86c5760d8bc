"""Toy physics: systems with a Hamiltonian, with or without friction, shown as soft discs."""

from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem as AbstractHamiltonianSystem
