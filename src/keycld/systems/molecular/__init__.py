"""Molecular dynamics: particles in a periodic square, shown as soft discs."""
