"""The models of the family, one file each: configs, importable without JAX, that register it with its presets."""
