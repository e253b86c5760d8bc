"""Keypoints and constraints of common mechanisms, one TOML file each; the name of the file is that of the mechanism."""
