"""The presets of the KeyCLD family: one file for each, with a config that registers itself and needs no JAX."""
