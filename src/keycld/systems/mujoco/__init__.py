"""Mechanical systems with motors, simulated and rendered by MuJoCo: the systems of the KeyCLD paper."""
