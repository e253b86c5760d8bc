"""The presets of the KeyCLD family, one file each: a config, importable without JAX, that registers itself."""
