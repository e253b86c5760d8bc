"""Toy physics: systems with a Hamiltonian, with or without friction, shown as soft discs."""
